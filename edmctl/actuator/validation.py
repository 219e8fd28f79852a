"""How good a model is: its errors on records.

Held-out errors count after the zero, or gain and zero, are set again.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Literal

import numpy as np

from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import Record, check_numbers, settled_from
from edmctl.array_types import Array
from edmctl.dataclasses import dataclass, replace

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

        def rms(values: Sequence[float]) -> float:
            squares = (n * value**2 for n, value in zip(samples, values, strict=True))
            return math.sqrt(sum(squares) / sum(samples))

        return cls(
            max_um=max(f.max_um for f in figures),
            rms_um=rms([f.rms_um for f in figures]),
            max_pct=max(f.max_pct for f in figures),
            rms_pct=rms([f.rms_pct for f in figures]),
            range_um=max(f.range_um for f in figures),
        )

    @classmethod
    def of(cls, errors_um: Array, displacement_um: Array) -> ErrorFigures:
        """Figures of errors, shape (n,), on measured displacements, shape (n,)."""
        return cls.over(errors_um, float(np.ptp(displacement_um)))

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

    Where nobody says what the actuator was held at before, and the record soon visits both its ends, it is
    judged from then on: before, its hysteresis is unknown. Raises ValueError for a record without two samples, with
    numbers that are not finite, or without a displacement that changes.
    """
    from edmctl.actuator.screening import looked_through

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
    return Validation(ErrorFigures.of(errors_um, measured_um), gain, zero_um, first)
