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
from edmctl.report.panels import Block, draw_envelope
from edmctl.report.signals import POINTS, broken
from edmctl.report.style import BLACK, BLUE, DASHED, GREY, VERMILION

STEP_V = 0.5
"""From one sample to the next; a larger change is a step."""
GAP_MM = 4.0
OWN = "edmctl"


@dataclass(frozen=True, slots=True)
class Mark:
    """A reading: when, ours, and the paper's range (NaN if it gives none), µm, with their signs."""

    at_s: float
    ours_um: float
    paper_um: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Trial:
    """One waveform: ndarrays of shape (n,), displacements of the actuator and of models by their names; readings."""

    title: str
    t_s: Array
    applied_v: Array
    actuator_um: Array
    models_um: Mapping[str, Array]
    marks: Sequence[Mark] = ()

    @property
    def is_smooth(self) -> bool:
        return bool(np.abs(np.diff(self.applied_v)).max() < STEP_V)


def draw(trials: Sequence[Trial], name: str, note: str = "") -> bytes:
    """Return the figure of one waveform (85 mm wide) or several (180 mm), with a note below it, as file `name`."""
    y = {"voltage (V)": 0.65, "displacement (µm)": 1.4, "error (µm)": 1.0, "edmctl error (µm)": 0.9}
    with style.house_style():
        figure, columns = _columns([trial.title for trial in trials], y)
        for trial, axes in zip(trials, columns, strict=True):
            _draw_models(trial, axes, "truth")
            own_error_um = trial.models_um[OWN] - trial.actuator_um
            draw_envelope(axes[3], broken(trial.t_s, own_error_um), 1.0, BLUE)
            _about_zero(axes[3])
            axes[3].locator_params(axis="y", nbins=5)
        panels.shared_legend(figure, [columns[0][1]], ncols=3)
        return _file(figure, name, note)


def draw_paper(trials: Sequence[Trial], name: str, note: str = "") -> bytes:
    """Return the figure of the paper's model beside the sensor, as `draw` does.

    Bars in the error show the readings of the paper, dots those of the model. Displacement over voltage is drawn
    where no step crosses it.
    """
    y = {"voltage (V)": 0.7, "displacement (µm)": 1.4, "model − sensor (µm)": 1.25}
    loop = {"displacement (µm)": 1.6} if any(trial.is_smooth for trial in trials) else {}
    titles = [trial.title if len(trials) == 1 else trial.title.replace(", ", "\n") for trial in trials]
    with style.house_style():
        figure, columns = _columns(titles, y, loop)
        for trial, axes in zip(trials, columns, strict=True):
            _draw_models(trial, axes, "sensor")
            for mark in trial.marks:
                _draw_mark(axes[2], mark)
            if loop and trial.is_smooth:
                _draw_loop(axes[3], trial)
            elif loop:
                axes[3].set_axis_off()
        panels.shared_legend(figure, [columns[0][1], *(column[2] for column in columns)], ncols=4)
        return _file(figure, name, note)


def _file(figure: Figure, name: str, note: str) -> bytes:
    if note:
        panels.mark_below(figure, note)
    return style.rendered(figure, suffix_of(name))


def _columns(
    titles: Sequence[str], y: Mapping[str, float], loop: Mapping[str, float] | None = None
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with a column for each title, and its panels column by column, with titles above."""
    count = len(titles)
    widths = (1.0,) * count
    more_mm = 3.0 * max(title.count("\n") for title in titles)
    blocks = [Block("time (s)", y, widths, share_y=True, above_mm=more_mm)]
    if loop:
        blocks.append(Block("voltage (V)", loop, widths, share_y=True))
    width_mm = style.COLUMN_MM if count == 1 else style.PAGE_MM
    figure, axes = panels.panels(*blocks, width_mm=width_mm, gap_mm=GAP_MM)
    for one, title in zip(axes, titles, strict=False):
        one.set_title(title, pad=2.0)
    return figure, [axes[column::count] for column in range(count)]


def _draw_models(trial: Trial, axes: Sequence[Axes], name: str) -> None:
    """Draw voltage, displacements and errors; `name` is that of the actuator's displacement."""
    (voltage, displacement, error), t_s = axes[:3], trial.t_s
    draw_envelope(voltage, broken(t_s, trial.applied_v), 1.0, BLACK, width=0.7)
    draw_envelope(displacement, broken(t_s, trial.actuator_um), 1.0, GREY, name, 2.4)
    for model, values_um in trial.models_um.items():
        colour, dash = (BLUE, "-") if model == OWN else (VERMILION, DASHED)
        draw_envelope(displacement, broken(t_s, values_um), 1.0, colour, model, dash=dash)
        draw_envelope(error, broken(t_s, values_um - trial.actuator_um), 1.0, colour, dash=dash)
    _about_zero(error)
    # Room at both ends, so that what begins at once is not hidden by the axis.
    error.set_xlim(-0.02 * t_s[-1], 1.02 * t_s[-1])
    error.locator_params(axis="x", nbins=4)


def _about_zero(axes: Axes) -> None:
    axes.axhline(0.0, color=BLACK, linewidth=0.4)
    axes.margins(y=0.12)


def _draw_mark(axes: Axes, mark: Mark) -> None:
    low_um, high_um = mark.paper_um
    if math.isfinite(low_um):
        axes.errorbar(
            [mark.at_s], [0.5 * (low_um + high_um)], yerr=[0.5 * abs(high_um - low_um)], fmt="_", color=BLUE,
            markersize=6.0, elinewidth=1.6, capsize=2.5, label="paper", zorder=4.0,
        )  # fmt: skip
    axes.plot([mark.at_s], [mark.ours_um], "o", color=BLACK, markersize=2.6, label="ours", zorder=5.0)


def _draw_loop(axes: Axes, trial: Trial) -> None:
    part = slice(None, None, max(1, len(trial.t_s) // (4 * POINTS)))
    axes.plot(trial.applied_v[part], trial.actuator_um[part], color=GREY, linewidth=1.6)
    for values_um in trial.models_um.values():
        axes.plot(trial.applied_v[part], values_um[part], color=VERMILION, linestyle=DASHED)
    axes.locator_params(axis="x", nbins=4)
