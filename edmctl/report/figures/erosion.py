"""Depth, tool wear and feed rate against time: estimates, and the measured values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.record import layout
from edmctl.record.reader import RunFile
from edmctl.record.run_index import has_sensor
from edmctl.report import panels
from edmctl.report.removal import KnownDepth, hole_starts_s, known_depths
from edmctl.report.signals import MEAN_S, broken, floats, running_mean
from edmctl.report.style import BLACK, BLUE, DASHED, GREY, VERMILION, Dash, NothingToDraw, time_unit

COLUMNS = ("time", "est_depth", "est_depth_u95", "est_wear", "est_wear_u95", "feed_um_s")
USUAL_PERCENT, HEADROOM = 90.0, 1.6
"""The feed is drawn up to HEADROOM times this percentile."""
MANY = 30
"""More measured values get smaller marks."""
FAR = 3.0
"""A target so many times as deep as what was drawn is written, not drawn."""


def draw_erosion(run: RunFile) -> Figure:
    """Draw the estimates of each hole from 0 on, its measured values at the times of their touches, and the feed."""
    rows = floats(run, layout.SLOW.path, COLUMNS)
    if not np.isfinite(rows["est_depth"]).any():
        raise NothingToDraw("Nothing was cut: the run ended before its first cut.")
    has_feed = bool(np.isfinite(rows["feed_um_s"]).any())
    per_s, label = time_unit(float(rows["time"][-1]))
    feed = {f"feed rate, mean\nof {MEAN_S:g} s (µm/s)": 0.8} if has_feed else {}
    figure, axes = panels.panels(panels.Block(label, {"depth and wear (µm)": 1.5, **feed}))
    erosion = axes[0]
    _draw_estimate(erosion, rows, "depth", per_s, BLUE, "-")
    _draw_estimate(erosion, rows, "wear", per_s, VERMILION, DASHED)
    _draw_known(erosion, known_depths(run, hole_starts_s(run)), per_s, sensor=has_sensor(run))
    _draw_target(erosion, run)
    erosion.set_ylim(bottom=min(0.0, erosion.get_ylim()[0]))
    if has_feed:
        _draw_feed(axes[1], rows, per_s, label)
    else:
        erosion.set_title("no feed rate: the tool was fed by layers", loc="left", pad=2.0)
    panels.shared_legend(figure, [erosion])
    return figure


def _draw_estimate(
    axes: Axes, rows: dict[str, Array], name: str, per_s: float, colour: str, dash: Dash
) -> None:
    """Draw an estimate with its 95 % interval, if that is known."""
    value_um, u95_um = rows[f"est_{name}"], rows[f"est_{name}_u95"]
    if not np.isfinite(value_um).any():
        return
    line = broken(rows["time"], value_um)
    axes.plot(
        line.time_s / per_s, line.mean, color=colour, linestyle=dash, linewidth=1.0, label=f"estimated {name}"
    )
    if np.isfinite(u95_um).any():
        low, high = broken(rows["time"], value_um - u95_um), broken(rows["time"], value_um + u95_um)
        axes.fill_between(
            low.time_s / per_s, low.low, high.high, color=colour, alpha=0.25, linewidth=0.0,
            label=f"95 % band of {name}",
        )  # fmt: skip


def _draw_known(axes: Axes, known: Sequence[KnownDepth], per_s: float, *, sensor: bool) -> None:
    """Draw depths as discs and wear as squares, full where they were touched."""
    size = 2.4 if len(known) > MANY else 3.6
    last_touch_s = max((depth.time_s for depth in known if depth.touched), default=0.0)
    corrected = any(depth.time_s < last_touch_s for depth in known if not depth.touched)
    names = {
        True: "measured {}" if sensor else "{} by contact, from voltage",
        False: "{} without a touch" + (", corrected later" if corrected else ""),
    }
    for touched, words in names.items():
        for name, colour, mark, asked in (
            ("depth", BLUE, "o", "touched"),
            ("wear", VERMILION, "s", "wear_touched"),
        ):
            values = [
                (one.time_s / per_s, getattr(one, f"{name}_um"), getattr(one, f"{name}_u95_um"))
                for one in known
                if getattr(one, asked) is touched and np.isfinite(getattr(one, f"{name}_um"))
            ]
            if values:
                time, value_um, u95_um = np.array(values).T
                panels.draw_points(
                    axes, time, value_um, np.nan_to_num(u95_um), colour, full=touched, marker=mark,
                    size=size, label=words.format(name),
                )  # fmt: skip


def _draw_target(axes: Axes, run: RunFile) -> None:
    """Draw the target depth, or the thickness of a sheet that holes go through, unless far above."""
    values = run.profile_values()
    through = values.get("target.kind") == "through"
    value_um = run.number("/entry/sample/thickness") if through else values.get("target.depth_um")
    if not isinstance(value_um, int | float) or not np.isfinite(value_um):
        return
    target_um = float(value_um)
    label = f"sheet {target_um:g} µm thick" if through else f"target {target_um:g} µm"
    if target_um > FAR * axes.get_ylim()[1]:
        panels.note_above(axes, f"{label}, far above")
    else:
        axes.axhline(target_um, color=GREY, linestyle=(0, (1, 1.5)), label=label)


def _draw_feed(axes: Axes, rows: dict[str, Array], per_s: float, label: str) -> None:
    """Draw the feed rate; the highest, of a tool closing on its gap, is cut off and written with its time."""
    mean_um_s = running_mean(rows["time"], rows["feed_um_s"])
    panels.draw_envelope(axes, broken(rows["time"], mean_um_s), per_s, BLACK)
    highest, usual = (float(np.nanpercentile(mean_um_s, share)) for share in (100.0, USUAL_PERCENT))
    if highest > HEADROOM * usual > 0.0:
        axes.set_ylim(min(0.0, float(np.nanmin(mean_um_s))), HEADROOM * usual)
        at = float(rows["time"][np.nanargmax(mean_um_s)]) / per_s
        unit = label.partition("(")[2].rstrip(")")
        panels.note_above(axes, f"up to {highest:.2g} µm/s at {at:.3g} {unit}, cut off")
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
