"""Runs that were interrupted: which one is meant, whether it can be taken up, and its journal."""
