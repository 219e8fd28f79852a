"""How far the estimated displacement is from the sensor while the tool machines."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.machine.interface import MachineState

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.machine.interface import TelemetryBlock

    Floats = NDArray[np.float64]

SMOOTHED_S = 0.1
"""Both are averaged over this: 0.15 µm of sensor noise a sample becomes 0.05 µm at 100 Hz."""
_GATHERED_BLOCKS = 20
"""Blocks reduced together: ten seconds of them."""


class FeedError:
    """Sums over one hole: estimate less sensor, averaged over `SMOOTHED_S`, wherever all samples are machining."""

    def __init__(self) -> None:
        self._fresh: list[tuple[TelemetryBlock, Floats]] = []
        self._max_um = math.nan
        self._squares = 0.0
        self._count = 0

    @property
    def max_um(self) -> float:
        """Largest error, µm; NaN before any."""
        self._reduce()
        return self._max_um

    @property
    def rms_um(self) -> float:
        """Root mean square, µm; NaN before any."""
        self._reduce()
        return math.sqrt(self._squares / self._count) if self._count else math.nan

    def take(self, block: TelemetryBlock, model_um: Floats) -> None:
        """Take consecutive samples with what was estimated for them, shape (n,)."""
        self._fresh.append((block, model_um))
        if len(self._fresh) >= _GATHERED_BLOCKS:
            self._reduce()

    def _reduce(self) -> None:
        if not self._fresh:
            return
        blocks = [block for block, _ in self._fresh]
        machining = np.concatenate([block.state for block in blocks]) == MachineState.MACHINING
        sensor_um = np.concatenate([block.displacement_um for block in blocks])
        error_um = np.concatenate([model_um for _, model_um in self._fresh]) - sensor_um
        span_s = float(blocks[-1].time_s[-1] - blocks[0].time_s[0])
        self._fresh.clear()
        size = max(1, round(SMOOTHED_S * (len(error_um) - 1) / span_s)) if span_s > 0.0 else 1
        rows = len(error_um) // size
        whole = machining[: rows * size].reshape(rows, size).all(axis=1)
        means_um = error_um[: rows * size].reshape(rows, size)[whole].mean(axis=1)
        if len(means_um):
            self._max_um = float(np.fmax(self._max_um, np.abs(means_um).max()))
            self._squares += float(means_um @ means_um)
            self._count += len(means_um)
