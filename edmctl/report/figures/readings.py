"""Readings by touching: the touches themselves, and Z1, Z2 and Z3 of each hole with the lengths that follow.

Like Fig. 9 of Muralidhara et al. 2009. At a contact the voltage peaks, and falls while the tool stays there, because
the actuator creeps. Z1 touches the surface before, Z2 the bottom, Z3 the surface after: feed = Z2 − Z1,
depth = Z2 − Z3, wear = Z3 − Z1.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.labels import Basis
from edmctl.record.reader import TOUCH, RecordedState, RunFile, has_sensor, sites_of
from edmctl.report import panels, signals
from edmctl.report.panels import Block
from edmctl.results.job import length_text
from edmctl.results.run_file import RecordedSite
from edmctl.wording import plain_number

LONGEST_S = 600.0
"""No set of touches takes longer."""
BEFORE_S, AFTER_S = 2.5, 1.0
"""Shown before the first contact of the set and after the last."""
LONGEST_NAME = 40
NEAR_S = 0.7
"""The detail shows so much on both sides of the last contact, or its hold if that is longer."""
Y = ("actuator voltage (V)", "displacement (µm)")

COLUMN_SITES = 3
"""As many sites fit into one column."""
NUMBERED_SITES = 12
"""With more sites there is no room for numbers below them."""
NAMED_SITES = 30
PITCH = 4.4
"""Distance from site to site on the horizontal axis, in widths of a reading."""
COLOURS = {"depth": panels.BLUE, "wear": panels.VERMILION, "feed": panels.GREEN}


def draw_touching(run: RunFile) -> Figure:
    """Draw the last accepted touches, of Z2 if there are any, below all readings since Z1. Raises NothingToDraw."""
    touches = run.table("/entry/touches")
    accepted = touches[touches["accepted"] == 1]
    chosen = next(
        (rows for rows in (accepted[accepted["kind"] == b"Z2"], accepted, touches) if len(rows)), None
    )
    if chosen is None:
        raise panels.NothingToDraw(
            "The tool touched nothing in this run; a job that measures, or `edmctl measure-wear`, does."
        )
    touch = chosen[-1]
    hold_s = max(0.0, np.nan_to_num(plain_number(run.profile_values().get("measure.dwell_s"))))
    after_s = max(AFTER_S, hold_s + NEAR_S)
    begin_s, end_s, contacts_s = _contacts(run, float(touch["time"]), after_s)
    part = _rows_between(run, begin_s, end_s)
    if part[1] - part[0] < 2:
        raise panels.NothingToDraw(
            "The servo signals of this file do not cover its touches; those of a whole run file do."
        )
    # The readings from the last Z1 on, with all its spots; all of them without one.
    surface = accepted["kind"] == b"Z1"
    begins = np.flatnonzero(surface & ~np.append(False, surface[:-1]))
    sequence, whole = accepted[begins[-1] if len(begins) else 0 :], (0, 0)
    if len(sequence) > 1:
        first_s, last_s = sequence["time"][[0, -1]].tolist()
        whole = _rows_between(run, _touching_since(run, first_s), last_s + after_s)
    has_whole = whole[1] - whole[0] > 1
    span_s = signals.time_at(run, whole[1] - 1) - signals.time_at(run, whole[0]) if has_whole else 0.0
    unit_s, label = panels.time_unit(span_s)
    blocks = [Block(label, dict.fromkeys(Y, 1.0))] if has_whole else []
    zoom = Block("time (s)", dict.fromkeys(Y, 1.1), (1.7, 1.0), above_mm=panels.TITLE_MM)
    figure, axes = panels.panels(*blocks, zoom, gap_mm=11.0)
    if has_whole:
        _draw_sequence(axes[:2], run, sequence, whole, unit_s)
    left, right = (axes[-4], axes[-2]), (axes[-3], axes[-1])
    columns = signals.floats(run, signals.SERVO, ("time", "v_cmd", "z_sensor", "z_model"), part)
    _draw_zoom(left, columns, contacts_s, 5)
    since_s = columns["time"] - contacts_s[-1]
    near = (since_s >= -NEAR_S) & (since_s <= max(NEAR_S, hold_s + 0.5 * NEAR_S))
    detail = {name: values[near] for name, values in (columns | {"time": since_s}).items()}
    _draw_zoom(right, detail, [0.0], 3)
    right[1].set_xlabel("from contact (s)")
    panels.note_above(right[0], "last contact")
    site = touch["site"].decode()
    site = site if len(site) <= LONGEST_NAME else site[:LONGEST_NAME] + "…"
    left[0].set_title(f"Touches of {touch['kind'].decode()}: {site}", x=0.5 + 0.3, y=1.13, pad=0.0)
    panels.shared_legend(figure, axes, ncols=4)
    return figure


def _draw_sequence(
    pair: Sequence[Axes], run: RunFile, readings: NDArray[np.void], part: tuple[int, int], unit_s: float
) -> None:
    sensed = bool(np.isfinite(readings["z_sensor"]).any())
    place = "z_sensor" if sensed else "z_model"

    def derive(columns: signals.Columns) -> dict[str, signals.Floats]:
        return {name: signals.without_jumps(columns[name], columns["state"]) for name in ("v_cmd", place)}

    lines = signals.envelopes(run, signals.SERVO, ["v_cmd", place, "state"], derive, part)
    for axes, name, colour in zip(
        pair, lines, (panels.VERMILION, panels.GREY if sensed else panels.BLUE), strict=True
    ):
        panels.draw_envelope(axes, lines[name], unit_s, colour)
        panels.mark_readings(axes, readings, name, unit_s)
        axes.locator_params(axis="y", nbins=5)
    time_s = lines["v_cmd"].time_s
    pair[1].set_xlim(time_s[0] / unit_s, time_s[-1] / unit_s)


def _draw_zoom(
    pair: Sequence[Axes], columns: Mapping[str, Array], contacts_s: Sequence[float], bins: int
) -> None:
    time_s = columns["time"]
    for axes in pair:
        for contact_s in contacts_s:
            axes.axvline(
                contact_s, color=panels.BLACK, linewidth=0.6, linestyle=(0, (1.5, 1.5)), label="contact"
            )
        axes.locator_params(axis="x", nbins=bins)
        axes.locator_params(axis="y", nbins=5)
    pair[0].plot(time_s, columns["v_cmd"], color=panels.VERMILION)
    for name, colour, width, label in (
        ("z_sensor", panels.GREY, 1.0, "sensor"),
        ("z_model", panels.BLUE, 0.8, "estimated"),
    ):
        if np.isfinite(columns[name]).any():
            pair[1].plot(time_s, columns[name], color=colour, linewidth=width, label=label)
    pair[1].set_xlim(time_s[0], time_s[-1])


def _contacts(run: RunFile, last_s: float, after_s: float) -> tuple[float, float, list[float]]:
    """Return what to show, and the times of contact; the time of the reading is that of its last contact."""
    events = run.table("/entry/events")
    times_s = events["time"][events["code"] == TOUCH].astype(np.float64)
    earliest_s = _touching_since(run, last_s)
    contacts_s = times_s[(times_s >= earliest_s) & (times_s <= last_s + 1e-3)].tolist() or [last_s]
    end_s = last_s + after_s
    first, stop = _rows_between(run, last_s, end_s)
    elsewhere = np.flatnonzero(run.column(signals.SERVO, "state", first, stop) != RecordedState.TOUCH)
    if len(elsewhere) and elsewhere[0] > 0:
        end_s = signals.time_at(run, first + int(elsewhere[0]))
    return max(earliest_s, contacts_s[0] - BEFORE_S), end_s, contacts_s


def _touching_since(run: RunFile, last_s: float) -> float:
    """Return since when the tool had been touching at a time."""
    first, stop = _rows_between(run, last_s - LONGEST_S, last_s)
    if stop == first:
        return last_s - BEFORE_S
    time_s, state = signals.floats(run, signals.SERVO, ("time", "state"), (first, stop)).values()
    # The state of the last rows may already be the next one.
    elsewhere = np.flatnonzero((state != RecordedState.TOUCH) & (time_s < last_s - 0.1))
    return float(time_s[min(int(elsewhere[-1]) + 1, len(time_s) - 1)] if len(elsewhere) else time_s[0])


def _rows_between(run: RunFile, begin_s: float, end_s: float) -> tuple[int, int]:
    """Return the rows of `/entry/servo` in an interval of time, by bisection: the file may be long."""
    rows = range(run.rows(signals.SERVO))

    def row_at(at_s: float) -> int:
        return bisect_left(rows, at_s, key=lambda row: signals.time_at(run, row))

    return row_at(begin_s), row_at(end_s)


@dataclass(frozen=True, slots=True)
class _Readings:
    """Z1, Z2 and Z3 of a site, µm, which of them were touched, and their estimates from the voltage alone.

    In an array Z1 may follow from the holes before, without a touch. The estimate starts at Z1 as touched; Z2 and Z3
    follow by its own wear and depth, and are NaN if one of them is unknown.
    """

    site: RecordedSite
    z_um: tuple[float, float, float]
    touched: tuple[bool, bool, bool]
    model_um: tuple[float, float, float]


def _readings_of(site: RecordedSite, touches: NDArray[np.void]) -> _Readings:
    rows = touches[(touches["kind"] == b"Z1") & (touches["accepted"] == 1)]
    z1_um = [float(row["z_model"]) for row in rows if row["site"].decode(errors="ignore") == site.name]
    start_um = z1_um[-1] if z1_um else math.nan
    z3_um = start_um + site.wear_model_um
    # Z3 of a hole through the sheet is a touch, and so is that of a touched depth.
    bottom = site.depth_basis in (Basis.TOUCHED, Basis.MODEL)
    touched = (bool(z1_um), bottom, site.through or site.depth_basis != Basis.ESTIMATED)
    model_um = (start_um, z3_um + site.depth_model_um, z3_um)
    return _Readings(site, (site.z1_um, site.z2_um, site.z3_um), touched, model_um)


def draw_steps(run: RunFile) -> Figure:
    """Draw the readings of each site, over both columns of a page beyond three. Raises NothingToDraw without any."""
    sensor, touches = has_sensor(run), run.table("/entry/touches")
    every = [_readings_of(site, touches) for site in sites_of(run)]
    readings = [one for one in every if np.isfinite(one.z_um).all()]
    if not readings:
        raise panels.NothingToDraw(
            "No site of this run was measured, so there are no readings Z1, Z2 and Z3; a job that reaches its "
            "first measuring stop has them."
        )
    alone = len(readings) == 1
    width_mm = panels.PAGE_MM if len(readings) > COLUMN_SITES else panels.COLUMN_MM
    figure, (axes,) = panels.panels(Block("", {"tool displacement (µm)": 1.9}), width_mm=width_mm)
    words = "measured" if sensor else "by contact, estimated displacement"
    for number, one in enumerate(readings):
        _draw_site(axes, one, number * PITCH, words, alone=alone)
        # Without a sensor the touches are estimates from the voltage themselves.
        if sensor and np.isfinite(one.model_um).all():
            begins = number * PITCH + np.arange(3) + 0.1
            dash, label = (0, (2.5, 1.2)), "estimated from voltage"
            axes.hlines(
                one.model_um, begins, begins + 0.8, panels.GREY, linewidth=1.0, linestyle=dash, label=label
            )
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    room = 1.35 if alone else 0.6  # for the words beside the arrows
    axes.set_xlim(-0.15 if alone else -0.6, (len(readings) - 1) * PITCH + 3.0 + room)
    axes.margins(y=0.12)
    if alone:
        through = readings[0].site.through
        bottom = "tip at\nthe end" if through else "bottom"
        panels.grow(figure, below_mm=2.5 if through else 0.0)
        axes.set_xticks([0.5, 1.5, 2.5], ["Z1\nsurface before", f"Z2\n{bottom}", "Z3\nsurface after"])
        axes.set_title(readings[0].site.name, loc="left", pad=2.0)
    else:
        _name_sites(figure, axes, [one.site for one in readings])
    panels.shared_legend(figure, [axes], ncols=3)
    return figure


def _draw_site(axes: Axes, readings: _Readings, left: float, words: str, *, alone: bool) -> None:
    site, z_um = readings.site, readings.z_um
    edges = left + np.arange(4.0)
    for number, (value_um, touched) in enumerate(zip(z_um, readings.touched, strict=True)):
        axes.plot(
            edges[number : number + 2], [value_um] * 2, color=panels.BLACK, linewidth=1.2,
            linestyle="-" if touched else (0, (1.0, 0.8)), label=words if touched else "without a touch",
        )  # fmt: skip
    for edge, ends in zip(edges[1:], pairwise(z_um), strict=False):
        axes.plot([edge, edge], ends, color=panels.BLACK, linewidth=0.5)
    low, high = left + 0.18, left + 3.12
    # Each reading continues to the arrows that are measured from it.
    for value_um, begin, end in (
        (z_um[2], edges[3], high),
        (z_um[0], edges[1], high),
        (z_um[1], left, edges[1]),
        (z_um[1], edges[2], high),
    ):
        axes.plot([begin, end], [value_um] * 2, color=panels.GREY, linewidth=0.5, linestyle=":")
    lengths = {"feed": (low, 0, 1), "depth": (high, 2, 1), "wear": (high, 0, 2)}
    for name, (at, begin, end) in lengths.items():
        if name == "depth" and site.through:
            continue
        text = length_text(site, name, 1)
        if name == "feed":  # between its arrow and the step there is little room
            text = text.replace(" ±", "\n±")
        ends = (z_um[begin], z_um[end])
        panels.draw_length(axes, at, ends, COLOURS[name], f"{name}\n{text} µm" if alone else "")


def _name_sites(figure: Figure, axes: Axes, sites: Sequence[RecordedSite]) -> None:
    """Write the names of the sites below their columns, and their numbers."""
    middles = np.arange(len(sites)) * PITCH + 1.5
    names = [site.name for site in sites]
    if len(sites) > NUMBERED_SITES:
        every = -(-len(sites) // NAMED_SITES)
        axes.set_xticks(middles[::every], names[::every], rotation=90)
        panels.grow(figure, below_mm=1.3 * max(map(len, names)) - 4.0)
        return
    axes.set_xticks(middles, names)
    axes.tick_params(axis="x", labelsize=6.0)
    panels.grow(figure, below_mm=5.5)
    for row, (name, colour) in enumerate(COLOURS.items()):
        words = [(f"{name} (µm)", 0.0, "axes fraction", -4.0, "right")]
        words += [
            (length_text(site, name, 1), middle, "data", 0.0, "center")
            for middle, site in zip(middles, sites, strict=True)
        ]
        for text, at, of, aside, side in words:
            axes.annotate(
                text, (at, 0.0), xytext=(aside, -15.0 - 9.0 * row), xycoords=(of, "axes fraction"),
                textcoords="offset points", ha=side, va="center", color=colour, fontsize=6.0,
            )  # fmt: skip
