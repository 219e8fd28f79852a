"""Calibrations: which one a run goes by, what is doubtful about it, and how one is made."""
