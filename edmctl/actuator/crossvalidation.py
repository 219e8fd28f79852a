"""Errors on what a fit did not see, and the smoothness that predicts best."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.fitting import Fit, fit
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
