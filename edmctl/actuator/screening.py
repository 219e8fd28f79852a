"""Samples without weight: those at the start while something rings, and single ones that stand out.

They are found in the residual of a first fit. Knocks and jumps of the sensor last longer and keep their weight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from edmctl.actuator.checks import noise_sd
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import Record, settled_from
from edmctl.array_types import Array, Flags
from edmctl.dataclasses import dataclass

WINDOWS = 400  # a record is looked at in so many parts, each by its largest residual
MOST_START_SHARE = 0.2  # a start that takes longer is no start
FAR, USUAL = 2.5, 95.0
"""A start rings where it is so many times above the percentile of the parts that follow."""
OUTLIER_SDS = 6.0
MOST_OUTLIERS_SHARE = 1e-3  # more of them are the sensor's way to read, not single ones
LATE_SHARE = 0.5  # a sample is no outlier where it may be late by this share of a sample
LEAST_V = 1e-9
PASSES = 3


@dataclass(frozen=True, slots=True)
class Screening:
    """Samples of each record that count, and why others do not.

    used : one ndarray of bool, shape (n,), per record
    rung_s : how long each record rings at its start, s; 0 where it does not
    outliers : how many single samples of each stand out
    """

    used: tuple[Flags, ...]
    rung_s: tuple[float, ...]
    outliers: tuple[int, ...]

    @property
    def is_plain(self) -> bool:
        """Whether all count but those before a record has settled."""
        return not any(self.rung_s) and not any(self.outliers)

    def notes(self, records: Sequence[Record]) -> list[str]:
        """Say what was left out, in sentences."""
        notes = []
        for record, rung_s, outliers in zip(records, self.rung_s, self.outliers, strict=True):
            if rung_s:
                notes.append(
                    f"The first {rung_s:.2g} s of {record.name} get no weight: what is missed there is far above "
                    "all that follows, as when something rings down or the voltage before is another than was said "
                    "(--previous-voltage)."
                )
            if outliers:
                notes.append(
                    f"Without weight, since they stand out singly by {OUTLIER_SDS:g} times the noise or more: "
                    f"{outliers} of the samples of {record.name}. Look for a loose cable where they come often."
                )
        return notes


def settled(records: Sequence[Record]) -> Screening:
    """All samples from the first on that is not at the mercy of what nobody recorded."""
    used = []
    for record in records:
        counts = np.ones(len(record.t_s), dtype=np.bool_)
        counts[: settled_from(record)] = False
        used.append(counts)
    return Screening(tuple(used), (0.0,) * len(used), (0,) * len(used))


def screened(model: ActuatorModel, records: Sequence[Record], before: Screening) -> Screening:
    """Look through what a first fit leaves of the records; return `before` where there is nothing to leave out."""
    looked = [
        looked_through(record, residual_um(model, record), counts)
        for record, counts in zip(records, before.used, strict=True)
    ]
    found = Screening(*(tuple(column) for column in zip(*looked, strict=True)))
    return before if found.is_plain else found


def residual_um(model: ActuatorModel, record: Record) -> Array:
    """Return what a model misses of a record, less the median, shape (n,)."""
    start = model.starting_state(record.t_s, record.u_v, record.previous_v)
    left_um = model.predict(record.t_s, record.u_v, start) - record.y_um
    shifted_um: Array = left_um - np.median(left_um)
    return shifted_um


def looked_through(record: Record, left_um: Array, counts: Flags) -> tuple[Flags, float, int]:
    """Which of the samples that count still do, how long the start rings, s, and how many samples stand out.

    left_um : what a model leaves of the record, less the median, shape (n,)
    """
    first = int(np.argmax(counts))
    begin = first + _rings_for(np.abs(left_um[first:]))
    rung_s = float(record.t_s[begin] - record.t_s[first]) if begin > first else 0.0
    stands_out = _outliers(record, left_um)
    stands_out[:begin] = False
    used = counts & ~stands_out
    used[:begin] = False
    return used, rung_s, int(stands_out.sum())


def _rings_for(left_um: Array) -> int:
    edges = np.linspace(0, len(left_um), min(WINDOWS, len(left_um)) + 1).astype(int)
    largest = np.maximum.reduceat(left_um, edges[:-1])
    most = int(MOST_START_SHARE * len(largest))
    usual_um = float(np.percentile(largest[most:], USUAL))
    if not largest[:2].max() > FAR * usual_um:
        return 0
    quiet = np.flatnonzero(largest[:most] <= usual_um)
    return int(edges[quiet[0]]) if len(quiet) else 0


def _outliers(record: Record, left_um: Array) -> Flags:
    stands_out = standing_out(record, left_um)
    if stands_out.sum() > max(1.0, MOST_OUTLIERS_SHARE * len(left_um)):
        stands_out[:] = False
    return stands_out


def standing_out(record: Record, left_um: Array, run: int = 1) -> Flags:
    """Samples, up to `run` together, farther from both sides than noise goes, or than time a little off explains.

    left_um : what a model leaves of the record, shape (n,)
    """
    stands_out = np.zeros(len(left_um), dtype=np.bool_)
    if len(left_um) <= 2 * run:
        return stands_out
    moved_um = np.abs(np.diff(record.y_um))
    gain = float(np.ptp(record.y_um)) / max(float(np.ptp(record.u_v)), LEAST_V)
    moved_um = np.minimum(moved_um, gain * np.abs(np.diff(record.u_v)))
    most_moved_um = sliding_window_view(moved_um, 2 * run).max(axis=1)
    least_um = OUTLIER_SDS * noise_sd(left_um) + LATE_SHARE * most_moved_um
    sides_um = sliding_window_view(left_um, run)
    before_um, here_um, after_um = sides_um[: -run - 1], left_um[run:-run], sides_um[run + 1 :]
    above_um = here_um - np.maximum(before_um.min(axis=1), after_um.min(axis=1))
    below_um = np.minimum(before_um.max(axis=1), after_um.max(axis=1)) - here_um
    stands_out[run:-run] = np.maximum(above_um, below_um) > least_um
    return stands_out
