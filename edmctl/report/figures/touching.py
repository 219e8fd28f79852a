"""Actuator voltage and displacement from the first surface reading to the last, and a zoom on a set of touches.

Like Fig. 9(a) of Muralidhara et al. 2009: at the contact the voltage peaks, and falls while the tool rests there,
because the actuator creeps on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmctl.record.events import RecordedCode, RecordedState
from edmctl.report.signals import envelopes, floats, without_jumps
from edmctl.report.style import (
    BLACK,
    BLUE,
    GREY,
    VERMILION,
    NothingToDraw,
    draw_envelope,
    legend_above,
    letter_panels,
    mark_readings,
    new_figure,
    time_unit,
)
from edmctl.wording import plain_number, signed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile
    from edmctl.report.signals import Columns, Floats

HEIGHT_MM, ZOOM_MM = 152.0, 82.0
LONGEST_S = 600.0
"""No set of touches takes longer."""
BEFORE_S, AFTER_S = 2.5, 1.0
"""Shown before the first contact of the set and after the last."""
LONGEST_NAME = 40
NEAR_S = 0.7
"""The detail shows so much on both sides of the last contact, or its hold where that is longer."""
LONG_HOLD_S = 1.0
"""Of a contact held so long, what voltage and sensor did meanwhile is written beside it."""
ENDS_S = 0.3
"""What they did is the difference of means over so much at both ends of the hold: single samples are noisy."""


def draw(run: RunFile) -> Figure:
    """Draw the last accepted touches, of the bottom (Z2) if there are any, 85 mm wide. Raises NothingToDraw.

    Where there were several readings, those from the last Z1 on are above.
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
    whole_part = _rows_of_sequence(run, sequence, hold_s)
    heights_mm = [HEIGHT_MM - ZOOM_MM, ZOOM_MM] if whole_part[1] - whole_part[0] > 1 else [ZOOM_MM]
    figure = new_figure(sum(heights_mm))
    *above, zoom = figure.subfigures(len(heights_mm), 1, squeeze=False, height_ratios=heights_mm).ravel()
    for whole in above:
        _draw_sequence(whole, run, sequence, whole_part)
    _draw_zoom(zoom, run, part, contacts_s, hold_s)
    zoom.suptitle(_title(touch), fontsize=7.0)
    letter_panels(figure.axes)
    figure.axes[-3].set_title("last contact", loc="right", pad=2.0)
    return figure


def _title(touch: np.void) -> str:
    site = touch["site"].decode()
    return f"Touches of {touch['kind'].decode()}: {site if len(site) <= LONGEST_NAME else site[:LONGEST_NAME] + '…'}"


def _sequence(touches: NDArray[np.void]) -> NDArray[np.void]:
    """Return the accepted readings from the last Z1 on, all its spots among them; all of them without one."""
    accepted = touches[touches["accepted"] == 1]
    surface = accepted["kind"] == b"Z1"
    begins = np.flatnonzero(surface & ~np.append(False, surface[:-1]))
    sequence: NDArray[np.void] = accepted[begins[-1] :] if len(begins) else accepted
    return sequence


def _rows_of_sequence(run: RunFile, readings: NDArray[np.void], hold_s: float) -> tuple[int, int]:
    """Return the rows of `/entry/servo` about several readings; (0, 0) where there are not as many."""
    if len(readings) < 2:
        return 0, 0
    begin_s = _touching_since(run, float(readings["time"][0]))
    return _rows_between(run, begin_s, float(readings["time"][-1]) + _after_s(hold_s))


def _draw_sequence(
    figure: SubFigure, run: RunFile, readings: NDArray[np.void], part: tuple[int, int]
) -> None:
    upper, lower = figure.subplots(2, 1, sharex=True)

    def derive(columns: Columns) -> dict[str, Floats]:
        return {name: without_jumps(columns[name], columns["state"]) for name in ("v_cmd", place)}

    sensed = bool(np.isfinite(readings["z_sensor"]).any())
    place = "z_sensor" if sensed else "z_model"
    lines = envelopes(run, "/entry/servo", ["v_cmd", place, "state"], derive, part)
    time_s = lines["v_cmd"].time_s
    unit_s, label = time_unit(float(time_s[-1] - time_s[0]))
    for axes, name, colour in ((upper, "v_cmd", VERMILION), (lower, place, GREY if sensed else BLUE)):
        draw_envelope(axes, lines[name], unit_s, colour)
        mark_readings(axes, readings, name, unit_s)
        axes.locator_params(axis="y", nbins=5)
    upper.set_ylabel("actuator voltage (V)")
    lower.set_ylabel("displacement (µm)")
    lower.set_xlabel(label)
    lower.set_xlim(time_s[0] / unit_s, time_s[-1] / unit_s)
    legend_above(upper)
    figure.align_ylabels()


def _draw_zoom(
    figure: SubFigure, run: RunFile, part: tuple[int, int], contacts_s: Array, hold_s: float
) -> None:
    columns = floats(run, "/entry/servo", ("time", "v_cmd", "z_sensor", "z_model"), part)
    panels = figure.subplots(2, 2, sharex="col", width_ratios=[1.7, 1.0])
    _draw_column(panels[:, 0], columns, contacts_s, 5)
    if hold_s >= LONG_HOLD_S:
        _write_changes(panels[:, 0], columns, contacts_s, hold_s)
    since_s = columns["time"] - contacts_s[-1]
    near = (since_s >= -NEAR_S) & (since_s <= max(NEAR_S, hold_s + 0.5 * NEAR_S))
    detail = {name: values[near] for name, values in columns.items()}
    detail["time"] = detail["time"] - contacts_s[-1]
    _draw_column(panels[:, 1], detail, np.zeros(1), 3)
    panels[0, 0].set_ylabel("actuator voltage (V)")
    panels[1, 0].set_ylabel("displacement (µm)")
    panels[1, 0].set_xlabel("time (s)")
    panels[1, 1].set_xlabel("from contact (s)")
    figure.legend(
        *panels[1, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, handlelength=1.8
    )
    figure.align_ylabels()


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
    """What is shown after the last contact: its hold, and the way back."""
    return max(AFTER_S, hold_s + NEAR_S)


def _write_changes(panels: NDArray[np.object_], columns: Columns, contacts_s: Array, hold_s: float) -> None:
    """Write how voltage and sensor changed over each hold: the one sinks by the creep, the other stays."""
    for axes, name, unit, digits in ((panels[0], "v_cmd", "V", 2), (panels[1], "z_sensor", "µm", 1)):
        since_s, values = columns["time"], columns[name]
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


def _contacts(run: RunFile, touch: np.void, hold_s: float) -> tuple[float, float, Array]:
    """Return what to show, and when the tool touched; the time of the reading is that of its last contact."""
    last_s = float(touch["time"])
    events = run.table("/entry/events")
    times_s = events["time"][events["code"] == RecordedCode.TOUCH].astype(np.float64)
    earliest_s = _touching_since(run, last_s)
    times_s = times_s[(times_s >= earliest_s) & (times_s <= last_s + 1e-3)]
    contacts_s = times_s if len(times_s) else np.array([last_s])
    return max(earliest_s, float(contacts_s[0]) - BEFORE_S), _touching_until(run, last_s, hold_s), contacts_s


def _touching_until(run: RunFile, last_s: float, hold_s: float) -> float:
    part = _rows_between(run, last_s, last_s + _after_s(hold_s))
    elsewhere = np.flatnonzero(run.column("/entry/servo", "state", *part) != RecordedState.TOUCH)
    if not len(elsewhere) or elsewhere[0] == 0:
        return last_s + _after_s(hold_s)
    return float(run.column("/entry/servo", "time", *part)[elsewhere[0]])


def _touching_since(run: RunFile, last_s: float) -> float:
    part = _rows_between(run, last_s - LONGEST_S, last_s)
    time_s = run.column("/entry/servo", "time", *part).astype(np.float64)
    elsewhere = np.flatnonzero(run.column("/entry/servo", "state", *part) != RecordedState.TOUCH)
    # The state of the last rows may already be the next one.
    elsewhere = elsewhere[time_s[elsewhere] < last_s - 0.1]
    if len(elsewhere):
        return float(time_s[min(int(elsewhere[-1]) + 1, len(time_s) - 1)])
    return float(time_s[0]) if len(time_s) else last_s - BEFORE_S


def _rows_between(run: RunFile, begin_s: float, end_s: float) -> tuple[int, int]:
    """Return the rows of `/entry/servo` in an interval of time, by bisection: the file may be long."""
    return _row_at(run, begin_s), _row_at(run, end_s)


def _row_at(run: RunFile, time_s: float) -> int:
    low, high = 0, run.rows("/entry/servo")
    while low < high:
        middle = (low + high) // 2
        if float(run.column("/entry/servo", "time", middle, middle + 1)[0]) < time_s:
            low = middle + 1
        else:
            high = middle
    return low


def _draw_column(
    panels: NDArray[np.object_], columns: dict[str, Array], contacts_s: Array, bins: int
) -> None:
    upper, lower = panels
    time_s = columns["time"]
    for axes in panels:
        for number, contact_s in enumerate(contacts_s):
            axes.axvline(
                contact_s,
                color=BLACK,
                linewidth=0.6,
                linestyle=(0, (1.5, 1.5)),
                label="contact" if number == 0 else "_",
            )
        axes.locator_params(axis="x", nbins=bins)
        axes.locator_params(axis="y", nbins=5)
    upper.plot(time_s, columns["v_cmd"], color=VERMILION)
    _line(lower, time_s, columns["z_sensor"], GREY, 1.0, "sensor")
    _line(lower, time_s, columns["z_model"], BLUE, 0.8, "estimated")
    lower.set_xlim(time_s[0], time_s[-1])


def _line(axes: Axes, time_s: Array, values: Array, colour: str, width: float, label: str) -> None:
    if np.isfinite(values).any():
        axes.plot(time_s, values, color=colour, linewidth=width, label=label)
