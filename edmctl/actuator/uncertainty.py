"""Uncertainty of an identified model: held-out errors, and the scatter of refits to resampled blocks.

Resampling shows the effect of noise. The held-out error, added in quadrature, covers the class of model and slow
drift. The sensor's gain error is in neither. Bands are given for displacement, gain, loop width and creep, because
single weights are not identifiable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edmctl.actuator.design import Reduction, reduce_records
from edmctl.actuator.fitting import Fit, fit
from edmctl.actuator.model import CREEP_FROM_S, CREEP_TO_S, ActuatorModel
from edmctl.actuator.record import Record, half_periods_s, longest_hold_s
from edmctl.actuator.validation import ErrorFigures
from edmctl.array_types import Array, Flags
from edmctl.dataclasses import dataclass

REACH_SHARE = 0.01  # of the range; a play this far outside of where others were is not beyond them
NEAR_RATE = 1.5  # rates, and lengths of holds, within this factor are alike
VOLTAGE = 0  # the play of threshold 0
SMOOTHNESS = (0.0, 1e-4, 1e-3)
SMOOTHNESS_COST = 1.1
"""The smoothest model is taken that has at most this times the least held-out RMS error: swings beyond the
records profit, and held-out blocks of the records cannot show it."""
SQRT_2 = math.sqrt(2.0)
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
        if others and _prepares(others, record):
            groups.append([k for k, block in enumerate(reduction.blocks) if block.record == number])
    return _held_out(reduction, best, groups).errors if groups else None


def _prepares(others: Sequence[Record], record: Record) -> bool:
    margin_v = REACH_SHARE * float(np.ptp(record.u_v))
    return (
        within_rates(record, others)
        and min(float(one.u_v.min()) for one in others) <= record.u_v.min() + margin_v
        and max(float(one.u_v.max()) for one in others) >= record.u_v.max() - margin_v
        and max(map(longest_hold_s, others)) >= longest_hold_s(record) / NEAR_RATE
    )


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
    errors: list[Array] = []
    reached: list[Flags] = []
    at_v: list[Array] = []
    for inside in groups:
        times = [int(k not in inside) for k in range(len(reduction.blocks))]
        found = fit(reduction, smoothness=best.smoothness, times=times, start=best.weights)
        errors += _missed_um(reduction, reduction.model(found.weights), found, inside)
        reached += _reached(reduction, inside)
        at_v += [_plays_of(reduction, k)[:, VOLTAGE] for k in inside]
    if not any(one.any() for one in reached):
        reached = [np.ones_like(one) for one in reached]
    counted = [one[kept] for one, kept in zip(errors, reached, strict=True)]
    rest_um = np.concatenate([one[~kept] for one, kept in zip(errors, reached, strict=True)])
    judged_v = np.concatenate([one[kept] for one, kept in zip(at_v, reached, strict=True)])
    missed_um, widest_um = np.concatenate(errors), _widest_um(reduction)
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
    plays_v = (_plays_of(reduction, k) for k in inside)
    return [((at_v >= low_v) & (at_v <= high_v)).all(axis=1) for at_v in plays_v]


def _plays_of(reduction: Reduction, k: int) -> Array:
    block = reduction.blocks[k]
    own = slice(block.first, block.end)
    at_v: Array = reduction.plays_v[block.record][own][reduction.used[block.record][own]]
    return at_v


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
        errors_um[number] = error_um + _zero_of(found, number, error_um[reduction.used[number]])
    missed_um = []
    for block in (reduction.blocks[k] for k in inside):
        own = slice(block.first, block.end)
        missed_um.append(errors_um[block.record][own][reduction.used[block.record][own]])
    return missed_um


def _zero_of(found: Fit, number: int, error_um: Array) -> float:
    """Return the zero of a record; for one that was held out whole, by its mean."""
    zero_um = float(found.zeros_um[number])
    return float(-error_um.mean()) if np.isnan(zero_um) else zero_um


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
    missed = SQRT_2 * missed_um / held_out.range_um  # a difference of two displacements, of the range
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
