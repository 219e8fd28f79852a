"""Run files whose servo signals are known to the last sample."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record.rows import ServoBlock
from edmctl.record.writer import RunWriter
from tests.record.samples import a_meta, a_site_row

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from edmctl.record.run_meta import Leaf
    from edmctl.results.job import SiteResult

    Array = NDArray[np.float64]

MACHINING, JUMP, TOUCH, IDLE = 4, 5, 6, 1


@dataclass(frozen=True)
class Signals:
    """Samples of the servo, shape (n,), at 100 Hz from 0 s on."""

    gap_v: Array
    sensor_um: Array
    model_um: Array
    state: NDArray[np.uint8]

    @property
    def time_s(self) -> Array:
        return 0.01 * np.arange(float(len(self.state)))

    def block(self) -> ServoBlock:
        n = len(self.state)
        return ServoBlock(
            self.time_s, self.sensor_um / 3.0, self.sensor_um, self.model_um, self.gap_v, self.gap_v / 12.0,
            np.zeros(n), np.zeros(n, np.int8), self.state,
        )  # fmt: skip


def a_cut(seconds: float, swing_hz: float = 6.25) -> Signals:
    """A cut from 50 µm on at 1 µm/s with a swing about 9.6 V; the estimate is 2 µm too long."""
    time_s = 0.01 * np.arange(round(100 * seconds))
    swing = np.sin(2.0 * np.pi * swing_hz * time_s)
    noise = np.random.default_rng(1).normal(0.0, 0.1, len(time_s))
    sensor_um = 50.0 + time_s + 0.05 * swing
    state = np.full(len(time_s), MACHINING, np.uint8)
    return Signals(9.6 + 0.5 * swing + noise, sensor_um, sensor_um + 2.0, state)


def sites(count: int) -> list[SiteResult]:
    """Results of so many holes."""
    return [replace(a_site_row(), name=f"A{k + 1}") for k in range(count)]


def write_run(
    path: Path,
    signals: Signals | None = None,
    results: Sequence[SiteResult] = (),
    leaves: Sequence[Leaf] = (),
) -> RunWriter:
    """Return a writer of a run file that holds the signals and results; the caller adds to it and ends it."""
    writer = RunWriter.create(path, replace(a_meta(), profile_leaves=tuple(leaves)))
    if signals is not None:
        writer.append(signals.block())
    for row in results:
        writer.append(row)
    return writer
