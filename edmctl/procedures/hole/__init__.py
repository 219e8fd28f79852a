"""A hole: its cuts, measuring stops, decisions and result; many holes in turn; holes taken up again."""
