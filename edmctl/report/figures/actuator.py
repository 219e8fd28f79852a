"""Displacement of the actuator by truth and by models, and their errors, like Figs 3–5 of Muralidhara et al. 2009.

One column of panels for each waveform: voltage, displacement, error of both models, error of the better one
magnified. Colours are those of Okabe & Ito, which the colour-blind can tell apart, and lines differ in dash too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass
from edmctl.report.signals import broken
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
    import numpy as np
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from edmctl.array_types import Array

HEIGHT_MM = 130.0


@dataclass(frozen=True, slots=True)
class Trial:
    """One waveform; ndarrays of shape (n,): time, voltage, and displacement by truth, paper and our model."""

    title: str
    t_s: Array
    applied_v: Array
    truth_um: Array
    paper_um: Array
    ours_um: Array


def draw(trials: Sequence[Trial], name: str, words: str = "") -> bytes:
    """Return the figure of one waveform (85 mm wide) or several (180 mm) as the file `name` would hold it.

    words : what stands small below it
    """
    with house_style():
        figure = _figure(trials)
        if words:
            mark_below(figure, words)
        return rendered(figure, suffix_of(name))


def _figure(trials: Sequence[Trial]) -> Figure:
    figure = new_figure(HEIGHT_MM, COLUMN_MM if len(trials) == 1 else PAGE_MM)
    grid = figure.subplots(
        4, len(trials), sharex="col", sharey="row", squeeze=False, height_ratios=[0.7, 1.6, 1.1, 1.0]
    )
    for column, trial in enumerate(trials):
        _draw_column(grid[:, column], trial)
        if len(trials) > 1:
            grid[0, column].set_title(trial.title, pad=2.0)
    _label(grid[:, 0])
    letter_panels(grid[:, 0])
    handles = [line for line in grid[1, 0].get_lines() if not line.get_label().startswith("_")]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), handlelength=2.6)
    figure.align_ylabels(grid[:, 0])
    return figure


def _draw_column(panels: NDArray[np.object_], trial: Trial) -> None:
    voltage, displacement, error, own_error = panels
    t_s = trial.t_s
    draw_envelope(voltage, broken(t_s, trial.applied_v), 1.0, BLACK, width=0.7)
    draw_envelope(displacement, broken(t_s, trial.truth_um), 1.0, GREY, "truth", 2.4)
    draw_envelope(displacement, broken(t_s, trial.paper_um), 1.0, VERMILION, "Maxwell, no creep", dash=DASHED)
    draw_envelope(displacement, broken(t_s, trial.ours_um), 1.0, BLUE, "edmctl")
    draw_envelope(error, broken(t_s, trial.paper_um - trial.truth_um), 1.0, VERMILION, dash=DASHED)
    for axes in (error, own_error):
        draw_envelope(axes, broken(t_s, trial.ours_um - trial.truth_um), 1.0, BLUE)
        axes.axhline(0.0, color=BLACK, linewidth=0.4)
        axes.margins(y=0.12)
    own_error.set_xlabel("time (s)")
    own_error.set_xlim(-0.015 * t_s[-1], 1.015 * t_s[-1])  # what begins at once shall not hide in the axis
    own_error.locator_params(axis="x", nbins=4)
    own_error.locator_params(axis="y", nbins=5)


def _label(panels: NDArray[np.object_]) -> None:
    voltage, displacement, error, own_error = panels
    voltage.set_ylabel("voltage (V)")
    displacement.set_ylabel("displacement (µm)")
    error.set_ylabel("error (µm)")
    own_error.set_ylabel("edmctl error (µm)")
