"""The checklist of a machine that was just wired, with a board that was just flashed."""
