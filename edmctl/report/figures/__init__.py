"""Figures of a run, one module each: `draw(run)` returns the figure or raises `NothingToDraw`."""
