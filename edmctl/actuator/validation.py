"""How good a model is: its errors on records, on held-out blocks of them, and the scatter of refits.

Errors on other records count after the zero, or gain and zero, are set again. Resampling blocks shows the effect of
noise; the held-out error, added in quadrature, covers the class of model and slow drift. Neither contains the gain
error of the sensor. Bands are given for displacement, gain, loop width and creep: single weights are not
identifiable.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Literal

import numpy as np

from edmctl.actuator.fitting import Fit, Reduction, fit, reduce_records
from edmctl.actuator.model import CREEP_FROM_S, CREEP_TO_S, ActuatorModel
from edmctl.actuator.record import Record, check_numbers, half_periods_s, longest_hold_s, settled_from
from edmctl.actuator.screening import looked_through
from edmctl.array_types import Array, Flags
from edmctl.dataclasses import astuple, dataclass, replace

Refit = Literal["gain", "zero"]
ZERO: tuple[Refit, ...] = ("zero",)
AT_ONCE = 3  # samples whose mean has little noise left


@dataclass(frozen=True, slots=True)
class ErrorFigures:
    """Largest and RMS error, in µm and in % of the range of displacement."""

    max_um: float
    rms_um: float
    max_pct: float
    rms_pct: float
    range_um: float

    @classmethod
    def of_range(cls, max_um: float, rms_um: float, range_um: float) -> ErrorFigures:
        """Figures of such errors on displacements of such a range, µm."""
        return cls(max_um, rms_um, 100.0 * max_um / range_um, 100.0 * rms_um / range_um, range_um)

    @classmethod
    def pooled(cls, figures: Sequence[ErrorFigures], samples: Sequence[int]) -> ErrorFigures:
        """Figures of several records: worst maximum, RMS over all samples, widest range."""
        max_um, rms_um, max_pct, rms_pct, range_um = zip(*map(astuple, figures), strict=True)

        def rms(values: Sequence[float]) -> float:
            return math.sqrt(float(np.average(np.square(values), weights=samples)))

        return cls(max(max_um), rms(rms_um), max(max_pct), rms(rms_pct), max(range_um))

    @classmethod
    def over(cls, errors_um: Array, range_um: float) -> ErrorFigures:
        """Figures of errors, shape (n,), on displacements of such a range."""
        return cls.of_range(float(np.abs(errors_um).max()), float(np.sqrt(np.mean(errors_um**2))), range_um)

    @classmethod
    def without_noise(cls, stretches_um: Sequence[Array], range_um: float) -> ErrorFigures:
        """Figures of what neighbouring errors of each stretch, shape (n,), have in common.

        Noise that differs from sample to sample is not in them: the mean square is that of the products of
        neighbours, the largest error that of the mean of three. What lasts less than three samples is not seen.
        """
        long = [one for one in stretches_um if len(one) >= AT_ONCE]
        if not long:
            return cls.over(np.concatenate(stretches_um), range_um)
        mean_square = float(np.concatenate([one[1:] * one[:-1] for one in long]).mean())
        means_um = np.concatenate(
            [np.convolve(one, np.full(AT_ONCE, 1.0 / AT_ONCE), "valid") for one in long]
        )
        return cls.of_range(float(np.abs(means_um).max()), math.sqrt(max(0.0, mean_square)), range_um)


@dataclass(frozen=True, slots=True)
class Validation:
    """Errors on one record from sample `first` on, with the gain and the zero that were set for it.

    screened : the same without a start that rings and single samples that stand out, which get no weight in an
        identification; None where there are none
    rung_s, outliers : how long the first and how many the second are
    """

    errors: ErrorFigures
    gain: float
    zero_um: float
    first: int
    screened: ErrorFigures | None = None
    rung_s: float = 0.0
    outliers: int = 0


def validate(model: ActuatorModel, record: Record, refit: Collection[Refit] = ZERO) -> Validation:
    """Judge a model on a record that it was not identified from.

    refit : what is fitted to the record by least squares first: the zero, because it is lost when a sensor or a
        tool is touched; the gain too where the record is of another day (temperature).

    Where the voltage before the record is not stated, and the record soon visits both its ends, it is
    judged from then on: before, its hysteresis is unknown. Raises ValueError for a record without two samples, with
    numbers that are not finite, or without a displacement that changes.
    """
    check_numbers(record)
    if len(record.t_s) < 2 or not np.ptp(record.y_um) > 0.0:
        raise ValueError(f"{record.name}: the displacement does not change, so that nothing can be judged")
    start = model.starting_state(record.t_s, record.u_v, record.previous_v)
    predicted_um = model.predict(record.t_s, record.u_v, start)
    whole = judge(predicted_um, record.y_um, refit, settled_from(record))
    left_um = whole.gain * predicted_um - record.y_um
    counts = np.arange(len(left_um)) >= whole.first
    used, rung_s, outliers = looked_through(record, left_um - np.median(left_um), counts)
    if not (rung_s or outliers):
        return whole
    screened = judge(predicted_um[used], record.y_um[used], refit).errors
    return replace(whole, screened=screened, rung_s=rung_s, outliers=outliers)


def judge(
    predicted_um: Array, measured_um: Array, refit: Collection[Refit] = ZERO, first: int = 0
) -> Validation:
    """As `validate`, for a prediction from anywhere, shape (n,) each, from sample `first` on."""
    predicted_um, measured_um = predicted_um[first:], measured_um[first:]
    gain, zero_um = 1.0, 0.0
    centre_um, mean_um = float(predicted_um.mean()), float(measured_um.mean())
    if "gain" in refit:
        swing_um = predicted_um - (centre_um if "zero" in refit else 0.0)
        gain = float(swing_um @ measured_um) / max(float(swing_um @ swing_um), 1e-300)
    if "zero" in refit:
        zero_um = mean_um - gain * centre_um
    errors_um = gain * predicted_um + zero_um - measured_um
    return Validation(ErrorFigures.over(errors_um, float(np.ptp(measured_um))), gain, zero_um, first)


REACH_SHARE = 0.01  # of the range; a play this far outside of where others were is not beyond them
NEAR_RATE = 1.5  # rates, and lengths of holds, within this factor are alike
VOLTAGE = 0  # the play of threshold 0
SMOOTHNESS = (0.0, 1e-4, 1e-3)
SMOOTHNESS_COST = 1.1
"""The smoothest model is taken that has at most this times the least held-out RMS error: swings beyond the
records profit, and held-out blocks of the records cannot show it."""
CREEP_DECADES = math.log10(CREEP_TO_S / CREEP_FROM_S)
BOOTSTRAP_SEED = 20090804  # fixed, so that the same record gives the same file


@dataclass(frozen=True, slots=True)
class HeldOut:
    """What fits miss of blocks that they did not see.

    errors : of samples whose plays lie within what the other blocks reached
    of_model : of the same, without the noise of the sensor
    beyond : of the others, which no block of the record prepares a model for; None: there are none
    beyond_share : their share
    low_v, high_v : how far down and up the first reach
    rms_um : of all, µm
    """

    errors: ErrorFigures
    of_model: ErrorFigures
    beyond: ErrorFigures | None
    beyond_share: float
    low_v: float
    high_v: float
    rms_um: float


def smoothest(reduction: Reduction, folds: int) -> tuple[Fit, HeldOut]:
    """Return the smoothest fit that predicts about as well as the best, and its held-out errors."""
    tried: list[tuple[Fit, HeldOut]] = []
    start = None
    for smoothness in SMOOTHNESS:
        best = fit(reduction, smoothness=smoothness, start=start)
        start = best.weights
        tried.append((best, _held_out(reduction, best, _contiguous(reduction, folds))))
    least_um = min(held_out.rms_um for _, held_out in tried)
    return [one for one in tried if one[1].rms_um <= SMOOTHNESS_COST * least_um][-1]


def held_out_of(reduction: Reduction, smoothness: float, folds: int) -> HeldOut:
    """Return the held-out errors of contiguous folds at a smoothness that is known."""
    return _held_out(reduction, fit(reduction, smoothness=smoothness), _contiguous(reduction, folds))


def whole_records(reduction: Reduction, best: Fit) -> ErrorFigures | None:
    """Return held-out errors of whole records, each predicted by a fit of the others.

    A record takes part if others swing as far, at such rates, and hold as long. None if no record does.
    """
    groups = []
    for number, record in enumerate(reduction.records):
        others = [other for k, other in enumerate(reduction.records) if k != number]
        if not others or not within_rates(record, others):
            continue
        margin_v = REACH_SHARE * float(np.ptp(record.u_v))
        low_v, high_v = min(one.u_v.min() for one in others), max(one.u_v.max() for one in others)
        reaches = low_v <= record.u_v.min() + margin_v and high_v >= record.u_v.max() - margin_v
        if reaches and max(map(longest_hold_s, others)) >= longest_hold_s(record) / NEAR_RATE:
            groups.append([k for k, block in enumerate(reduction.blocks) if block.record == number])
    return _held_out(reduction, best, groups).errors if groups else None


def within_rates(record: Record, others: Sequence[Record]) -> bool:
    """Whether a record swings at rates between those of others, or near them."""
    swings_s = [half_periods_s(one) for one in (record, *others)]
    if not all(map(len, swings_s)):
        return False
    own_s, *others_s = (float(np.median(one)) for one in swings_s)
    return min(others_s) / NEAR_RATE <= own_s <= max(others_s) * NEAR_RATE


def apart(reduction: Reduction, smoothness: float, folds: int) -> ErrorFigures:
    """Return the held-out errors of records that are each fitted alone."""
    alone = []
    for record, counts in zip(reduction.records, reduction.used, strict=True):
        own = reduce_records(reduction.design, [record], reduction.delays_s, [counts])
        alone.append(held_out_of(own, smoothness, folds).errors)
    return ErrorFigures.pooled(alone, [int(counts.sum()) for counts in reduction.used])


def _held_out(reduction: Reduction, best: Fit, groups: Sequence[Sequence[int]]) -> HeldOut:
    """Return the errors of cross-validation: each group of blocks is predicted by a fit of all others."""
    blocks: list[tuple[Array, Flags, Array]] = []  # errors, which plays are reached, voltage
    for inside in groups:
        times = [int(k not in inside) for k in range(len(reduction.blocks))]
        found = fit(reduction, smoothness=best.smoothness, times=times, start=best.weights)
        missed = _missed_um(reduction, reduction.model(found.weights), found, inside)
        at_v = [reduction.chosen(k, reduction.plays_v)[:, VOLTAGE] for k in inside]
        blocks += zip(missed, _reached(reduction, inside), at_v, strict=True)
    if not any(kept.any() for _, kept, _ in blocks):
        blocks = [(one, np.ones_like(kept), at_v) for one, kept, at_v in blocks]
    counted = [one[kept] for one, kept, _ in blocks]
    rest_um = np.concatenate([one[~kept] for one, kept, _ in blocks])
    judged_v = np.concatenate([at_v[kept] for _, kept, at_v in blocks])
    missed_um, widest_um = np.concatenate([one for one, _, _ in blocks]), _widest_um(reduction)
    return HeldOut(
        errors=ErrorFigures.over(np.concatenate(counted), widest_um),
        of_model=ErrorFigures.without_noise(counted, widest_um),
        beyond=ErrorFigures.over(rest_um, widest_um) if len(rest_um) else None,
        beyond_share=len(rest_um) / len(missed_um),
        low_v=float(judged_v.min()),
        high_v=float(judged_v.max()),
        rms_um=float(np.sqrt(np.mean(missed_um**2))),
    )


def _contiguous(reduction: Reduction, folds: int) -> list[range]:
    count = len(reduction.blocks)
    return [range(fold * count // folds, (fold + 1) * count // folds) for fold in range(folds)]


def _reached(reduction: Reduction, inside: Sequence[int]) -> list[Flags]:
    """Return which samples of some blocks have all plays within the range of the other blocks, block by block."""
    others = [block for k, block in enumerate(reduction.blocks) if k not in inside]
    margin_v = REACH_SHARE * (reduction.design.high_v - reduction.design.low_v)
    low_v = np.min([block.low_v for block in others], axis=0) - margin_v
    high_v = np.max([block.high_v for block in others], axis=0) + margin_v
    plays_v = (reduction.chosen(k, reduction.plays_v) for k in inside)
    return [((at_v >= low_v) & (at_v <= high_v)).all(axis=1) for at_v in plays_v]


def figures(reduction: Reduction, model: ActuatorModel, found: Fit) -> ErrorFigures:
    """Return the errors of a model on all blocks, with the zeros of its fit."""
    everywhere = range(len(reduction.blocks))
    missed_um = np.concatenate(_missed_um(reduction, model, found, everywhere))
    return ErrorFigures.over(missed_um, _widest_um(reduction))


def _widest_um(reduction: Reduction) -> float:
    return max(float(np.ptp(record.y_um)) for record in reduction.records)


def _missed_um(reduction: Reduction, model: ActuatorModel, found: Fit, inside: Sequence[int]) -> list[Array]:
    errors_um = {}
    for number in {reduction.blocks[k].record for k in inside}:
        record = reduction.records[number]
        start = model.starting_state(record.t_s, record.u_v, record.previous_v)
        error_um = model.predict(record.t_s, record.u_v, start) - model.zero_um - record.y_um
        zero_um = float(found.zeros_um[number])
        if np.isnan(zero_um):  # the record was held out whole
            zero_um = float(-error_um[reduction.used[number]].mean())
        errors_um[number] = error_um + zero_um
    return [reduction.chosen(k, errors_um) for k in inside]


@dataclass(frozen=True, slots=True)
class Bands:
    """Standard uncertainties (one sd) of what a model says, with the values they belong to.

    displacement_sd_um, displacement_sd_max_um : mean and largest over the records
    loop_width : opening of the full loop at the middle of the range, relative to the stroke
    gamma_per_decade : creep per decade of time, relative to the step
    """

    displacement_sd_um: float
    displacement_sd_max_um: float
    gain_um_per_v: float
    gain_sd_um_per_v: float
    loop_width: float
    loop_width_sd: float
    gamma_per_decade: float
    gamma_sd_per_decade: float


def bands_of(reduction: Reduction, best: Fit, held_out: ErrorFigures, resamples: int) -> Bands:
    """Block bootstrap: refit `resamples` times to as many blocks, drawn with replacement."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    count = len(reduction.blocks)
    drawn_um: list[Array] = []
    drawn: list[tuple[float, float, float]] = []
    for _ in range(resamples):
        times = np.bincount(rng.integers(count, size=count), minlength=count).tolist()
        found = fit(reduction, times=times, smoothness=best.smoothness, start=best.weights)
        drawn_um.append(reduction.sketch @ found.weights + float(np.nanmean(found.zeros_um)))
        drawn.append(_shape(reduction.model(found.weights)))
    spread_um = np.std(drawn_um, axis=0) if drawn_um else np.zeros(1)
    gain_sd, width_sd, gamma_sd = np.std(drawn, axis=0) if drawn else np.zeros(3)
    gain, width, gamma = _shape(reduction.model(best.weights))
    missed_um = held_out.rms_um
    missed = math.sqrt(2.0) * missed_um / held_out.range_um  # a difference of two displacements, of the range
    return Bands(
        displacement_sd_um=math.hypot(spread_um.mean(), missed_um),
        displacement_sd_max_um=math.hypot(spread_um.max(), missed_um),
        gain_um_per_v=gain,
        gain_sd_um_per_v=math.hypot(gain_sd, gain * missed),
        loop_width=width,
        loop_width_sd=math.hypot(width_sd, missed),
        gamma_per_decade=gamma,
        gamma_sd_per_decade=math.hypot(gamma_sd, missed / CREEP_DECADES),
    )


def _shape(model: ActuatorModel) -> tuple[float, float, float]:
    return model.gain_um_per_v, model.loop_width, model.gamma_per_decade
