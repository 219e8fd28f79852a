"""How good a model is: its errors on records.

Held-out errors count after the zero, or gain and zero, are set again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from edmctl.actuator.record import check_numbers, settled_from

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]

Refit = Literal["gain", "zero"]
ZERO: tuple[Refit, ...] = ("zero",)


@dataclass(frozen=True, slots=True)
class ErrorFigures:
    """Largest and RMS error, and the range of displacement that percentages refer to, µm."""

    max_um: float
    rms_um: float
    range_um: float

    @property
    def max_pct(self) -> float:
        """Largest error, % of the range."""
        return 100.0 * self.max_um / self.range_um

    @property
    def rms_pct(self) -> float:
        """RMS error, % of the range."""
        return 100.0 * self.rms_um / self.range_um

    @classmethod
    def of(cls, errors_um: Array, displacement_um: Array) -> ErrorFigures:
        """Figures of errors, shape (n,), on measured displacements, shape (n,)."""
        return cls.over(errors_um, float(np.ptp(displacement_um)))

    @classmethod
    def over(cls, errors_um: Array, range_um: float) -> ErrorFigures:
        """Figures of errors, shape (n,), on displacements of such a range."""
        return cls(float(np.abs(errors_um).max()), float(np.sqrt(np.mean(errors_um**2))), range_um)


@dataclass(frozen=True, slots=True)
class Validation:
    """Errors on one record from sample `first` on, with the gain and the zero that were set for it."""

    errors: ErrorFigures
    gain: float
    zero_um: float
    first: int


def validate(model: ActuatorModel, record: Record, refit: Collection[Refit] = ZERO) -> Validation:
    """Judge a model on a record that it was not identified from.

    refit : what is fitted to the record by least squares first: the zero, because it is lost when a sensor or a
        tool is touched; the gain too where the record is of another day (temperature).

    Where nobody says what the actuator was held at before, and the record soon visits both its ends, it is
    judged from then on: before, its hysteresis is unknown. Raises ValueError for a record without two samples, with
    numbers that are not finite, or without a displacement that changes.
    """
    check_numbers(record)
    if len(record.t_s) < 2 or not np.ptp(record.y_um) > 0.0:
        raise ValueError(f"{record.name}: the displacement does not change, so that nothing can be judged")
    start = model.starting_state(record.t_s, record.u_v, record.previous_v)
    predicted_um = model.predict(record.t_s, record.u_v, start)
    return judge(predicted_um, record.y_um, refit, settled_from(record))


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
