"""Samples without weight, and records without suspected faults: outliers, wrong memory, drift.

A ringing start and single samples that stand out are found in the residual of a first fit and get no weight; knocks
and jumps of the sensor last longer and keep theirs. Plays and slow creep absorb part of a drift, so a polynomial of
time is fitted together with the features that the model uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from edmctl.actuator.fitting import Design, features_of
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import Record, noise_sd, settled_from
from edmctl.array_types import Array, Flags
from edmctl.dataclasses import dataclass

WINDOWS = 400  # a record is looked at in so many parts, each by its largest residual
MOST_START_SHARE = 0.2  # a start that takes longer is no start
FAR, USUAL = 2.5, 95.0
"""A start rings where it is so many times above the percentile of the parts that follow."""
OUTLIER_SDS = 6.0
OFTEN = 1e-4  # share of single outliers that suggests a loose contact
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
                    f"{outliers} of the {len(record.t_s)} samples of {record.name} differ from the fit by "
                    f"{OUTLIER_SDS:g} times the noise or more and get no weight."
                    + (" Look for a loose cable." if outliers > OFTEN * len(record.t_s) else "")
                )
        return notes


def settled(records: Sequence[Record]) -> Screening:
    """All samples from the first that does not depend on the voltage before the record."""
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
    left_um: Array = model.predict(record.t_s, record.u_v, start) - record.y_um
    return left_um - np.median(left_um)


def looked_through(record: Record, left_um: Array, counts: Flags) -> tuple[Flags, float, int]:
    """Which of the samples that count still do, how long the start rings, s, and how many samples stand out.

    left_um : what a model leaves of the record, less the median, shape (n,)
    """
    first = int(np.argmax(counts))
    begin = first + _rings_for(np.abs(left_um[first:]))
    rung_s = float(record.t_s[begin] - record.t_s[first]) if begin > first else 0.0
    stands_out = standing_out(record, left_um)
    if stands_out.sum() > max(1.0, MOST_OUTLIERS_SHARE * len(left_um)):
        stands_out[:] = False
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


POLYNOMIAL = 2  # of time, which drift follows
LONGEST_RUN, LEAST_OUTLIERS = 3, 10
"""Samples that stand out together, and how many at least: fewer are knocks, to be told by their place."""
ROUNDING = 1e-9


class Without(NamedTuple):
    """Records without what is suspected, samples of each that count, and what was left out, with the remedy."""

    records: list[Record]
    used: list[Flags]
    words: str


def suspects(
    design: Design, weights: Array, model: ActuatorModel, records: Sequence[Record], used: Sequence[Flags]
) -> list[Without]:
    """What records may suffer from, each by the records without it.

    weights, model : what a fit of the records has found
    """
    fitted = [
        _Fitted.of(design, weights, model, record, counts)
        for record, counts in zip(records, used, strict=True)
    ]
    found = [_without_outliers(fitted), _with_another_memory(fitted), _without_drift(fitted)]
    return [one for one in found if one is not None]


@dataclass(frozen=True, slots=True)
class _Fitted:
    """A record, its samples that count, and its residual.

    base : columns that the fit uses, orthonormal, shape (n, c), at the samples `index`
    left_um : what they leave of the displacement there
    """

    record: Record
    counts: Flags
    residual_um: Array
    index: NDArray[np.int64]
    base: Array
    left_um: Array

    @classmethod
    def of(
        cls, design: Design, weights: Array, model: ActuatorModel, record: Record, counts: Flags
    ) -> _Fitted:
        """Project the features with a weight out of the displacement, and a zero."""
        index = np.flatnonzero(counts & (record.t_s + model.delay_s <= record.t_s[-1]))
        columns = features_of(design, record)[np.ix_(index, np.flatnonzero(weights > 0.0))]
        base, triangle = np.linalg.qr(np.column_stack([np.ones(len(index)), columns]))
        size = np.abs(np.diag(triangle))
        base = base[:, size > ROUNDING * size.max(initial=0.0)]
        y_um = np.interp(record.t_s[index] + model.delay_s, record.t_s, record.y_um)
        left_um = y_um - base @ (base.T @ y_um)
        return cls(record, counts, residual_um(model, record), index, base, left_um)


def _without_outliers(fitted: Sequence[_Fitted]) -> Without | None:
    """Exclude samples that stand out, up to three together; None if there are few."""
    far = [one.counts & standing_out(one.record, one.residual_um, LONGEST_RUN) for one in fitted]
    counts = [int(one.sum()) for one in far]
    if sum(counts) < LEAST_OUTLIERS:
        return None
    worst = int(np.argmax(counts))
    record, first = fitted[worst].record, int(far[worst].argmax())
    words = (
        f"{sum(counts)} samples stand out from those beside them, the first at {record.t_s[first]:.4g} s of "
        f"{record.name}: look for a loose cable or a source of interference, or leave these samples out"
    )
    kept = [one.counts & ~out for one, out in zip(fitted, far, strict=True)]
    return Without([one.record for one in fitted], kept, words)


def _with_another_memory(fitted: Sequence[_Fitted]) -> Without | None:
    """As of actuators that had been held at the first voltage; None if all records state what was before.

    Swings that grow wipe out little by little what an actuator remembers, so that a wrong memory looks like a drift.
    """
    held, names = [], []
    for record in (one.record for one in fitted):
        if record.previous_v is None:
            names.append(record.name)
            record = record._replace(previous_v=float(record.u_v[0]))
        held.append(record)
    if not names:
        return None
    words = (
        f"{', '.join(names)} begins as of an actuator that had not been cycled: say what it was held at before "
        "(--previous-voltage), or begin with two full swings"
    )
    return Without(held, [one.counts for one in fitted], words)


def _without_drift(fitted: Sequence[_Fitted]) -> Without:
    """Remove the polynomials of time that explain most."""
    mended, drifts_um = [], []
    for one in fitted:
        record = one.record
        along = 2.0 * (record.t_s - record.t_s[0]) / np.ptp(record.t_s) - 1.0
        powers = np.stack([along**power for power in range(1, POLYNOMIAL + 1)], axis=1)
        own = powers[one.index]
        own = own - one.base @ (one.base.T @ own)
        drift_um = powers @ np.linalg.lstsq(own, one.left_um, rcond=1e-6)[0]
        mended.append(record._replace(y_um=record.y_um - drift_um))
        drifts_um.append(float(np.ptp(drift_um)))
    worst = int(np.argmax(drifts_um))
    words = (
        f"it follows time, by {drifts_um[worst]:.2g} µm or so over {mended[worst].name}: the sensor or the machine "
        "drifts. Let them warm up, and measure again"
    )
    return Without(mended, [one.counts for one in fitted], words)
