"""Depth, tool wear and feed rate against time: what was estimated all along, and what was measured now and then."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.record import layout
from edmctl.record.told import Told
from edmctl.report.happened import happened
from edmctl.report.stretches import MEAN_S, broken, running_mean
from edmctl.report.style import (
    BLACK,
    BLUE,
    GREY,
    LINE,
    VERMILLION,
    NothingToDraw,
    draw_envelope,
    new_figure,
)
from edmctl.report.time_axis import time_unit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile
    from edmctl.report.happened import Happened

    Array = NDArray[np.float64]

COLUMNS = ("time", "est_depth", "est_depth_u95", "est_wear", "feed_um_s")
DASHED = (0, (4, 1.5))
USUAL_PERCENT, HEADROOM = 90.0, 1.6
"""The feed is drawn up to so much above what most of the run stays below."""
MANY = 30
"""So many measured values get smaller marks."""


def draw(run: RunFile) -> Figure:
    """Draw the estimates of each hole from 0 on, its measured values at the times of their touches, and the feed."""
    rows = {name: run.column(layout.SLOW.path, name).astype(np.float64) for name in COLUMNS}
    if not np.isfinite(rows["est_depth"]).any():
        raise NothingToDraw("Nothing was cut: the run ended before its first cut.")
    has_feed = bool(np.isfinite(rows["feed_um_s"]).any())
    figure = new_figure(88.0 if has_feed else 62.0)
    panels = figure.subplots(
        2 if has_feed else 1, 1, sharex=True, squeeze=False, height_ratios=[1.8, 1.0][: 1 + has_feed]
    )
    erosion = panels[0, 0]
    unit = time_unit(float(rows["time"][-1]))
    _draw_estimates(erosion, rows, unit.seconds)
    _draw_measured(erosion, run, unit.seconds)
    _draw_target(erosion, run)
    erosion.set_ylim(bottom=min(0.0, erosion.get_ylim()[0]))
    erosion.set_ylabel("depth and wear (µm)")
    if has_feed:
        _draw_feed(panels[1, 0], rows, unit.seconds)
        for axes, letter in zip(panels[:, 0], "ab", strict=True):
            axes.set_title(f"({letter})", loc="left", pad=3.0)
        figure.align_ylabels()
    panels[-1, 0].set_xlabel(unit.label)
    handles, names = erosion.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=2, handlelength=2.0, columnspacing=1.5)
    return figure


def _draw_estimates(axes: Axes, rows: dict[str, Array], seconds: float) -> None:
    time_s, depth_um, u95_um = rows["time"], rows["est_depth"], rows["est_depth_u95"]
    if np.isfinite(u95_um).any():
        low, high = broken(time_s, depth_um - u95_um), broken(time_s, depth_um + u95_um)
        axes.fill_between(
            low.time_s / seconds,
            low.low,
            high.high,
            color=BLUE,
            alpha=0.25,
            linewidth=0.0,
            label="its 95 % band",
        )
    depth = broken(time_s, depth_um)
    draw_envelope(axes, depth.time_s / seconds, depth.low, depth.high, BLUE, "estimated depth", 1.0)
    if np.isfinite(rows["est_wear"]).any():
        wear = broken(time_s, rows["est_wear"])
        middle = 0.5 * (wear.low + wear.high)
        axes.plot(
            wear.time_s / seconds,
            middle,
            color=VERMILLION,
            linestyle=DASHED,
            linewidth=1.0,
            label="estimated wear",
        )


def _draw_measured(axes: Axes, run: RunFile, seconds: float) -> None:
    measured = happened(run, Told.SITE_MEASURED, Told.CHANNEL_MEASURED)
    untouched = happened(run, Told.SITE_ESTIMATED)
    size = 2.4 if len(measured) + len(untouched) > MANY else 3.6
    _draw_points(axes, measured, "depth", BLUE, "o", size, seconds, "measured depth")
    _draw_points(axes, measured, "wear", VERMILLION, "s", size, seconds, "measured wear")
    _draw_points(axes, untouched, "depth", BLUE, "o", size, seconds, "depth without a touch", hollow=True)
    _draw_points(axes, untouched, "wear", VERMILLION, "s", size, seconds, "wear without a touch", hollow=True)


def _draw_points(
    axes: Axes,
    found: Sequence[Happened],
    name: str,
    colour: str,
    mark: str,
    size: float,
    seconds: float,
    label: str,
    *,
    hollow: bool = False,
) -> None:
    """Points with bars of 95 %; older files have none for what was not the last measurement."""
    if not found:
        return
    axes.errorbar(
        [event.time_s / seconds for event in found],
        [event.number(f"{name}_um") for event in found],
        yerr=np.nan_to_num([event.number(f"{name}_u95_um") for event in found]),
        fmt=mark,
        color=BLACK,
        markerfacecolor="white" if hollow else colour,
        markeredgecolor=colour if hollow else BLACK,
        markeredgewidth=0.7 if hollow else 0.4,
        markersize=size,
        elinewidth=0.7,
        capsize=1.8,
        capthick=0.7,
        label=label,
        zorder=4,
    )


def _draw_target(axes: Axes, run: RunFile) -> None:
    target_um = run.profile_values().get("target.depth_um")
    if isinstance(target_um, int | float):
        axes.axhline(
            target_um, color=GREY, linewidth=LINE, linestyle=(0, (1, 1.5)), label=f"target {target_um:g} µm"
        )


def _draw_feed(axes: Axes, rows: dict[str, Array], seconds: float) -> None:
    """The tool closing on its gap at the beginning of a cut is let out of the axes, and told."""
    mean_um_s = running_mean(rows["time"], rows["feed_um_s"])
    feed = broken(rows["time"], mean_um_s)
    draw_envelope(axes, feed.time_s / seconds, feed.low, feed.high, BLACK)
    highest, usual = (float(np.nanpercentile(mean_um_s, share)) for share in (100.0, USUAL_PERCENT))
    if highest > HEADROOM * usual > 0.0:
        axes.set_ylim(min(0.0, float(np.nanmin(mean_um_s))), HEADROOM * usual)
        axes.set_title(f"at the start of a cut up to {highest:.2g} µm/s", loc="right", pad=3.0)
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.set_ylabel(f"feed rate, mean\nof {MEAN_S:g} s (µm/s)")
