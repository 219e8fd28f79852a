"""What was estimated in the last seconds, to look up the moment of an event that is told later."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SPAN_S = 15.0
"""Looked back at most: a touch is told at the end of its dwell, which is 10 s at most."""


class Trace:
    """Displacements over the last `SPAN_S`, in blocks."""

    def __init__(self) -> None:
        self._blocks: deque[tuple[Floats, Floats]] = deque()

    def append(self, time_s: Floats, displacement_um: Floats) -> None:
        """Take consecutive samples, shape (n,) each, n > 0."""
        self._blocks.append((time_s, displacement_um))
        while self._blocks[0][0][-1] < time_s[-1] - SPAN_S:
            self._blocks.popleft()

    def at(self, time_s: float) -> float:
        """Displacement at a moment, interpolated; that of the nearest end outside the span; NaN when empty."""
        if not self._blocks:
            return float("nan")
        times_s = np.concatenate([block_s for block_s, _ in self._blocks])
        values_um = np.concatenate([block_um for _, block_um in self._blocks])
        return float(np.interp(time_s, times_s, values_um))
