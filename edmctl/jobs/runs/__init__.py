"""Run files: find, summarize, explain, export, plot."""
