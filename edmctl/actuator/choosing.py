"""What a model is made of: thresholds, knots and time constants that the records can support."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.design import Design
from edmctl.actuator.waveshape import length_s, sample_s

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]

PLAYS, HINGES = 10, 4
THRESHOLD_EXPONENT = 1.4
"""Thresholds lie denser near zero, where the weights of soft PZT are largest."""
CREEPING_SHARES = (0.0, 0.25, 0.5)
"""Plays that creep, by threshold over the largest."""
FIRST_TAU_S, FIRST_TAU_SHARE = 0.02, 1e-3
OWN_TAU_SHARE = 0.2
"""Fastest lag, at most so long and such a share of the record; slowest that has a weight of its own."""
TAU_RATIO = 5.0
"""Lags in steps of 5 stay within 0.6 % of a decade's creep of the logarithm of time."""
LONGEST_TAU_S = 4000.0
"""Creep is continued up to here: longer than a hole takes."""


def choose_design(
    records: Sequence[Record], *, hinges: int = HINGES, plays: int = PLAYS, creep: bool = True
) -> Design:
    """Thresholds to half the span, knots where each play can be, time constants that the records support."""
    low_v = min(float(record.u_v.min()) for record in records)
    high_v = max(float(record.u_v.max()) for record in records)
    thresholds_v = thresholds(high_v - low_v, plays)
    taus_s, column_of = _time_constants(records) if creep else (np.empty(0), np.empty(0, dtype=np.int64))
    creeping = [int(np.abs(thresholds_v - share * thresholds_v[-1]).argmin()) for share in CREEPING_SHARES]
    return Design(
        thresholds_v=thresholds_v,
        knots_v=np.linspace(low_v + thresholds_v, high_v - thresholds_v, hinges + 1, axis=1),
        creep_plays=np.unique(creeping).astype(np.int64) if len(taus_s) else np.empty(0, dtype=np.int64),
        time_constants_s=taus_s,
        column_of=column_of,
        low_v=low_v,
        high_v=high_v,
    )


def thresholds(span_v: float, plays: int) -> Array:
    """Thresholds of the plays, shape (plays,), V."""
    thresholds_v: Array = 0.5 * span_v * np.power(np.arange(plays) / plays, THRESHOLD_EXPONENT)
    return thresholds_v


def _time_constants(records: Sequence[Record]) -> tuple[Array, NDArray[np.int64]]:
    """Lags from two samples to a fifth of the longest record, each with its own weight, and slower ones.

    Those share the weight of the slowest: creep runs on like the logarithm of time, and a record that ends
    cannot say otherwise.
    """
    longest_s = length_s(records)
    first_s = max(2.0 * sample_s(records), min(FIRST_TAU_S, FIRST_TAU_SHARE * longest_s))
    count = max(1, _steps_of_tau(first_s, LONGEST_TAU_S))
    own = min(count, max(1, _steps_of_tau(first_s, OWN_TAU_SHARE * longest_s)))
    taus_s: Array = first_s * np.power(TAU_RATIO, np.arange(count, dtype=np.float64))
    return taus_s, np.minimum(np.arange(count), own - 1)


def _steps_of_tau(first_s: float, last_s: float) -> int:
    return 1 + int(np.floor(np.log(last_s / first_s) / np.log(TAU_RATIO) + 1e-9))
