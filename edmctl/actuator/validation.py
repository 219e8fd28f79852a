"""How good a model is: its errors on records, what stands against using it, and what else a reader should know.

Held-out errors count after the zero, or gain and zero, are set again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from edmctl.actuator.design import OWN_TAU_SHARE
from edmctl.actuator.record import has_several_rates, length_s, longest_hold_s, settled_from

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.design import Design
    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]

Refit = Literal["gain", "zero"]
ZERO: tuple[Refit, ...] = ("zero",)
ACCEPTED_RMS_PCT, ACCEPTED_MAX_PCT = 0.5, 2.0
COVERED_BINS = 10
END_SHARE = 0.01
LEAST_HOLD_SHARE = 0.5
"""Of the slowest lag with a weight of its own."""


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
        return cls(
            max_um=float(np.abs(errors_um).max()),
            rms_um=float(np.sqrt(np.mean(errors_um**2))),
            range_um=float(np.ptp(displacement_um)),
        )


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
    judged from then on: before, its hysteresis is unknown.
    """
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


def problems_of(
    design: Design,
    model: ActuatorModel,
    records: Sequence[Record],
    held_out: ErrorFigures,
    *,
    on_floor: bool,
) -> tuple[str, ...]:
    problems: list[str] = []
    if held_out.rms_pct > ACCEPTED_RMS_PCT:
        problems.append(
            f"Held-out RMS error {held_out.rms_pct:.2f} % of the range, at most {ACCEPTED_RMS_PCT} % is accepted: "
            "look for a loose sensor, a wrong --previous-voltage, or a load on the tool, and measure again."
        )
    if held_out.max_pct > ACCEPTED_MAX_PCT:
        problems.append(
            f"Held-out error up to {held_out.max_pct:.1f} % of the range, at most {ACCEPTED_MAX_PCT} % is "
            f"accepted; the worst is at {_worst_place(model, records)}: look for a knock or a jump there, cut it "
            "off or measure again."
        )
    if on_floor:
        problems.append(
            "Not monotone: somewhere in the range the data show no immediate answer to the voltage; "
            "look for a sensor or an amplifier at its limit."
        )
    problems += _uncovered(design, records)
    return tuple(problems)


def _uncovered(design: Design, records: Sequence[Record]) -> list[str]:
    """What of the model's class the records say nothing about."""
    found: list[str] = []
    bins = np.linspace(design.low_v, design.high_v, COVERED_BINS + 1)
    for direction, rising in (("rising", True), ("falling", False)):
        seen = np.zeros(COVERED_BINS, dtype=bool)
        for record in records:
            moves = np.diff(record.u_v) > 0.0 if rising else np.diff(record.u_v) < 0.0
            places = np.digitize(record.u_v[1:][moves], bins) - 1
            seen[np.clip(places, 0, COVERED_BINS - 1)] = True
        if not seen.all():
            gap = int(np.argmin(seen))
            found.append(
                f"Not covered: no {direction} voltage between {bins[gap]:.1f} V and {bins[gap + 1]:.1f} V; "
                "record full cycles."
            )
    return found


def notes_on(records: Sequence[Record], delay_s: float | None) -> tuple[str, ...]:
    notes: list[str] = []
    if delay_s is None and not has_several_rates(records):
        notes.append(
            "The records swing at one rate, where delay and hysteresis look alike: the delay that was found holds "
            "there only. Measure at two rates, or say --delay."
        )
    held_s = max(longest_hold_s(record) for record in records)
    if held_s < OWN_TAU_SHARE * LEAST_HOLD_SHARE * length_s(records):
        notes.append(
            f"The voltage is never held longer than {held_s:.2g} s: slower creep is continued from faster. "
            "Hold a step for a minute to measure it."
        )
    return tuple(notes)


def _worst_place(model: ActuatorModel, records: Sequence[Record]) -> str:
    """Where a model is farthest from its records: the time, the record's name, and what is special there."""
    worst_um, place = -1.0, ""
    for record in records:
        first = settled_from(record)
        start = model.starting_state(record.t_s, record.u_v, record.previous_v)
        errors_um = model.predict(record.t_s, record.u_v, start) - record.y_um
        errors_um = np.abs(errors_um - np.median(errors_um))[first:]
        k = first + int(errors_um.argmax())
        if errors_um.max() > worst_um:
            worst_um = float(errors_um.max())
            margin_um = END_SHARE * float(np.ptp(record.y_um))
            at_end = not record.y_um.min() + margin_um < record.y_um[k] < record.y_um.max() - margin_um
            limit = ", where the sensor may stand at the end of its range" if at_end else ""
            place = f"{record.t_s[k]:.4g} s of {record.name}{limit}"
    return place
