"""Run files: which one is meant, its story and summary, what is drawn and exported of it."""
