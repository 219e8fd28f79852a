"""Calibrations: choosing one for a run, its warnings, and making one."""
