"""The delay between voltage and displacement, by search."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.design import Design, reduce_records
from edmctl.actuator.fitting import fit
from edmctl.actuator.waveshape import half_periods_s, sample_s

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]

LONGEST_DELAY_S = 0.02
DELAY_STEPS = 16


def _delay_grid(records: Sequence[Record]) -> Array:
    """Delays to try: from one step before zero, in whole samples, so that no noise is averaged away."""
    step_s = sample_s(records)
    swings_s = np.concatenate([half_periods_s(record) for record in records])
    longest_s = min(LONGEST_DELAY_S, 0.5 * float(swings_s.min(initial=np.inf)))
    stride_s = step_s * max(1, round(longest_s / DELAY_STEPS / step_s))
    delays_s: Array = stride_s * np.arange(-1.0, max(2, round(longest_s / stride_s)) + 1)
    return delays_s


def best_delay(design: Design, records: Sequence[Record], skip: Sequence[int]) -> float:
    """Where the residual is least: the vertex of a parabola, which it is in the delay, through three delays."""
    if sample_s(records) > LONGEST_DELAY_S:
        return 0.0
    delays_s = _delay_grid(records)
    reduction = reduce_records(design, records, delays_s, skip)
    residuals: list[float] = []
    weights = None
    for k in range(len(delays_s)):
        found = fit(design, reduction, delay=k, start=weights)
        weights = found.weights
        residuals.append(found.residual_um2)
    middle = min(max(int(np.argmin(residuals)), 1), len(residuals) - 2)
    before, here, after = residuals[middle - 1 : middle + 2]
    bend = before - 2.0 * here + after
    vertex = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    stride_s = float(delays_s[1] - delays_s[0])
    return max(0.0, float(delays_s[middle]) + stride_s * min(max(vertex, -1.0), 1.0))
