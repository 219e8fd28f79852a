"""Several runs in one figure: their depth against the time of machining, and the measured results."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.labels import is_open, open_marks
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.numbers import RunNumbers, numbers_of, target_depths_um
from edmctl.report.signals import envelopes
from edmctl.report.style import BLACK, BLUE, GREEN, GREY, LIGHT, ORANGE, PURPLE, SKY, VERMILION, NothingToDraw

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
    per, label = style.time_unit(max((time_s[-1] for time_s, _ in lines if len(time_s)), default=0.0))
    figure, (depth, end_depth, end_wear) = style.panels(
        style.Block(label.replace("time", "time machining"), {"estimated depth (µm)": 1.9}, (2.0, 1.0, 1.0)),
        width_mm=style.PAGE_MM,
    )
    for number, (name, (time_s, depth_um)) in enumerate(zip(names, lines, strict=True)):
        colour, dash = _COLOURS[number % len(_COLOURS)], _DASHES[number % len(_DASHES)]
        if len(time_s):
            depth.plot(time_s / per, depth_um, color=colour, linestyle=dash, label=name)
    depth.margins(x=0.02)
    several = ", mean of sites" if any(len(n.sites) > 1 for n in numbers) else ""
    _draw_results(end_depth, names, numbers, "depth")
    _draw_results(end_wear, names, numbers, "wear")
    end_depth.set_ylabel(f"depth{several} (µm)")
    end_wear.set_ylabel(f"tool wear{several} (µm)")
    _draw_target(end_depth, runs)
    style.shared_legend(figure, (depth, end_depth), ncols=8)
    simulated = [name for name, run in zip(names, runs, strict=True) if run.is_simulated]
    if simulated:
        words = "all simulated" if len(simulated) == len(runs) else f"simulated: {', '.join(simulated)}"
        style.mark_below(figure, words)
    return figure


def _depth_line(run: RunFile) -> tuple[Array, Array]:
    """Return the time with the servo on and the estimated depth, with NaN where the tool went to another place."""
    lines = envelopes(
        run, "/entry/slow", ["est_depth"], lambda rows: {"depth": rows["est_depth"].astype(np.float64)}
    )
    if not lines:
        return np.empty(0), np.empty(0)
    found, depth_um = lines["depth"], lines["depth"].mean
    steps_s = np.diff(found.time_s, prepend=found.time_s[0])
    usual_s = float(np.median(steps_s[1:])) if len(steps_s) > 1 else 0.0
    steps_s[steps_s > max(PAUSE_S, 3.0 * usual_s)] = usual_s
    time_s = np.cumsum(steps_s)
    breaks = np.flatnonzero(np.diff(depth_um) < -NEW_SITE_UM) + 1
    return np.insert(time_s, breaks, np.nan), np.insert(depth_um, breaks, np.nan)


def _draw_results(axes: Axes, names: Sequence[str], numbers: Sequence[RunNumbers], quantity: str) -> None:
    """Draw a point for each run with its 95 % interval, open if it was not measured with a sensor."""
    bases = [of_run.basis(quantity) for of_run in numbers]
    for number, of_run in enumerate(numbers):
        value, u95 = of_run.mean(f"{quantity}_um"), of_run.mean(f"{quantity}_u95_um")
        colour = _COLOURS[number % len(_COLOURS)]
        style.draw_points(axes, number, value, u95, colour, full=not is_open(bases[number]))
    style.note_above(axes, open_marks(bases))
    axes.set_xlabel("run")
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.margins(y=0.15)
    axes.grid(visible=False, axis="x")


def _draw_target(axes: Axes, runs: Sequence[RunFile]) -> None:
    """Draw the target depth and its tolerance if all runs have the same."""
    targets = {target_depths_um(run.profile_values()) for run in runs}
    if len(targets) == 1 and (target := targets.pop()) is not None:
        target_um, tolerance_um = target
        axes.axhspan(
            target_um - tolerance_um, target_um + tolerance_um, color=LIGHT, label="target", zorder=0
        )
        axes.axhline(target_um, color=GREY, linewidth=0.6)
