"""Figures, in the sizes and the types of a journal."""
