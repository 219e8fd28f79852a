"""Displacement of the actuator by truth and by models, and their errors, like Figs 3–5 of Muralidhara et al. 2009.

One column of panels for each waveform: voltage, displacement, error of both models, error of the better one
magnified. Colours are those of Okabe & Ito, which the colour-blind can tell apart, and lines differ in dash too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.style import (
    BLACK,
    BLUE,
    COLUMN_MM,
    GREY,
    PAGE_MM,
    VERMILLION,
    house_style,
    rendered,
    suffix_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

HEIGHT_MM = 130.0
POINTS = 1500
"""Intervals of time that a line is drawn in; in each its lowest and its highest value are shown."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One waveform; ndarrays of shape (n,): time, voltage, and displacement by truth, paper and our model."""

    title: str
    t_s: Array
    applied_v: Array
    truth_um: Array
    paper_um: Array
    ours_um: Array


def draw(trials: Sequence[Trial], name: str) -> bytes:
    """Return the figure of one waveform (85 mm wide) or several (180 mm) as the file `name` would hold it."""
    with house_style():
        return rendered(_figure(trials), suffix_of(name))


def _figure(trials: Sequence[Trial]) -> Figure:
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    width_mm = COLUMN_MM if len(trials) == 1 else PAGE_MM
    layout = ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.02, hspace=0.02, wspace=0.02)
    figure = Figure(figsize=(width_mm / 25.4, HEIGHT_MM / 25.4), layout=layout)
    grid = figure.subplots(
        4, len(trials), sharex="col", sharey="row", squeeze=False, height_ratios=[0.7, 1.6, 1.1, 1.0]
    )
    for column, trial in enumerate(trials):
        _draw_column(grid[:, column], trial)
        if len(trials) > 1:
            grid[0, column].set_title(trial.title, pad=2.0)
    _label(grid[:, 0])
    for axes, letter in zip(grid[:, 0], "abcd", strict=True):
        axes.set_title(f"({letter})", loc="left", pad=2.0)
    handles = [line for line in grid[1, 0].get_lines() if not line.get_label().startswith("_")]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), handlelength=2.6)
    figure.align_ylabels(grid[:, 0])
    return figure


def _draw_column(panels: NDArray[np.object_], trial: Trial) -> None:
    voltage, displacement, error, own_error = panels
    t_s = trial.t_s
    _line(voltage, t_s, trial.applied_v, BLACK, "-", 0.7)
    _line(displacement, t_s, trial.truth_um, GREY, "-", 2.4, "truth")
    _line(displacement, t_s, trial.paper_um, VERMILLION, (0, (4, 1.5)), 0.8, "Maxwell, no creep")
    _line(displacement, t_s, trial.ours_um, BLUE, "-", 0.8, "edmctl")
    _line(error, t_s, trial.paper_um - trial.truth_um, VERMILLION, (0, (4, 1.5)), 0.8)
    for axes in (error, own_error):
        _line(axes, t_s, trial.ours_um - trial.truth_um, BLUE, "-", 0.8)
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


def _line(
    axes: Axes, t_s: Array, values: Array, colour: str, dash: object, width: float, label: str = "_"
) -> None:
    t_s, values = extremes(t_s, values)
    axes.plot(t_s, values, color=colour, linestyle=dash, linewidth=width, label=label)


def extremes(t_s: Array, values: Array) -> tuple[Array, Array]:
    """Keep what can be seen: the lowest and the highest sample of each of POINTS intervals, in their order.

    t_s, values : ndarray, shape (n,). Returned are at most 2 POINTS + 2 of the samples.
    """
    n = values.size
    if n <= 2 * POINTS:
        return t_s, values
    length = -(-n // POINTS)
    padded = np.concatenate([values, np.full(-n % length, values[-1])]).reshape(-1, length)
    starts = np.arange(padded.shape[0]) * length
    kept = np.concatenate([[0, n - 1], starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)])
    kept = np.unique(np.minimum(kept, n - 1))
    return t_s[kept], values[kept]
