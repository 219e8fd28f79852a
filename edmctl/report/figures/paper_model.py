"""The electromechanical model of Muralidhara et al. 2009 beside the actuator, like Figs 3–5 there, and their loops.

One column of panels for each waveform: voltage, displacement, error over time, and displacement over voltage where
no step crosses it. Bars in the error show what the paper reads there, dots what is read here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmctl.dataclasses import dataclass
from edmctl.report.signals import POINTS, broken
from edmctl.report.style import (
    BLACK,
    BLUE,
    COLUMN_MM,
    DASHED,
    GREY,
    PAGE_MM,
    VERMILION,
    draw_envelope,
    house_style,
    letter_panels,
    mark_below,
    new_figure,
    rendered,
    suffix_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.array_types import Array

HEIGHT_MM, LOOP_MM = 105.0, 52.0
STEP_V = 0.5
"""From one sample to the next; what changes more at once is a step."""
SENSOR, MODEL = "sensor", "model of the paper"


@dataclass(frozen=True, slots=True)
class Mark:
    """A reading: when, ours, and the paper's range (NaN where it gives none), µm, with their signs."""

    at_s: float
    ours_um: float
    paper_um: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Panel:
    """One waveform; ndarrays of shape (n,): time, voltage, displacement by sensor and by model; and readings."""

    title: str
    t_s: Array
    applied_v: Array
    sensor_um: Array
    model_um: Array
    marks: Sequence[Mark]


def draw(panels: Sequence[Panel], name: str, words: str) -> bytes:
    """Return the figure of one waveform (85 mm wide) or several (180 mm) as the file `name` would hold it.

    words : what stands below the figure in small letters
    """
    with house_style():
        figure = _figure(panels)
        mark_below(figure, words)
        return rendered(figure, suffix_of(name))


def _figure(panels: Sequence[Panel]) -> Figure:
    loops = [bool(np.abs(np.diff(panel.applied_v)).max() < STEP_V) for panel in panels]
    heights_mm = [0.2 * HEIGHT_MM, 0.42 * HEIGHT_MM, 0.38 * HEIGHT_MM] + [LOOP_MM] * any(loops)
    figure = new_figure(sum(heights_mm), COLUMN_MM if len(panels) == 1 else PAGE_MM)
    grid = figure.subplots(
        len(heights_mm), len(panels), sharey="row", squeeze=False, height_ratios=heights_mm
    )
    for column, (panel, loop) in enumerate(zip(panels, loops, strict=True)):
        _draw_column(grid[:3, column], panel)
        title = panel.title if len(panels) == 1 else panel.title.replace(", ", "\n")
        grid[0, column].set_title(title, pad=2.0)
        if loop:
            _draw_loop(grid[3, column], panel)
        elif any(loops):
            grid[3, column].set_axis_off()
    first = grid[:, 0]
    for axes, label in zip(
        first, ("voltage (V)", "displacement (µm)", "model − sensor (µm)", "displacement (µm)"), strict=False
    ):
        axes.set_ylabel(label)
    letter_panels(first)
    handles, names = grid[1, 0].get_legend_handles_labels()
    for axes in grid[2]:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if label not in names:
                handles.append(handle)
                names.append(label)
    figure.legend(handles, names, loc="outside upper center", ncols=len(names), handlelength=2.0)
    figure.align_ylabels(first)
    return figure


def _draw_column(column: NDArray[np.object_], panel: Panel) -> None:
    voltage, displacement, error = column
    t_s = panel.t_s
    draw_envelope(voltage, broken(t_s, panel.applied_v), 1.0, BLACK, width=0.7)
    draw_envelope(displacement, broken(t_s, panel.sensor_um), 1.0, GREY, SENSOR, 2.2)
    draw_envelope(displacement, broken(t_s, panel.model_um), 1.0, VERMILION, MODEL, dash=DASHED)
    draw_envelope(error, broken(t_s, panel.model_um - panel.sensor_um), 1.0, VERMILION, width=0.6)
    error.axhline(0.0, color=BLACK, linewidth=0.4)
    for mark in panel.marks:
        _mark(error, mark)
    error.margins(y=0.12)
    error.set_xlabel("time (s)")
    for axes in column:
        axes.set_xlim(-0.03 * t_s[-1], 1.03 * t_s[-1])
        axes.locator_params(axis="x", nbins=4)
    for axes in (voltage, displacement):
        axes.tick_params(labelbottom=False)


def _mark(axes: Axes, mark: Mark) -> None:
    shown = axes.get_legend_handles_labels()[1]
    low_um, high_um = mark.paper_um
    if math.isfinite(low_um):
        axes.errorbar(
            [mark.at_s], [0.5 * (low_um + high_um)], yerr=[0.5 * abs(high_um - low_um)], fmt="_", color=BLUE,
            markersize=6.0, elinewidth=1.6, capsize=2.5, label="_" if "paper" in shown else "paper", zorder=4.0,
        )  # fmt: skip
    axes.plot(
        [mark.at_s], [mark.ours_um], "o", color=BLACK, markersize=2.6, label="_" if "ours" in shown else "ours",
        zorder=5.0,
    )  # fmt: skip


def _draw_loop(axes: Axes, panel: Panel) -> None:
    every = max(1, len(panel.t_s) // (4 * POINTS))
    part = slice(None, None, every)
    u_v = panel.applied_v[part]
    axes.plot(u_v, panel.sensor_um[part], color=GREY, linewidth=1.6)
    axes.plot(u_v, panel.model_um[part], color=VERMILION, linewidth=0.8, linestyle=DASHED)
    axes.set_xlabel("voltage (V)")
    axes.locator_params(axis="x", nbins=4)
