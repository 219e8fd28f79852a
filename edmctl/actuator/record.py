"""A measured record: what was applied to the actuator, where the tool went, and what the voltage covers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmctl.array_types import Array, Flags

HELD_SHARE = 0.02  # a voltage that stays within this share of the span is held
TURN_SHARE = 0.3  # a swing of less than this share of the span does not show the rate of a record
RATES_APART = 2.0
MOST = 1e30


class Record(NamedTuple):
    """Consecutive samples of one measurement.

    t_s, u_v, y_um : ndarray, shape (n,)
        Time (strictly ascending), voltage applied to the actuator, displacement of the tool.
    previous_v : float or None
        Voltage that the actuator was held at before the first sample. None: it had been cycling over the
        record's own range, and comes from the end that the first move leads away from.
    name : str
        What messages call it.
    """

    t_s: Array
    u_v: Array
    y_um: Array
    previous_v: float | None = None
    name: str = "record"


def check_numbers(record: Record) -> None:
    """Raise ValueError for a record that holds anything but numbers whose squares are numbers."""
    for values in record[:3]:
        if not np.isfinite(values).all():
            raise ValueError(f"{record.name}: holds numbers that are not finite")
        if len(values) and float(np.abs(values).max()) > MOST:
            raise ValueError(f"{record.name}: holds numbers beyond {MOST:g}")


def length_s(records: Sequence[Record]) -> float:
    """Duration of the longest record."""
    return max(float(record.t_s[-1] - record.t_s[0]) for record in records)


def sample_s(records: Sequence[Record]) -> float:
    """Time from sample to sample of the slowest sampled record."""
    return max(float(np.median(np.diff(record.t_s))) for record in records)


def longest_hold_s(record: Record) -> float:
    """Longest time that the voltage stays within 2 % of its span."""
    level = np.round((record.u_v - record.u_v.min()) / (HELD_SHARE * np.ptp(record.u_v)))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(level)) + 1, [len(level) - 1]])
    return float(np.diff(record.t_s[edges]).max())


def half_periods_s(record: Record) -> Array:
    """Times from one large turning point to the next, shape (k,)."""
    u_v, least_v = record.u_v, TURN_SHARE * float(np.ptp(record.u_v))
    changes = np.concatenate([[0], np.flatnonzero(np.diff(u_v)) + 1])
    turns = np.flatnonzero(np.diff(np.sign(np.diff(u_v[changes]))) != 0) + 1
    kept: list[int] = []
    for k in changes[turns].tolist():
        if not kept or abs(u_v[k] - u_v[kept[-1]]) >= least_v:
            kept.append(k)
        elif len(kept) > 1 and (u_v[k] - u_v[kept[-1]]) * (u_v[kept[-1]] - u_v[kept[-2]]) > 0:
            kept[-1] = k
    return np.diff(record.t_s[kept])


def has_several_rates(records: Sequence[Record]) -> bool:
    """Whether the records swing at rates so different that delay and hysteresis can be told apart."""
    times_s = np.concatenate([half_periods_s(record) for record in records])
    if len(times_s) < 2:
        return False
    fast_s, slow_s = np.percentile(times_s, [10, 90])
    return bool(slow_s >= RATES_APART * fast_s)


def known_from(record: Record) -> int:
    """Return the first sample from which both ends of the voltage have been visited.

    Before it, the plays depend on an unrecorded history, unless the voltage before the record is given.
    """
    if record.previous_v is not None:
        return 0
    margin_v = HELD_SHARE * float(np.ptp(record.u_v))
    top = int(np.argmax(record.u_v >= record.u_v.max() - margin_v))
    bottom = int(np.argmax(record.u_v <= record.u_v.min() + margin_v))
    return max(top, bottom)


def settled_from(record: Record) -> int:
    """Return the sample of `known_from` if it is in the first fifth of the record, else 0."""
    known = known_from(record)
    return known if known <= len(record.u_v) // 5 else 0


def runs_of(flags: Flags) -> NDArray[np.int64]:
    """Return first and end of each run of true flags, shape (k, 2)."""
    return np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
