"""How sure an identified model is: what it misses on blocks that a fit did not see, and the scatter of refits.

The smoothness that predicts best is found by blocked cross-validation. Resampling contiguous blocks shows how far
noise moves the fit. It cannot show what the class of model cannot follow, nor drift that is slower than a block:
the held-out error stands for those, added in quadrature. The sensor's own gain error is in neither: no record
through that sensor shows it.

Single weights are not identifiable (many sets of them draw the same loops), so bands are given for what they add up
to: the displacement, the gain, the width of the loop and the creep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.fitting import Fit, fit
from edmctl.actuator.model import CREEP_FROM_S, CREEP_TO_S
from edmctl.actuator.validation import ErrorFigures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.design import Design, Reduction
    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]

SMOOTHNESS = (0.0, 1e-4, 1e-3)
SMOOTHNESS_COST = 1.1
"""The smoothest model is taken that has at most this times the least held-out RMS error: swings beyond the
records profit, and held-out blocks of the records cannot show it."""
SQRT_2 = math.sqrt(2.0)
CREEP_DECADES = math.log10(CREEP_TO_S / CREEP_FROM_S)
BOOTSTRAP_SEED = 20090804
"""Fixed, so that the same record gives the same file."""


def smoothest(
    design: Design, reduction: Reduction, records: Sequence[Record], delay_s: float, folds: int
) -> tuple[float, Fit, ErrorFigures]:
    """The smoothest fit that predicts about as well as the best: its smoothness, the fit, its held-out errors."""
    tried: list[tuple[float, Fit, ErrorFigures]] = []
    start = None
    for smoothness in SMOOTHNESS:
        best = fit(design, reduction, smoothness=smoothness, start=start)
        start = best.weights
        held_out = _held_out(design, reduction, records, best, delay_s, smoothness, folds)
        tried.append((smoothness, best, held_out))
    least_um = min(held_out.rms_um for _, _, held_out in tried)
    return [one for one in tried if one[2].rms_um <= SMOOTHNESS_COST * least_um][-1]


def _held_out(
    design: Design,
    reduction: Reduction,
    records: Sequence[Record],
    best: Fit,
    delay_s: float,
    smoothness: float,
    folds: int,
) -> ErrorFigures:
    """Errors of blocked cross-validation: each contiguous fold is predicted by a fit of all the others."""
    count = len(reduction.blocks)
    judged = []
    for fold in range(folds):
        inside = range(fold * count // folds, (fold + 1) * count // folds)
        times = [0 if k in inside else 1 for k in range(count)]
        found = fit(design, reduction, smoothness=smoothness, times=times, start=best.weights)
        judged.append((design.model(found.weights, 0.0, delay_s), found, inside))
    return figures(records, reduction, judged)


def figures(
    records: Sequence[Record], reduction: Reduction, judged: Sequence[tuple[ActuatorModel, Fit, range]]
) -> ErrorFigures:
    """Errors of models, each on its blocks, with the zeros of their fits."""
    errors: list[Array] = []
    for model, found, inside in judged:
        for number in {reduction.blocks[k].record for k in inside}:
            record = records[number]
            start = model.starting_state(record.t_s, record.u_v, record.previous_v)
            error_um = model.predict(record.t_s, record.u_v, start) - model.zero_um - record.y_um
            zero_um = _zero_of(found, number, error_um)
            blocks = (reduction.blocks[k] for k in inside if reduction.blocks[k].record == number)
            errors += [error_um[block.first : block.end] + zero_um for block in blocks]
    widest_um = max(float(np.ptp(record.y_um)) for record in records)
    joined = np.concatenate(errors)
    return ErrorFigures(float(np.abs(joined).max()), float(np.sqrt(np.mean(joined**2))), widest_um)


def _zero_of(found: Fit, number: int, error_um: Array) -> float:
    """Zero of a record; of one that a fold held out whole, by its mean."""
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


def bands_of(
    design: Design,
    reduction: Reduction,
    best: Fit,
    held_out: ErrorFigures,
    delay_s: float,
    smoothness: float,
    resamples: int,
) -> Bands:
    """Block bootstrap: refit `resamples` times to as many blocks, drawn with replacement."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    count = len(reduction.blocks)
    drawn_um: list[Array] = []
    drawn: list[tuple[float, float, float]] = []
    for _ in range(resamples):
        times = np.bincount(rng.integers(count, size=count), minlength=count).tolist()
        found = fit(design, reduction, times=times, smoothness=smoothness, start=best.weights)
        drawn_um.append(reduction.sketch @ found.weights + float(np.nanmean(found.zeros_um)))
        drawn.append(_shape(design, found.weights, delay_s))
    spread_um = np.std(drawn_um, axis=0) if drawn_um else np.zeros(1)
    gain_sd, width_sd, gamma_sd = np.std(drawn, axis=0) if drawn else np.zeros(3)
    gain, width, gamma = _shape(design, best.weights, delay_s)
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


def _shape(design: Design, weights: Array, delay_s: float) -> tuple[float, float, float]:
    model = design.model(weights, 0.0, delay_s)
    return model.gain_um_per_v, model.loop_width, model.gamma_per_decade
