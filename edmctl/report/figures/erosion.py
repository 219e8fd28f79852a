"""Depth, tool wear and feed rate against time: what was estimated all along, and what was measured now and then."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record import layout
from edmctl.record.results import has_sensor
from edmctl.report.removal import KnownDepth, hole_starts_s, known_depths
from edmctl.report.signals import MEAN_S, broken, floats, running_mean
from edmctl.report.style import (
    BLACK,
    BLUE,
    DASHED,
    GREY,
    LINE,
    VERMILION,
    NothingToDraw,
    draw_envelope,
    draw_points,
    letter_panels,
    new_figure,
    shared_legend,
    time_unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile

COLUMNS = ("time", "est_depth", "est_depth_u95", "est_wear", "est_wear_u95", "feed_um_s")
DOTTED = (0, (1, 1.5))
USUAL_PERCENT, HEADROOM = 90.0, 1.6
"""The feed is drawn up to so much above what most of the run stays below."""
MANY = 30
"""So many measured values get smaller marks."""
FAR = 3.0
"""A target so many times as deep as what was drawn is written, not drawn."""


def draw(run: RunFile) -> Figure:
    """Draw the estimates of each hole from 0 on, its measured values at the times of their touches, and the feed."""
    rows = floats(run, layout.SLOW.path, COLUMNS)
    if not np.isfinite(rows["est_depth"]).any():
        raise NothingToDraw("Nothing was cut: the run ended before its first cut.")
    has_feed = bool(np.isfinite(rows["feed_um_s"]).any())
    figure = new_figure(92.0 if has_feed else 70.0)
    panels = figure.subplots(
        1 + has_feed, 1, sharex=True, squeeze=False, height_ratios=[1.8, 1.0][: 1 + has_feed]
    )[:, 0]
    erosion = panels[0]
    per_s, label = time_unit(float(rows["time"][-1]))
    _draw_estimates(erosion, rows, per_s)
    _draw_known(erosion, known_depths(run, hole_starts_s(run)), per_s, sensor=has_sensor(run))
    _draw_wanted(erosion, run)
    erosion.set_ylim(bottom=min(0.0, erosion.get_ylim()[0]))
    erosion.set_ylabel("depth and wear (µm)")
    if has_feed:
        _draw_feed(panels[1], rows, per_s, label)
        letter_panels(panels)
        figure.align_ylabels()
    else:
        erosion.set_title("no feed rate: the tool was fed by layers", loc="left", pad=3.0)
    panels[-1].set_xlabel(label)
    shared_legend(figure, [erosion])
    return figure


def _draw_estimates(axes: Axes, rows: dict[str, Array], per_s: float) -> None:
    time_s = rows["time"]
    depth = broken(time_s, rows["est_depth"])
    draw_envelope(axes, depth, per_s, BLUE, "estimated depth", 1.0)
    _draw_band(axes, rows, "est_depth", per_s, BLUE)
    if np.isfinite(rows["est_wear"]).any():
        wear = broken(time_s, rows["est_wear"])
        time = wear.time_s / per_s
        axes.plot(time, wear.mean, color=VERMILION, linestyle=DASHED, linewidth=1.0, label="estimated wear")
        _draw_band(axes, rows, "est_wear", per_s, VERMILION)


def _draw_band(axes: Axes, rows: dict[str, Array], name: str, per_s: float, colour: str) -> None:
    """Draw the 95 % interval of an estimate where it is known; files of older versions have none of wear."""
    value_um, u95_um = rows[name], rows[f"{name}_u95"]
    if len(u95_um) != len(value_um) or not np.isfinite(u95_um).any():
        return
    low, high = broken(rows["time"], value_um - u95_um), broken(rows["time"], value_um + u95_um)
    axes.fill_between(
        low.time_s / per_s,
        low.low,
        high.high,
        color=colour,
        alpha=0.25,
        linewidth=0.0,
        label="its 95 % band",
    )


def _draw_known(axes: Axes, known: Sequence[KnownDepth], per_s: float, *, sensor: bool) -> None:
    """Draw depths as discs and wear as squares, full where they were touched."""
    size = 2.4 if len(known) > MANY else 3.6
    touched = "measured {}" if sensor else "{} by contact, from voltage"
    corrected = ", corrected later" if _touched_after(known) else ""
    for is_touched, words in ((True, touched), (False, f"{{}} without a touch{corrected}")):
        for name, colour, mark, asked in (
            ("depth", BLUE, "o", "touched"),
            ("wear", VERMILION, "s", "wear_touched"),
        ):
            values = [
                (one.time_s / per_s, getattr(one, f"{name}_um"), getattr(one, f"{name}_u95_um"))
                for one in known
                if getattr(one, asked) is is_touched and np.isfinite(getattr(one, f"{name}_um"))
            ]
            if values:
                time, value_um, u95_um = np.array(values).T
                # Older files have no interval for what was not the last measurement.
                draw_points(
                    axes, time, value_um, np.nan_to_num(u95_um), colour, full=is_touched, bars=BLACK,
                    marker=mark, size=size, label=words.format(name),
                )  # fmt: skip


def _touched_after(known: Sequence[KnownDepth]) -> bool:
    """Whether something was touched after a value without a touch: that corrects it."""
    touched_s = [depth.time_s for depth in known if depth.touched]
    return any(depth.time_s < max(touched_s, default=0.0) for depth in known if not depth.touched)


def _draw_wanted(axes: Axes, run: RunFile) -> None:
    """Draw the target depth, or the sheet where the holes went through it, unless far above."""
    values = run.profile_values()
    through = values.get("target.kind") == "through"
    value_um = run.number("/entry/sample/thickness") if through else values.get("target.depth_um")
    if not isinstance(value_um, int | float) or not np.isfinite(value_um):
        return
    wanted_um = float(value_um)
    label = f"sheet {wanted_um:g} µm thick" if through else f"target {wanted_um:g} µm"
    if wanted_um > FAR * axes.get_ylim()[1]:
        axes.set_title(f"{label}, far above", loc="right", pad=3.0)
    else:
        axes.axhline(wanted_um, color=GREY, linewidth=LINE, linestyle=DOTTED, label=label)


def _draw_feed(axes: Axes, rows: dict[str, Array], per_s: float, label: str) -> None:
    """The tool closing on its gap, or free below a sheet, is let out of the axes, and written with its time."""
    mean_um_s = running_mean(rows["time"], rows["feed_um_s"])
    feed = broken(rows["time"], mean_um_s)
    draw_envelope(axes, feed, per_s, BLACK)
    highest, usual = (float(np.nanpercentile(mean_um_s, share)) for share in (100.0, USUAL_PERCENT))
    if highest > HEADROOM * usual > 0.0:
        axes.set_ylim(min(0.0, float(np.nanmin(mean_um_s))), HEADROOM * usual)
        at = float(rows["time"][np.nanargmax(mean_um_s)]) / per_s
        unit = label.partition("(")[2].rstrip(")")
        axes.set_title(f"up to {highest:.2g} µm/s at {at:.3g} {unit}, cut off", loc="right", pad=3.0)
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.set_ylabel(f"feed rate, mean\nof {MEAN_S:g} s (µm/s)")
