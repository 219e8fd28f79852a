"""Several runs in one figure: their depth against the time that they machined, and what was measured in the end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from edmctl.labels import is_open, open_marks
from edmctl.report.numbers import RunNumbers, numbers_of, target_depths_um
from edmctl.report.signals import envelopes
from edmctl.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LIGHT,
    LINE,
    ORANGE,
    PAGE_MM,
    PURPLE,
    SKY,
    VERMILION,
    NothingToDraw,
    draw_points,
    letter_panels,
    mark_below,
    new_figure,
    time_unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile

HEIGHT_MM = 70.0
SLOW = "/entry/slow"
PAUSE_S = 1.0
"""Rows further apart than this have something else than machining between them."""
NEW_SITE_UM = 2.0
"""An estimated depth that falls by more than this belongs to another place."""

_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK)
_DASHES = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (2.5, 1.2)))


def draw(runs: Sequence[RunFile], names: Sequence[str]) -> Figure:
    """Draw open run files under their names. Raises NothingToDraw."""
    numbers = [numbers_of(run) for run in runs]
    lines = [_depth_line(run) for run in runs]
    if not any(len(time_s) for time_s, _ in lines) and not any(n.sites for n in numbers):
        raise NothingToDraw("None of the runs has machined anything.")
    figure = new_figure(HEIGHT_MM, PAGE_MM)
    depth, end_depth, end_wear = figure.subplots(1, 3, width_ratios=[2.0, 1.0, 1.0])
    longest_s = max((time_s[-1] for time_s, _ in lines if len(time_s)), default=0.0)
    per, label = time_unit(longest_s)
    for number, (name, (time_s, depth_um)) in enumerate(zip(names, lines, strict=True)):
        colour, dash = _COLOURS[number % len(_COLOURS)], _DASHES[number % len(_DASHES)]
        if len(time_s):
            depth.plot(time_s / per, depth_um, color=colour, linestyle=dash, linewidth=LINE, label=name)
    depth.set_xlabel(label.replace("time", "time machining"))
    depth.set_ylabel("estimated depth (µm)")
    depth.margins(x=0.02)
    several = any(len(n.sites) > 1 for n in numbers)
    _results(end_depth, names, numbers, "depth")
    _results(end_wear, names, numbers, "wear")
    end_depth.set_ylabel("depth, mean of sites (µm)" if several else "depth (µm)")
    end_wear.set_ylabel("tool wear, mean of sites (µm)" if several else "tool wear (µm)")
    _band(end_depth, runs)
    letter_panels((depth, end_depth, end_wear))
    handles, labels = depth.get_legend_handles_labels()
    handles += end_depth.get_legend_handles_labels()[0]
    labels += end_depth.get_legend_handles_labels()[1]
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(handles), 8), handlelength=2.6)
    simulated = [name for name, run in zip(names, runs, strict=True) if run.is_simulated]
    if simulated:
        mark_below(
            figure, "all simulated" if len(simulated) == len(runs) else f"simulated: {', '.join(simulated)}"
        )
    return figure


def _depth_line(run: RunFile) -> tuple[Array, Array]:
    """Estimated depth against the time with the servo on, broken where the tool went to another place."""
    lines = envelopes(run, SLOW, ["est_depth"], lambda rows: {"depth": rows["est_depth"].astype(np.float64)})
    if not lines:
        return np.empty(0), np.empty(0)
    found, depth_um = lines["depth"], lines["depth"].mean
    steps_s = np.diff(found.time_s, prepend=found.time_s[0])
    usual_s = float(np.median(steps_s[1:])) if len(steps_s) > 1 else 0.0
    steps_s[steps_s > max(PAUSE_S, 3.0 * usual_s)] = usual_s
    time_s = np.cumsum(steps_s)
    breaks = np.flatnonzero(np.diff(depth_um) < -NEW_SITE_UM) + 1
    return np.insert(time_s, breaks, np.nan), np.insert(depth_um, breaks, np.nan)


def _results(axes: Axes, names: Sequence[str], numbers: Sequence[RunNumbers], quantity: str) -> None:
    """One point a run with its 95 % interval, open where it was not touched with a sensor."""
    bases = [of_run.basis(quantity) for of_run in numbers]
    for number, of_run in enumerate(numbers):
        value, u95 = of_run.mean(f"{quantity}_um"), of_run.mean(f"{quantity}_u95_um")
        colour = _COLOURS[number % len(_COLOURS)]
        draw_points(axes, number, value, u95, colour, full=not is_open(bases[number]))
    axes.set_title(open_marks(bases), loc="right", pad=3.0)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.margins(y=0.15)
    axes.grid(visible=False, axis="x")


def _band(axes: Axes, runs: Sequence[RunFile]) -> None:
    """The depth that was wanted, where all runs wanted the same."""
    targets = {target_depths_um(run.profile_values()) for run in runs}
    if len(targets) != 1 or (target := targets.pop()) is None:
        return
    wanted_um, tolerance_um = target
    axes.axhspan(wanted_um - tolerance_um, wanted_um + tolerance_um, color=LIGHT, label="wanted", zorder=0)
    axes.axhline(wanted_um, color=GREY, linewidth=0.6)
