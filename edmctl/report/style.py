"""How every figure looks, and how it becomes a file: one place for sizes, colours, fonts and line widths.

Colours are those of Okabe & Ito, which the colour-blind can tell apart; lines differ in dash or width too.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmctl.errors import PreconditionError, UsageError, installing
from edmctl.report.signals import Envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Dash: TypeAlias = "str | tuple[float, tuple[float, ...]]"
SUFFIXES = (".png", ".svg", ".pdf")
COLUMN_MM, PAGE_MM = 85.0, 180.0
"""Widths of one column and of both, as journals print them."""
PNG_DPI = 300
LINE = 0.8
"""Width of a line that carries data, in points."""
DASHED: Dash = (0, (4, 1.5))

STRIP_MM = 3.0
"""Height of the words below a figure."""

BLACK, GREY, LIGHT = "#000000", "#999999", "#E5E5E5"
FAINT = "#6B6B6B"
BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW = "#56B4E9", "#CC79A7", "#F0E442"

OPEN, NORMAL, ARC, SHORT = GREY, BLUE, ORANGE, VERMILION
"""Colours of the pulse classes in every figure."""
DEVIATIONS = "PuOr"
"""Diverging colours for what is too deep or not deep enough, told apart by the colour-blind."""
PULSE_COLOURS = {"open": OPEN, "normal": NORMAL, "arc": ARC, "short": SHORT}
PULSE_HATCHES = {"open": "/////", "normal": "", "arc": "....", "short": "xxxxx"}
"""Patterns of areas, which tell the classes apart where there is no colour."""
PULSE_DASHES: dict[str, Dash] = {"arc": "-", "short": (0, (3.0, 1.2))}

READING_MARKS = {"Z1": ("^", GREEN), "Z2": ("v", VERMILION), "Z3": ("s", PURPLE), "Zr": ("D", ORANGE)}
"""How readings are marked, by their kind."""

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
    "grid.color": LIGHT,
    "grid.linewidth": 0.4,
    "axes.axisbelow": True,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": LINE,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "hatch.linewidth": 0.4,
    "path.simplify": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "edmctl",
    "pdf.fonttype": 42,
}

_UNDATED: dict[str, dict[str, None]] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Dates would make every file another one."""


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in the house's style; a figure must be made and rendered within."""
    from matplotlib import rc_context

    with rc_context(_SETTINGS):  # type: ignore[arg-type]
        yield


def new_figure(height_mm: float, width_mm: float = COLUMN_MM) -> Figure:
    """Return an empty figure whose panels are laid out without overlap."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03, hspace=0.02, wspace=0.02)
    return Figure(figsize=(width_mm / 25.4, height_mm / 25.4), layout=layout)


def mark_below(figure: Figure, words: str) -> None:
    """Write small grey words into a strip of their own below a figure that is drawn already."""
    width_mm, height_mm = (25.4 * float(inches) for inches in figure.get_size_inches())
    whole_mm = height_mm + STRIP_MM
    figure.set_size_inches(width_mm / 25.4, whole_mm / 25.4)
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.set(rect=(0.0, STRIP_MM / whole_mm, 1.0, height_mm / whole_mm))  # type: ignore[call-arg]
    figure.text(
        1.0 - 0.8 / width_mm, 0.6 / whole_mm, words, ha="right", va="bottom", fontsize=5.5, color=FAINT
    )  # fmt: skip


def rendered(figure: Figure, suffix: str) -> bytes:
    """Return the figure as a file of one of SUFFIXES would hold it."""
    file = BytesIO()
    figure.savefig(file, format=suffix[1:], dpi=PNG_DPI, metadata=_UNDATED.get(suffix, {}))
    return file.getvalue()


def suffix_of(name: str) -> str:
    """Return the ending of a file name, in small letters; empty without one."""
    return name[name.rfind(".") :].lower() if "." in name else ""


def check_figure(name: str) -> None:
    """Check that a figure can be drawn into a file called `name`, before anything is computed for it.

    Raises UsageError (E2011) for a type of file that is not offered, PreconditionError (E8090) without matplotlib.
    """
    if suffix_of(name) not in SUFFIXES:
        raise UsageError(
            f"A figure cannot be written into {name!r}: its name ends in none of {', '.join(SUFFIXES)}.",
            hint="Take .pdf or .svg for print and .png for the screen.",
            code="E2011",
        )
    need_matplotlib()


def need_matplotlib() -> None:
    """Raise PreconditionError (E8090) where matplotlib is not installed."""
    if importlib.util.find_spec("matplotlib") is None:
        raise PreconditionError(
            "Figures need matplotlib, which is not installed.",
            hint=f"Install it: {installing('matplotlib')}.",
            code="E8090",
        )


def draw_envelope(
    axes: Axes,
    line: Envelope,
    per_s: float,
    colour: str,
    label: str = "_",
    width: float = LINE,
    *,
    begin_s: float = 0.0,
    dash: Dash = "-",
) -> None:
    """Draw a signal as one line through its lowest and highest values, in units of `per_s` from `begin_s` on."""
    time, values = (line.time_s - begin_s) / per_s, line.low
    if not line.sampled:
        time, values = np.repeat(time, 2), np.column_stack([line.low, line.high]).ravel()
    axes.plot(time, values, color=colour, linewidth=width, linestyle=dash, label=label)


def draw_points(
    axes: Axes,
    at: ArrayLike,
    values: ArrayLike,
    u95: ArrayLike | None,
    colour: str,
    *,
    full: bool = True,
    bars: str = "",
    marker: str = "o",
    size: float = 3.5,
    label: str = "_",
) -> None:
    """Draw results with bars of 95 %; marks are open where a value was not touched with a sensor.

    bars : another colour for the bars and the rim of full marks
    """
    axes.errorbar(
        at, values, yerr=u95, fmt=marker, markersize=size, color=bars or colour,
        markerfacecolor=colour if full else "white", markeredgecolor=(bars or colour) if full else colour,
        markeredgewidth=0.4 if full and bars else 0.7, elinewidth=0.7, capsize=1.8, capthick=0.7,
        label=label, zorder=4.0,
    )  # fmt: skip


def mark_readings(axes: Axes, touches: NDArray[np.void], column: str, unit_s: float) -> None:
    """Mark the accepted rows of `/entry/touches` at their time and the value of a column."""
    for kind, (marker, colour) in READING_MARKS.items():
        chosen = touches[(touches["kind"] == kind.encode()) & (touches["accepted"] == 1)]
        if len(chosen):
            axes.plot(
                chosen["time"] / unit_s, chosen[column], marker, color=colour, markersize=3.2,
                markeredgecolor="white", markeredgewidth=0.3, clip_on=False, zorder=3.0, label=kind,
            )  # fmt: skip


def plain_log_ticks(axis: Axis) -> None:
    """Label a logarithmic axis of one or two decades with 1, 2, 3, 5 and their multiples by ten, without powers."""
    from matplotlib.ticker import LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


class NothingToDraw(Exception):
    """The run holds nothing for this figure. The message is a sentence that says why, and what would change it."""


def time_unit(span_s: float) -> tuple[float, str]:
    """Return seconds per unit and the label of an axis of time that spans so much: in s, min or h."""
    if span_s < 0.5:
        return 1e-3, "time (ms)"
    if span_s <= 300.0:
        return 1.0, "time (s)"
    return (60.0, "time (min)") if span_s <= 3.0 * 3600.0 else (3600.0, "time (h)")


def letter_panels(panels: Iterable[Axes]) -> None:
    """Put (a), (b), … above the left end of every panel."""
    for axes, letter in zip(panels, "abcdefghijklmnopqrstuvwxyz", strict=False):
        axes.set_title(f"({letter})", loc="left", pad=2.0)


def legend_above(axes: Axes, ncols: int = 6) -> None:
    """Put the legend of a panel above its right end, beside the panel's letter."""
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=ncols, handlelength=1.4, columnspacing=0.9,
        handletextpad=0.4, borderaxespad=0.0, borderpad=0.2,
    )  # fmt: skip


def shared_legend(figure: Figure, panels: Iterable[Axes], ncols: int = 2) -> None:
    """Put one legend of all panels above the figure."""
    handles, names = [], []
    for axes in panels:
        drawn = axes.get_legend_handles_labels()
        handles += drawn[0]
        names += drawn[1]
    figure.legend(
        handles, names, loc="outside upper center", ncols=ncols, handlelength=1.8, columnspacing=1.0
    )
