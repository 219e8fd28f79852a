"""Actuator voltage and displacement while the tool touches; contacts are marked.

Like Fig. 9(a) of Muralidhara et al. 2009: at the contact the voltage peaks, and falls while the tool rests there,
because the actuator creeps on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.envelopes import State
from edmctl.report.style import (
    BLACK,
    BLUE,
    GREY,
    VERMILLION,
    NothingToDraw,
    letter_panels,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]

HEIGHT_MM = 78.0
CONTACT = 6
"""Code of the controller's event at a contact."""
LONGEST_S = 600.0
"""No set of touches takes longer."""
BEFORE_S, AFTER_S = 2.5, 1.0
"""Shown before the first contact of the set and after the last."""
NEAR_S = 0.7
"""The detail shows so much on both sides of the last contact."""


def draw(run: RunFile) -> Figure:
    """Draw the last accepted touches, of the bottom (Z2) if there are any, 85 mm wide. Raises NothingToDraw."""
    touch = _chosen(run.table("/entry/touches"))
    begin_s, end_s, contacts_s = _contacts(run, touch)
    part = _rows_between(run, begin_s, end_s)
    if part[1] - part[0] < 2:
        raise NothingToDraw(
            "The servo signals do not cover the touches of this run, which a whole run file does."
        )
    columns = {
        name: run.column("/entry/servo", name, *part).astype(np.float64)
        for name in ("time", "v_cmd", "z_sensor", "z_model")
    }
    figure = new_figure(HEIGHT_MM)
    panels = figure.subplots(2, 2, sharex="col", width_ratios=[1.7, 1.0])
    _draw_column(panels[:, 0], columns, contacts_s, 5)
    near = np.abs(columns["time"] - contacts_s[-1]) <= NEAR_S
    detail = {name: values[near] for name, values in columns.items()}
    detail["time"] = detail["time"] - contacts_s[-1]
    _draw_column(panels[:, 1], detail, np.zeros(1), 3)
    kind, site = touch["kind"].decode(), touch["site"].decode()
    panels[0, 0].set_ylabel("actuator voltage (V)")
    panels[1, 0].set_ylabel("displacement (µm)")
    panels[1, 0].set_xlabel("time (s)")
    panels[1, 1].set_xlabel("from contact (s)")
    letter_panels(panels.ravel())
    panels[0, 0].set_title(f"{kind} at {site}", loc="right", pad=2.0)
    panels[0, 1].set_title("last contact", loc="right", pad=2.0)
    figure.legend(
        *panels[1, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, handlelength=1.8
    )
    figure.align_ylabels()
    return figure


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


def _contacts(run: RunFile, touch: np.void) -> tuple[float, float, Array]:
    """Return what to show, and when the tool touched; the time of the reading is that of its last contact."""
    last_s = float(touch["time"])
    events = run.table("/entry/events")
    times_s = events["time"][events["code"] == CONTACT].astype(np.float64)
    earliest_s = _touching_since(run, last_s)
    times_s = times_s[(times_s >= earliest_s) & (times_s <= last_s + 1e-3)]
    contacts_s = times_s if len(times_s) else np.array([last_s])
    return max(earliest_s, float(contacts_s[0]) - BEFORE_S), _touching_until(run, last_s), contacts_s


def _touching_until(run: RunFile, last_s: float) -> float:
    part = _rows_between(run, last_s, last_s + AFTER_S)
    elsewhere = np.flatnonzero(run.column("/entry/servo", "state", *part) != State.TOUCH)
    if not len(elsewhere) or elsewhere[0] == 0:
        return last_s + AFTER_S
    return float(run.column("/entry/servo", "time", *part)[elsewhere[0]])


def _touching_since(run: RunFile, last_s: float) -> float:
    part = _rows_between(run, last_s - LONGEST_S, last_s)
    time_s = run.column("/entry/servo", "time", *part).astype(np.float64)
    elsewhere = np.flatnonzero(run.column("/entry/servo", "state", *part) != State.TOUCH)
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
    upper.plot(time_s, columns["v_cmd"], color=VERMILLION)
    _line(lower, time_s, columns["z_sensor"], GREY, 1.0, "sensor")
    _line(lower, time_s, columns["z_model"], BLUE, 0.8, "estimated")
    lower.set_xlim(time_s[0], time_s[-1])


def _line(axes: Axes, time_s: Array, values: Array, colour: str, width: float, label: str) -> None:
    if np.isfinite(values).any():
        axes.plot(time_s, values, color=colour, linewidth=width, label=label)
