"""Displacement of the actuator beside that of models, and their errors, like Figs 3–5 of Muralidhara et al. 2009.

One column of panels for each waveform.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.report import panels, style
from edmctl.report.kinds import suffix_of
from edmctl.report.signals import POINTS, broken
from edmctl.report.style import BLACK, BLUE, COLUMN_MM, DASHED, GREY, PAGE_MM, VERMILION

STEP_V = 0.5
"""From one sample to the next; a larger change is a step."""
GAP_MM = 4.0


@dataclass(frozen=True, slots=True)
class Trial:
    """One waveform; ndarrays of shape (n,): time, voltage, and displacement by truth, paper and our model."""

    title: str
    t_s: Array
    applied_v: Array
    truth_um: Array
    paper_um: Array
    ours_um: Array


@dataclass(frozen=True, slots=True)
class Mark:
    """A reading: when, ours, and the paper's range (NaN if it gives none), µm, with their signs."""

    at_s: float
    ours_um: float
    paper_um: tuple[float, float]


@dataclass(frozen=True, slots=True)
class PaperTrial:
    """One waveform; ndarrays of shape (n,): time, voltage, displacement by sensor and model; readings."""

    title: str
    t_s: Array
    applied_v: Array
    sensor_um: Array
    model_um: Array
    marks: Sequence[Mark]

    @property
    def is_smooth(self) -> bool:
        """Whether no step crosses its displacement over voltage."""
        return bool(np.abs(np.diff(self.applied_v)).max() < STEP_V)


def draw(trials: Sequence[Trial], name: str, words: str = "") -> bytes:
    """Return the figure of one waveform (85 mm wide) or several (180 mm) as the file `name` contains it.

    words : small words below it
    """
    with style.house_style():
        return _file(_figure(trials), name, words)


def draw_paper(trials: Sequence[PaperTrial], name: str, words: str = "") -> bytes:
    """Return the figure of the paper's model beside the sensor, as `draw` does.

    Bars in the error show the readings of the paper, dots those of the model. Displacement over voltage is drawn
    where no step crosses it.
    """
    with style.house_style():
        return _file(_paper_figure(trials), name, words)


def _file(figure: Figure, name: str, words: str) -> bytes:
    if words:
        panels.mark_below(figure, words)
    return style.rendered(figure, suffix_of(name))


def _columns(
    titles: Sequence[str], y: Mapping[str, float], loop: Mapping[str, float] | None = None
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with a column for each title, and its panels column by column, with titles above."""
    count = len(titles)
    widths = (1.0,) * count
    more_mm = 3.0 * max(title.count("\n") for title in titles)
    blocks = [panels.Block("time (s)", y, widths, share_y=True, above_mm=more_mm)]
    if loop:
        blocks.append(panels.Block("voltage (V)", loop, widths, share_y=True))
    figure, axes = panels.panels(*blocks, width_mm=COLUMN_MM if count == 1 else PAGE_MM, gap_mm=GAP_MM)
    for one, title in zip(axes, titles, strict=False):
        one.set_title(title, pad=2.0)
    return figure, [axes[column::count] for column in range(count)]


def _limit(axes: Axes, t_s: Array) -> None:
    """Leave room at both ends of the time, so that what begins at once is not hidden by the axis."""
    axes.set_xlim(-0.02 * t_s[-1], 1.02 * t_s[-1])
    axes.locator_params(axis="x", nbins=4)


def _figure(trials: Sequence[Trial]) -> Figure:
    figure, columns = _columns(
        [trial.title for trial in trials],
        {"voltage (V)": 0.65, "displacement (µm)": 1.4, "error (µm)": 1.0, "edmctl error (µm)": 0.9},
    )
    for trial, (voltage, displacement, error, own_error) in zip(trials, columns, strict=True):
        t_s = trial.t_s
        panels.draw_envelope(voltage, broken(t_s, trial.applied_v), 1.0, BLACK, width=0.7)
        panels.draw_envelope(displacement, broken(t_s, trial.truth_um), 1.0, GREY, "truth", 2.4)
        for values_um, colour, label, dash in (
            (trial.paper_um, VERMILION, "Maxwell, no creep", DASHED),
            (trial.ours_um, BLUE, "edmctl", "-"),
        ):
            panels.draw_envelope(displacement, broken(t_s, values_um), 1.0, colour, label, dash=dash)
            panels.draw_envelope(error, broken(t_s, values_um - trial.truth_um), 1.0, colour, dash=dash)
        panels.draw_envelope(own_error, broken(t_s, trial.ours_um - trial.truth_um), 1.0, BLUE)
        for axes in (error, own_error):
            axes.axhline(0.0, color=BLACK, linewidth=0.4)
            axes.margins(y=0.12)
        own_error.locator_params(axis="y", nbins=5)
        _limit(own_error, t_s)
    panels.shared_legend(figure, [columns[0][1]], ncols=3)
    return figure


def _paper_figure(trials: Sequence[PaperTrial]) -> Figure:
    loop = {"displacement (µm)": 1.6} if any(trial.is_smooth for trial in trials) else {}
    titles = [trial.title if len(trials) == 1 else trial.title.replace(", ", "\n") for trial in trials]
    figure, columns = _columns(
        titles, {"voltage (V)": 0.7, "displacement (µm)": 1.4, "model − sensor (µm)": 1.25}, loop
    )
    for trial, (voltage, displacement, error, *below) in zip(trials, columns, strict=True):
        t_s = trial.t_s
        panels.draw_envelope(voltage, broken(t_s, trial.applied_v), 1.0, BLACK, width=0.7)
        panels.draw_envelope(displacement, broken(t_s, trial.sensor_um), 1.0, GREY, "sensor", 2.2)
        panels.draw_envelope(
            displacement, broken(t_s, trial.model_um), 1.0, VERMILION, "model of the paper", dash=DASHED
        )
        panels.draw_envelope(error, broken(t_s, trial.model_um - trial.sensor_um), 1.0, VERMILION, width=0.6)
        error.axhline(0.0, color=BLACK, linewidth=0.4)
        for mark in trial.marks:
            _draw_mark(error, mark)
        error.margins(y=0.12)
        _limit(error, t_s)
        for axes in below:
            if trial.is_smooth:
                _draw_loop(axes, trial)
            else:
                axes.set_axis_off()
    panels.shared_legend(figure, [columns[0][1], *(column[2] for column in columns)], ncols=4)
    return figure


def _draw_mark(axes: Axes, mark: Mark) -> None:
    low_um, high_um = mark.paper_um
    if math.isfinite(low_um):
        axes.errorbar(
            [mark.at_s], [0.5 * (low_um + high_um)], yerr=[0.5 * abs(high_um - low_um)], fmt="_", color=BLUE,
            markersize=6.0, elinewidth=1.6, capsize=2.5, label="paper", zorder=4.0,
        )  # fmt: skip
    axes.plot([mark.at_s], [mark.ours_um], "o", color=BLACK, markersize=2.6, label="ours", zorder=5.0)


def _draw_loop(axes: Axes, trial: PaperTrial) -> None:
    part = slice(None, None, max(1, len(trial.t_s) // (4 * POINTS)))
    axes.plot(trial.applied_v[part], trial.sensor_um[part], color=GREY, linewidth=1.6)
    axes.plot(trial.applied_v[part], trial.model_um[part], color=VERMILION, linestyle=DASHED)
    axes.locator_params(axis="x", nbins=4)
