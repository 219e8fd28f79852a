"""A hole: its cuts, measuring stops, decisions and result; a hole taken up again."""
