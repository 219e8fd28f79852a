"""Records without suspected faults: outliers, ringing, a wrong memory, a shift or a drift of the displacement.

Plays and slow creep absorb part of a shift or drift. So a step or a polynomial of time is fitted together with the
features that the model uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.design import Design, features_of
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import Record
from edmctl.actuator.screening import residual_um, standing_out
from edmctl.array_types import Array, Flags
from edmctl.dataclasses import dataclass

POLYNOMIAL = 2  # of time, which drift follows
LEAST_SIDE_SHARE = 0.01  # of a record, on either side of a shift
SHIFTING_SHARE = 0.001  # of a record, that a shift takes on either side
LONGEST_RUN, LEAST_OUTLIERS = 3, 10
"""Samples that stand out together, and how many at least: fewer are knocks, to be told by their place."""
ROUNDING = 1e-9


class Without(NamedTuple):
    """Records without what is suspected, samples of each that count, and what was left out, with the remedy."""

    records: list[Record]
    used: list[Flags]
    words: str


def suspects(
    design: Design,
    weights: Array,
    model: ActuatorModel,
    records: Sequence[Record],
    used: Sequence[Flags],
) -> list[Without]:
    """What records may suffer from, each by the records without it.

    weights, model : what a fit of the records has found
    """
    beside = [
        _Beside.of(design, weights, model.delay_s, record, counts)
        for record, counts in zip(records, used, strict=True)
    ]
    residuals_um = [residual_um(model, record) for record in records]
    ringing = _without_ringing(records, residuals_um, used)
    outliers = None if ringing else _without_outliers(residuals_um, records, used)
    memory = _with_another_memory(records, used)
    return [
        *([ringing] if ringing else []),
        *([outliers] if outliers else []),
        *([memory] if memory else []),
        _without_shift(beside, model.delay_s, records, used),
        _without_drift(beside, records, used),
    ]


@dataclass(frozen=True, slots=True)
class _Beside:
    """Columns that a fit uses, as an orthonormal base of shape (n, c), and what they leave of a record."""

    index: NDArray[np.int64]
    base: Array
    left_um: Array

    @classmethod
    def of(cls, design: Design, weights: Array, delay_s: float, record: Record, counts: Flags) -> _Beside:
        """Project the features with a weight out of the displacement, and a zero."""
        index = np.flatnonzero(counts & (record.t_s + delay_s <= record.t_s[-1]))
        columns = features_of(design, record)[np.ix_(index, np.flatnonzero(weights > 0.0))]
        base, triangle = np.linalg.qr(np.column_stack([np.ones(len(index)), columns]))
        size = np.abs(np.diag(triangle))
        base = base[:, size > ROUNDING * size.max(initial=0.0)]
        y_um = np.interp(record.t_s[index] + delay_s, record.t_s, record.y_um)
        return cls(index, base, y_um - base @ (base.T @ y_um))

    def shift(self) -> tuple[float, int, float]:
        """Of the best step: squares that it explains, µm², the sample in `index` where it begins, its height, µm."""
        count = len(self.index)
        steps = np.arange(count, 0, -1.0)
        after = np.cumsum(self.base[::-1], axis=0)[::-1]
        own = steps - np.einsum("nc,nc->n", after, after)
        along_um = np.cumsum(self.left_um[::-1])[::-1]
        edge = max(1, round(LEAST_SIDE_SHARE * count))
        seen = np.flatnonzero(own > ROUNDING * steps)
        seen = seen[(seen >= edge) & (seen < count - edge)]
        if not len(seen):
            return 0.0, 0, 0.0
        gains = along_um[seen] ** 2 / own[seen]
        best = int(gains.argmax())
        k = int(seen[best])
        return float(gains[best]), k, float(along_um[k] / own[k])


def _without_ringing(
    records: Sequence[Record], residuals_um: Sequence[Array], used: Sequence[Flags]
) -> Without | None:
    """Exclude the samples after steps; None if no resonance rings there."""
    found = ringing_of(records, residuals_um, used)
    if found is None:
        return None
    words = (
        f"the actuator rings at {found.frequency_hz:.3g} Hz after steps, by up to {found.amplitude_um:.3g} µm, "
        "and the model has no resonance. Drive ramps that last several periods instead of steps, damp the mounting, "
        "or filter the amplifier's input"
    )
    quiet = [counts & ~after for counts, after in zip(used, found.after_steps, strict=True)]
    return Without(list(records), quiet, words)


def _without_outliers(
    residuals_um: Sequence[Array], records: Sequence[Record], used: Sequence[Flags]
) -> Without | None:
    """Exclude samples that stand out, up to three together; None if there are few."""
    far = [
        counts & standing_out(record, left_um, LONGEST_RUN)
        for record, left_um, counts in zip(records, residuals_um, used, strict=True)
    ]
    outliers = sum(int(one.sum()) for one in far)
    if outliers < LEAST_OUTLIERS:
        return None
    worst = int(np.argmax([int(one.sum()) for one in far]))
    first_s = float(records[worst].t_s[int(far[worst].argmax())])
    words = (
        f"{outliers} samples stand out from those beside them, the first at {first_s:.4g} s of "
        f"{records[worst].name}: look for a loose cable or a source of interference, or leave these samples out"
    )
    return Without(list(records), [counts & ~one for counts, one in zip(used, far, strict=True)], words)


def _with_another_memory(records: Sequence[Record], used: Sequence[Flags]) -> Without | None:
    """As of actuators that had been held at the first voltage; None where all records say what was before.

    Swings that grow wipe out little by little what an actuator remembers, so that a wrong memory looks like a drift.
    """
    unknown = [number for number, record in enumerate(records) if record.previous_v is None]
    if not unknown:
        return None
    held = [
        record._replace(previous_v=float(record.u_v[0])) if record.previous_v is None else record
        for record in records
    ]
    names = ", ".join(records[number].name for number in unknown)
    words = (
        f"{names} begins as of an actuator that had not been cycled: say what it was held at before "
        "(--previous-voltage), or begin with two full swings"
    )
    return Without(held, list(used), words)


def _without_shift(
    beside: Sequence[_Beside], delay_s: float, records: Sequence[Record], used: Sequence[Flags]
) -> Without:
    """Remove the step that explains most, and exclude the samples around it."""
    found = [one.shift() for one in beside]
    worst = int(np.argmax([gain for gain, _, _ in found]))
    record, (_, k, height_um) = records[worst], found[worst]
    reached = record.t_s[beside[worst].index[k : k + 1]] + delay_s
    begin = int(np.abs(record.t_s - reached).argmin()) if len(reached) else 0
    reach = 1 + round(SHIFTING_SHARE * len(record.t_s))
    y_um, counts = record.y_um.copy(), used[worst].copy()
    y_um[begin:] -= height_um
    counts[max(0, begin - reach) : begin + reach] = False
    words = (
        f"the displacement shifts by {height_um:+.2g} µm or so at {record.t_s[begin]:.4g} s of {record.name} and "
        "stays there: look for a sensor or a mount that moved, and give the parts as files of their own"
    )
    mended, counting = list(records), list(used)
    mended[worst], counting[worst] = record._replace(y_um=y_um), counts
    return Without(mended, counting, words)


def _without_drift(beside: Sequence[_Beside], records: Sequence[Record], used: Sequence[Flags]) -> Without:
    """Remove the polynomials of time that explain most."""
    mended, drifts_um = [], []
    for record, one in zip(records, beside, strict=True):
        along = 2.0 * (record.t_s - record.t_s[0]) / np.ptp(record.t_s) - 1.0
        powers = np.stack([along**power for power in range(1, POLYNOMIAL + 1)], axis=1)
        own = powers[one.index]
        own = own - one.base @ (one.base.T @ own)
        drift_um = powers @ np.linalg.lstsq(own, one.left_um, rcond=1e-6)[0]
        mended.append(record._replace(y_um=record.y_um - drift_um))
        drifts_um.append(float(np.ptp(drift_um)))
    worst = int(np.argmax(drifts_um))
    words = (
        f"it follows time, by {drifts_um[worst]:.2g} µm or so over {records[worst].name}: the sensor or the machine "
        "drifts. Let them warm up, and measure again"
    )
    return Without(mended, list(used), words)


STEP_SHARE, STEP_SAMPLES = 0.05, 8
"""A step moves the voltage by this share of its span within so many samples."""
FEWEST_STEPS = 3
WINDOW, SHORTEST_WINDOW = 128, 24  # samples after a step that are looked at, fewer where steps follow sooner
LOWEST_CYCLES = 3  # a line has this many cycles in a window
LINE_BINS = 2  # on either side of a line, that belong to it
LINE_SHARE = 0.5  # of the squares after steps, that are in a line
DECAY_FACTOR = 2.0  # the line's squares in a window are at least this many times those in the next one


class Ringing(NamedTuple):
    """A resonance: its frequency, its largest amplitude, and the samples after steps of each record."""

    frequency_hz: float
    amplitude_um: float
    after_steps: tuple[Flags, ...]


def ringing_of(
    records: Sequence[Record], residuals_um: Sequence[Array], used: Sequence[Flags]
) -> Ringing | None:
    """Return the resonance in what a model misses of records, shape (n,) each; None if there is none."""
    found = [
        one
        for record, left_um, counts in zip(records, residuals_um, used, strict=True)
        if (one := _line(record, left_um, counts)) is not None
    ]
    if not found:
        return None
    strongest = max(found, key=lambda one: one[1])
    after = []
    for record, counts in zip(records, used, strict=True):
        mask = np.zeros(len(record.t_s), dtype=np.bool_)
        ends, length = _steps(record, counts)
        for end in ends:
            mask[max(0, end - STEP_SAMPLES) : end + 2 * length] = True
        after.append(mask)
    return Ringing(*strongest, tuple(after))


def _line(record: Record, left_um: Array, counts: Flags) -> tuple[float, float] | None:
    ends, length = _steps(record, counts)
    if len(ends) < FEWEST_STEPS:
        return None
    after = _spectrum([left_um[end : end + length] for end in ends])
    later = _spectrum([left_um[end + length : end + 2 * length] for end in ends])
    k = LOWEST_CYCLES + int(np.argmax(after[LOWEST_CYCLES:]))
    line = slice(max(1, k - LINE_BINS), k + LINE_BINS + 1)
    in_line = float(after[line].sum())
    if in_line < LINE_SHARE * float(after.sum()) or in_line < DECAY_FACTOR * float(later[line].sum()):
        return None
    low, here, high = (float(after[n]) if n < len(after) else 0.0 for n in (k - 1, k, k + 1))
    centre = k + (high - low) / (low + here + high)
    amplitude_um = max(float(np.abs(left_um[end : end + length]).max()) for end in ends)
    return centre / (length * float(np.median(np.diff(record.t_s)))), amplitude_um


def _spectrum(windows_um: Sequence[Array]) -> Array:
    values = np.array(windows_um)
    along = np.linspace(-1.0, 1.0, values.shape[1])
    values = values - values.mean(axis=1, keepdims=True)
    values = values - np.outer(values @ along / (along @ along), along)
    squares: Array = (np.abs(np.fft.rfft(values, axis=1)) ** 2).mean(axis=0)
    return squares


def _steps(record: Record, counts: Flags) -> tuple[list[int], int]:
    """Return the ends of the steps, and half the shortest time to the next step in samples."""
    least_v = STEP_SHARE * float(np.ptp(record.u_v))
    moved_v = np.abs(np.diff(record.u_v))
    is_fast = moved_v > least_v / STEP_SAMPLES
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_fast, [False]]).astype(int)))
    begins, ends = edges[::2], edges[1::2]
    free = np.append(begins[1:], len(record.u_v)) - ends
    kept = (ends - begins <= STEP_SAMPLES) & (free >= 2 * SHORTEST_WINDOW) & counts[ends]
    kept &= np.abs(record.u_v[ends] - record.u_v[begins]) >= least_v
    if not kept.any():
        return [], 0
    return ends[kept].tolist(), int(min(WINDOW, free[kept].min() // 2))
