"""Gap voltage and displacement of a run that another process writes, in short slices since the last look."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile
    from edmctl.results.progress import Extremes

SLICE_S = 0.1
"""As often as a job reports what it does."""
SPAN_S = 60.0
"""As much is drawn; what is older is not looked at."""
MOST_ROWS = 60_000
"""Rows in that time at 1 kHz, the highest rate there is."""
PULSES_S = 2.0
"""The supervisor writes ten rows a second while there are pulses: without one for so long there are none."""
_MOST_SLOW = int(10.0 * (SPAN_S + PULSES_S))


@dataclass(frozen=True, slots=True)
class Samples:
    """The newest row, and the slices since the last look, of which the last one ends with it."""

    time_s: float
    gap_v: float
    displacement_um: float
    state: int
    slices: tuple[Extremes, ...]


class SampleReader:
    """Reads each row once, however long ago the last look was. The first look goes back by `SPAN_S`."""

    def __init__(self) -> None:
        self._read = 0

    def read(self, run: RunFile) -> Samples | None:
        """Return what has come since the last call, the newest row again where nothing has; None before any."""
        import numpy as np

        from edmctl.results.progress import Extremes

        rows = run.rows("/entry/servo")
        if not rows:
            return None
        first = min(max(self._read, rows - MOST_ROWS), rows - 1)
        self._read = rows
        time_s, gap_v, sensor_um, model_um = (
            run.column("/entry/servo", name, first, rows).astype(float)
            for name in ("time", "v_gap_avg", "z_sensor", "z_model")
        )
        height_um = sensor_um if math.isfinite(sensor_um[-1]) else model_um
        drawn = int(np.searchsorted(time_s, time_s[-1] - SPAN_S))
        parts = np.floor(time_s[drawn:] / SLICE_S)
        begins = drawn + np.flatnonzero(np.diff(parts, prepend=-1.0))
        ends_s = time_s[np.append(begins[1:], len(time_s)) - 1]
        lows_v, highs_v = (extreme.reduceat(gap_v, begins) for extreme in (np.fmin, np.fmax))
        quiet = ~_with_pulses(run, ends_s)
        lows_v[quiet] = highs_v[quiet] = math.nan
        lows_um, highs_um = (extreme.reduceat(height_um, begins) for extreme in (np.fmin, np.fmax))
        return Samples(
            float(time_s[-1]),
            float(gap_v[-1]),
            float(height_um[-1]),
            int(run.column("/entry/servo", "state", rows - 1, rows)[0]),
            tuple(
                Extremes(*map(float, row))
                for row in zip(ends_s, lows_v, highs_v, lows_um, highs_um, strict=True)
            ),
        )


def _with_pulses(run: RunFile, times_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether there were pulses at each time, shape (n,)."""
    import numpy as np

    rows = run.rows("/entry/slow")
    told_s = run.column("/entry/slow", "time", max(0, rows - _MOST_SLOW), rows).astype(float)
    told_s = np.concatenate([[-math.inf], told_s])
    since_s: NDArray[np.float64] = times_s - told_s[np.searchsorted(told_s, times_s, side="right") - 1]
    found: NDArray[np.bool_] = since_s <= PULSES_S
    return found
