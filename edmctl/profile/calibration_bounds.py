"""Wide bounds for the numbers of a calibration: beyond them no actuator feeds a tool, or arithmetic overflows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from edmctl.actuator.model import ActuatorModel

MOST_V = 10_000.0
LEAST_SPAN_SHARE = 0.01
"""Of the knots of the first play: a range of voltage that is narrower was not recorded."""
LEAST_STROKE_UM, MOST_STROKE_UM = 1.0, 10_000.0
MOST_ZERO_UM = 1e6
LEAST_TAU_S, MOST_TAU_S = 1e-6, 1e9
MOST_DELAY_S = 1.0
MOST_PLAYS, MOST_PIECES, MOST_TAUS, MOST_ROUNDED = 200, 50, 50, 10
"""A tick of the estimator takes time in proportion; identified are 10, 4 and 15."""
MOST_CREEP_SHARE = 1.0
"""Of the displacement without creep."""
STROKE_FACTOR = 1.5
"""Between the stroke that the quality states and that of the model's weights."""
ROUNDING = 1e-3
MOST_ACCEPTED_RMS_PCT, MOST_ACCEPTED_MAX_PCT = 0.5, 4.0
"""Held-out errors that no calibration is accepted beyond, % of the range: the widest of `actuator.acceptance`, which
reading a file does not load."""


class Errors(Protocol):
    """Errors as `ErrorFigures` and the tables of a calibration file state them."""

    @property
    def max_um(self) -> float: ...
    @property
    def rms_um(self) -> float: ...
    @property
    def max_pct(self) -> float: ...
    @property
    def rms_pct(self) -> float: ...
    @property
    def range_um(self) -> float: ...


class Stated(Protocol):
    """Quality as `Identification` and the table `[quality]` state it."""

    @property
    def accepted(self) -> bool: ...
    @property
    def problems(self) -> Sequence[str]: ...
    @property
    def stroke_um(self) -> float: ...
    @property
    def held_out(self) -> Errors: ...
    @property
    def train(self) -> Errors: ...


def contradictions(
    quality: Stated, model: ActuatorModel, others: Sequence[tuple[str, Errors]] = ()
) -> Iterator[str]:
    """Yield what of a calibration cannot be, with numbers; nothing if it may be used.

    others : further errors that an acceptance depends on, by name
    """
    for found, most, what in (
        (len(model.thresholds_v), MOST_PLAYS, "plays"),
        (model.slopes_um_per_v.shape[1], MOST_PIECES, "pieces a play"),
        (len(model.time_constants_s), MOST_TAUS, "time constants"),
        (len(model.rounded_um_per_v), MOST_ROUNDED, "rounded plays"),
    ):
        if found > most:
            yield f"{found} {what}, at most {most} are used"
    yield from _of_numbers(model)
    yield from _of_range(model)
    yield from _of_stroke(quality, model)
    if quality.accepted == bool(quality.problems):
        verdict = "accepted" if quality.accepted else "not accepted"
        yield f"it is {verdict} with {len(quality.problems)} problems against it"
    yield from _of_figures(quality.train, "train")
    for name, errors in (("held_out", quality.held_out), *others):
        if quality.accepted and (
            errors.rms_pct > MOST_ACCEPTED_RMS_PCT or errors.max_pct > MOST_ACCEPTED_MAX_PCT
        ):
            yield f"it is accepted with errors of {errors.rms_pct:.3g} % RMS, {errors.max_pct:.3g} % ({name})"
        yield from _of_figures(errors, name)


def _of_numbers(model: ActuatorModel) -> Iterator[str]:
    volts = np.concatenate(
        [
            model.thresholds_v,
            model.knots_v.ravel(),
            [model.low_v, model.high_v],
            model.rounded_limits_v.ravel(),
            model.rounded[:, -1],
        ],
        dtype=np.float64,
    )
    if np.abs(volts).max() > MOST_V:
        yield f"voltages up to {np.abs(volts).max():.3g} V, at most {MOST_V:g} V are used"
    taus_s = model.time_constants_s
    if len(taus_s) and not (taus_s.min() >= LEAST_TAU_S and taus_s.max() <= MOST_TAU_S):
        yield f"time constants of {taus_s.min():.3g} s to {taus_s.max():.3g} s"
    for late_s, what in ((model.delay_s, "delay"), (model.lag_s, "lag")):
        if late_s > MOST_DELAY_S:
            yield f"a {what} of {late_s:.3g} s, at most {MOST_DELAY_S:g} s are used"
    if abs(model.zero_um) > MOST_ZERO_UM:
        yield f"a zero of {model.zero_um:.3g} µm"


def _of_range(model: ActuatorModel) -> Iterator[str]:
    """The range is where the first play has its knots; beyond them the model guesses."""
    low_v, high_v = float(model.knots_v[0, 0]), float(model.knots_v[0, -1])
    span_v = high_v - low_v
    narrow = model.high_v - model.low_v < LEAST_SPAN_SHARE * span_v
    if narrow or model.low_v < low_v - span_v or model.high_v > high_v + span_v or model.high_v <= low_v:
        yield (
            f"a range of {model.low_v:.4g} V to {model.high_v:.4g} V with knots from {low_v:.4g} V to {high_v:.4g} V"
        )


def _of_stroke(quality: Stated, model: ActuatorModel) -> Iterator[str]:
    """The displacement of a full swing by the weights alone, with creep that has come to its end and without any."""
    span_v = model.high_v - model.low_v
    swings_v = np.maximum(0.0, span_v - 2.0 * model.thresholds_v)
    if not _is_sane(model.slopes_um_per_v) or not _is_sane(model.creep_um_per_v):
        yield f"slopes up to {max(model.slopes_um_per_v.max(), model.creep_um_per_v.max(initial=0.0)):.3g} µm/V"
        return
    knots = np.clip(model.knots_v, model.low_v, model.high_v)
    knots[:, 0], knots[:, -1] = model.low_v, model.high_v
    reached = np.minimum(knots[:, 1:], model.high_v - model.thresholds_v[:, np.newaxis]) - np.maximum(
        knots[:, :-1], model.low_v + model.thresholds_v[:, np.newaxis]
    )
    rounded_v = model.rounded[:, -1] * span_v - model.rounded_limits_v.sum(axis=1)
    swings_v = np.concatenate([swings_v, np.maximum(0.0, rounded_v)])
    plain_um = float((model.slopes_um_per_v * np.maximum(reached, 0.0)).sum())
    plain_um += float(model.rounded_um_per_v @ swings_v[len(model.thresholds_v) :])
    creep_um = float((model.creep_um_per_v.sum(axis=1) * swings_v[model.creep_plays]).sum())
    if not LEAST_STROKE_UM <= plain_um + creep_um <= MOST_STROKE_UM:
        yield (
            f"a stroke of {plain_um + creep_um:.3g} µm; {LEAST_STROKE_UM:g} µm to {MOST_STROKE_UM:g} µm feed a tool"
        )
    elif creep_um > MOST_CREEP_SHARE * plain_um:
        yield f"{creep_um:.4g} µm of creep on {plain_um:.4g} µm without it"
    stated_um = quality.stroke_um
    if not plain_um / STROKE_FACTOR <= stated_um <= STROKE_FACTOR * (plain_um + creep_um):
        yield f"a stated stroke of {stated_um:.4g} µm and weights that give {plain_um + creep_um:.4g} µm"


def _is_sane(weights: np.ndarray) -> bool:
    return bool(weights.max(initial=0.0) <= MOST_STROKE_UM)


def _of_figures(figures: Errors, name: str) -> Iterator[str]:
    """Percentages are those of the lengths, and no RMS is larger than the largest error."""
    lengths = (figures.max_um, figures.rms_um)
    shares = (figures.max_pct, figures.rms_pct)
    apart = any(
        not math.isclose(share / 100.0 * figures.range_um, length, rel_tol=ROUNDING, abs_tol=1e-9)
        for share, length in zip(shares, lengths, strict=True)
    )
    if apart or figures.rms_um > figures.max_um * (1.0 + ROUNDING):
        yield f"errors of {name} that contradict each other"
