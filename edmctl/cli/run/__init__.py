"""`edmctl run`: look at run files."""
