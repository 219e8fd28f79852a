"""What stands against using an identified model, in words, and what else a reader should know."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.design import OWN_TAU_SHARE
from edmctl.actuator.record import has_several_rates, length_s, longest_hold_s, settled_from

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.design import Design
    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.record import Record
    from edmctl.actuator.validation import ErrorFigures

    Array = NDArray[np.float64]

ACCEPTED_RMS_PCT, ACCEPTED_MAX_PCT = 0.5, 2.0
COVERED_BINS = 10
END_SHARE = 0.01
LEAST_HOLD_SHARE = 0.5
"""Of the slowest lag with a weight of its own."""


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
