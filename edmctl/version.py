"""The version of edmctl."""

__version__ = "0.1.0"
