"""Displacement of the actuator by truth and by models, and their errors, like Figs 3–5 of Muralidhara et al. 2009.

One column of panels for each waveform: voltage, displacement, error of both models, error of the better one
magnified. Colours are those of Okabe & Ito, which the colour-blind can tell apart, and lines differ in dash too.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from edmctl.errors import PreconditionError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SUFFIXES = (".png", ".svg", ".pdf")
COLUMN_MM, PAGE_MM, HEIGHT_MM = 85.0, 180.0, 130.0
PNG_DPI = 300
POINTS = 1500
"""Intervals of time that a line is drawn in; in each its lowest and its highest value are shown."""

GREY, VERMILLION, BLUE, BLACK = "#999999", "#D55E00", "#0072B2", "#000000"

_SETTINGS = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 7.0,
    "axes.labelsize": 7.0,
    "axes.titlesize": 7.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E5E5E5",
    "grid.linewidth": 0.4,
    "axes.axisbelow": True,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "path.simplify": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "edmctl",
    "pdf.fonttype": 42,
}


@dataclass(frozen=True, slots=True)
class Trial:
    """One waveform; ndarrays of shape (n,): time, voltage, and displacement by truth, paper and our model."""

    title: str
    t_s: Array
    applied_v: Array
    truth_um: Array
    paper_um: Array
    ours_um: Array


def check_figure(name: str) -> None:
    """Check that a figure can be drawn into a file called `name`, before anything is computed for it.

    Raises UsageError (E2011) for a type of file that is not offered, PreconditionError (E8090) without matplotlib.
    """
    if _suffix(name) not in SUFFIXES:
        raise UsageError(
            f"A figure cannot be written into {name!r}: its name ends in none of {', '.join(SUFFIXES)}.",
            hint="Take .pdf or .svg for print and .png for the screen.",
            code="E2011",
        )
    if importlib.util.find_spec("matplotlib") is None:
        raise PreconditionError(
            "Figures need matplotlib, which is not installed.",
            hint="Install it with `pip install 'edmctl[plot]'`.",
            code="E8090",
        )


def draw(trials: Sequence[Trial], name: str) -> bytes:
    """Return the figure of one waveform (85 mm wide) or several (180 mm) as the file `name` would hold it."""
    from matplotlib import rc_context

    with rc_context(_SETTINGS):  # type: ignore[arg-type]
        figure = _figure(trials)
        return _rendered(figure, _suffix(name))


def _suffix(name: str) -> str:
    return name[name.rfind(".") :].lower() if "." in name else ""


def _rendered(figure: Figure, suffix: str) -> bytes:
    # Dates would make every file another one.
    undated: dict[str, dict[str, None]] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": {}}
    file = BytesIO()
    figure.savefig(file, format=suffix[1:], dpi=PNG_DPI, metadata=undated[suffix])
    return file.getvalue()


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
