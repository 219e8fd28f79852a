"""Actuator voltage and displacement from the first surface reading to the last, and a zoom on a set of touches.

Like Fig. 9(a) of Muralidhara et al. 2009: at the contact the voltage peaks, and falls while the tool stays there,
because the actuator creeps.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from edmctl.array_types import Array
from edmctl.record.events import RecordedCode, RecordedState
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.signals import Columns, Floats, envelopes, floats, without_jumps
from edmctl.report.style import BLACK, BLUE, GREY, VERMILION, NothingToDraw
from edmctl.wording import plain_number, signed

SERVO = "/entry/servo"
LONGEST_S = 600.0
"""No set of touches takes longer."""
BEFORE_S, AFTER_S = 2.5, 1.0
"""Shown before the first contact of the set and after the last."""
LONGEST_NAME = 40
NEAR_S = 0.7
"""The detail shows so much on both sides of the last contact, or its hold if that is longer."""
LONG_HOLD_S = 1.0
"""Changes of voltage and sensor are written beside contacts held so long."""
ENDS_S = 0.3
"""They are the difference of means over so much at both ends of the hold: single samples are noisy."""
Y = ("actuator voltage (V)", "displacement (µm)")


def draw(run: RunFile) -> Figure:
    """Draw the last accepted touches, of the bottom (Z2) if there are any, 85 mm wide. Raises NothingToDraw.

    If there are several readings, those from the last Z1 on are above.
    """
    touches = run.table("/entry/touches")
    touch = _chosen(touches)
    dwell_s = plain_number(run.profile_values().get("measure.dwell_s"))
    hold_s = dwell_s if dwell_s > 0.0 else 0.0
    begin_s, end_s, contacts_s = _contacts(run, touch, hold_s)
    part = _rows_between(run, begin_s, end_s)
    if part[1] - part[0] < 2:
        raise NothingToDraw(
            "The servo signals of this file do not cover its touches; those of a whole run file do."
        )
    sequence = _sequence(touches)
    whole = _rows_of_sequence(run, sequence, hold_s)
    has_whole = whole[1] - whole[0] > 1
    unit_s, label = style.time_unit(
        _time_at(run, whole[1] - 1) - _time_at(run, whole[0]) if has_whole else 0.0
    )
    blocks = [style.Block(label, dict.fromkeys(Y, 1.0))] if has_whole else []
    zoom = style.Block("time (s)", dict.fromkeys(Y, 1.1), (1.7, 1.0), above_mm=style.TITLE_MM)
    figure, axes = style.panels(*blocks, zoom, gap_mm=11.0)
    if has_whole:
        _draw_sequence(axes[:2], run, sequence, whole, unit_s)
    left, right = (axes[-4], axes[-2]), (axes[-3], axes[-1])
    columns = floats(run, SERVO, ("time", "v_cmd", "z_sensor", "z_model"), part)
    _draw_zoom(left, columns, contacts_s, 5)
    if hold_s >= LONG_HOLD_S:
        _write_changes(left, columns, contacts_s, hold_s)
    since_s = columns["time"] - contacts_s[-1]
    near = (since_s >= -NEAR_S) & (since_s <= max(NEAR_S, hold_s + 0.5 * NEAR_S))
    detail = {name: values[near] for name, values in (columns | {"time": since_s}).items()}
    _draw_zoom(right, detail, np.zeros(1), 3)
    right[1].set_xlabel("from contact (s)")
    style.note_above(right[0], "last contact")
    site = touch["site"].decode()
    site = site if len(site) <= LONGEST_NAME else site[:LONGEST_NAME] + "…"
    left[0].set_title(f"Touches of {touch['kind'].decode()}: {site}", x=0.5 + 0.3, y=1.13, pad=0.0)
    style.shared_legend(figure, axes, ncols=4)
    return figure


def _sequence(touches: NDArray[np.void]) -> NDArray[np.void]:
    """Return the accepted readings from the last Z1 on, with all its spots; all of them without one."""
    accepted = touches[touches["accepted"] == 1]
    surface = accepted["kind"] == b"Z1"
    begins = np.flatnonzero(surface & ~np.append(False, surface[:-1]))
    sequence: NDArray[np.void] = accepted[begins[-1] :] if len(begins) else accepted
    return sequence


def _rows_of_sequence(run: RunFile, readings: NDArray[np.void], hold_s: float) -> tuple[int, int]:
    """Return the rows of `/entry/servo` about several readings; (0, 0) for fewer than two."""
    if len(readings) < 2:
        return 0, 0
    begin_s = _touching_since(run, float(readings["time"][0]))
    return _rows_between(run, begin_s, float(readings["time"][-1]) + _after_s(hold_s))


def _draw_sequence(
    pair: Sequence[Axes], run: RunFile, readings: NDArray[np.void], part: tuple[int, int], unit_s: float
) -> None:
    sensed = bool(np.isfinite(readings["z_sensor"]).any())
    place = "z_sensor" if sensed else "z_model"

    def derive(columns: Columns) -> dict[str, Floats]:
        return {name: without_jumps(columns[name], columns["state"]) for name in ("v_cmd", place)}

    lines = envelopes(run, SERVO, ["v_cmd", place, "state"], derive, part)
    for axes, name, colour in zip(pair, lines, (VERMILION, GREY if sensed else BLUE), strict=True):
        style.draw_envelope(axes, lines[name], unit_s, colour)
        style.mark_readings(axes, readings, name, unit_s)
        axes.locator_params(axis="y", nbins=5)
    time_s = lines["v_cmd"].time_s
    pair[1].set_xlim(time_s[0] / unit_s, time_s[-1] / unit_s)


def _draw_zoom(pair: Sequence[Axes], columns: Columns, contacts_s: Array, bins: int) -> None:
    time_s = columns["time"]
    for axes in pair:
        for contact_s in contacts_s:
            axes.axvline(contact_s, color=BLACK, linewidth=0.6, linestyle=(0, (1.5, 1.5)), label="contact")
        axes.locator_params(axis="x", nbins=bins)
        axes.locator_params(axis="y", nbins=5)
    pair[0].plot(time_s, columns["v_cmd"], color=VERMILION)
    for name, colour, width, label in (
        ("z_sensor", GREY, 1.0, "sensor"),
        ("z_model", BLUE, 0.8, "estimated"),
    ):
        if np.isfinite(columns[name]).any():
            pair[1].plot(time_s, columns[name], color=colour, linewidth=width, label=label)
    pair[1].set_xlim(time_s[0], time_s[-1])


def _write_changes(pair: Sequence[Axes], columns: Columns, contacts_s: Array, hold_s: float) -> None:
    """Write the changes of voltage and sensor over each hold: the voltage falls by the creep, the sensor stays."""
    since_s = columns["time"]
    for axes, name, unit, digits in ((pair[0], "v_cmd", "V", 2), (pair[1], "z_sensor", "µm", 1)):
        values = columns[name]
        axes.margins(y=0.15)
        for contact_s in contacts_s:
            inside = (since_s > contact_s) & (since_s < contact_s + hold_s)
            begins = inside & (since_s <= contact_s + ENDS_S)
            ends = inside & (since_s >= contact_s + hold_s - ENDS_S)
            if not (np.isfinite(values[begins]).any() and np.isfinite(values[ends]).any()):
                continue
            change = float(np.nanmean(values[ends]) - np.nanmean(values[begins]))
            axes.annotate(
                f"{signed(change, digits)} {unit}", (contact_s + 0.5 * hold_s, float(np.nanmax(values[inside]))),
                xytext=(0.0, 2.0), textcoords="offset points", ha="center", va="bottom", fontsize=5.5,
            )  # fmt: skip


def _chosen(touches: NDArray[np.void]) -> np.void:
    accepted = touches[touches["accepted"] == 1]
    bottom = accepted[accepted["kind"] == b"Z2"]
    for rows in (bottom, accepted, touches):
        if len(rows):
            chosen: np.void = rows[-1]
            return chosen
    raise NothingToDraw(
        "The tool touched nothing in this run; a job that measures, or `edmctl measure-wear`, does."
    )


def _after_s(hold_s: float) -> float:
    """Return how much is shown after the last contact: its hold, and the way back."""
    return max(AFTER_S, hold_s + NEAR_S)


def _contacts(run: RunFile, touch: np.void, hold_s: float) -> tuple[float, float, Array]:
    """Return what to show, and the times of contact; the time of the reading is that of its last contact."""
    last_s = float(touch["time"])
    events = run.table("/entry/events")
    times_s = events["time"][events["code"] == RecordedCode.TOUCH].astype(np.float64)
    earliest_s = _touching_since(run, last_s)
    times_s = times_s[(times_s >= earliest_s) & (times_s <= last_s + 1e-3)]
    contacts_s = times_s if len(times_s) else np.array([last_s])
    end_s = last_s + _after_s(hold_s)
    part = _rows_between(run, last_s, end_s)
    elsewhere = np.flatnonzero(run.column(SERVO, "state", *part) != RecordedState.TOUCH)
    if len(elsewhere) and elsewhere[0] > 0:
        end_s = _time_at(run, part[0] + int(elsewhere[0]))
    return max(earliest_s, float(contacts_s[0]) - BEFORE_S), end_s, contacts_s


def _touching_since(run: RunFile, last_s: float) -> float:
    """Return since when the tool had been touching at a time."""
    first, stop = _rows_between(run, last_s - LONGEST_S, last_s)
    if stop == first:
        return last_s - BEFORE_S
    time_s = run.column(SERVO, "time", first, stop).astype(np.float64)
    elsewhere = np.flatnonzero(run.column(SERVO, "state", first, stop) != RecordedState.TOUCH)
    # The state of the last rows may already be the next one.
    elsewhere = elsewhere[time_s[elsewhere] < last_s - 0.1]
    return float(time_s[min(int(elsewhere[-1]) + 1, len(time_s) - 1)] if len(elsewhere) else time_s[0])


def _rows_between(run: RunFile, begin_s: float, end_s: float) -> tuple[int, int]:
    """Return the rows of `/entry/servo` in an interval of time, by bisection: the file may be long."""
    return _row_at(run, begin_s), _row_at(run, end_s)


def _row_at(run: RunFile, time_s: float) -> int:
    return bisect_left(range(run.rows(SERVO)), time_s, key=lambda row: _time_at(run, row))


def _time_at(run: RunFile, row: int) -> float:
    return float(run.column(SERVO, "time", row, row + 1)[0])
