"""How figures look: widths, colours, fonts; panels at common margins with letters and legends; marks; files.

Colours are those of Okabe & Ito, which the colour-blind can tell apart; lines differ in dash or width too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from string import ascii_lowercase
from typing import TypeAlias

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

from edmctl.dataclasses import dataclass
from edmctl.report.signals import Envelope

Dash: TypeAlias = "str | tuple[float, tuple[float, ...]]"
COLUMN_MM, PAGE_MM = 85.0, 180.0
"""Widths of one column and of both, as journals print them."""
PNG_DPI = 300
LINE = 0.8
"""Width of a line that carries data, in points."""
DASHED: Dash = (0, (4, 1.5))

BLACK, GREY, LIGHT = "#000000", "#999999", "#E5E5E5"
FAINT = "#6B6B6B"
BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW = "#56B4E9", "#CC79A7", "#F0E442"
TOLERANCE = "#E8F1F7"

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

PANEL_MM = 26.0
"""Height of a panel of share 1."""
LEFT_MM, RIGHT_MM, BELOW_MM, TITLE_MM = 17.0, 2.5, 9.6, 4.2
"""Margins of panels: for ticks and label of y, on the right, for ticks and label of x, and for a title."""
LABEL_MM = 10.3
"""From an axis of y to its label."""
LEGEND_MM, LEGEND_LINE_MM = 1.6, 3.4
STRIP_MM = 3.0
"""Height of the small words below a figure."""


@dataclass(frozen=True, slots=True)
class Block:
    """Panels above each other that share their axes of x, in one or several columns.

    x : label of the axis; y : labels and heights, as shares of PANEL_MM, from the top
    columns : widths as shares; share_y : whether columns share the axes of y
    above_mm : additional room above the block
    """

    x: str
    y: Mapping[str, float]
    columns: Sequence[float] = (1.0,)
    share_y: bool = False
    above_mm: float = 0.0

    @property
    def height_mm(self) -> float:
        """Height with titles, ticks and labels."""
        return self.above_mm + sum(TITLE_MM + PANEL_MM * share for share in self.y.values()) + BELOW_MM


def panels(
    *blocks: Block,
    width_mm: float = COLUMN_MM,
    left_mm: float = LEFT_MM,
    right_mm: float = RIGHT_MM,
    gap_mm: float = LEFT_MM,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels at the common margins, and the panels row by row.

    The figure is as high as its panels need. Several panels get the letters (a), (b), …; of panels that share their
    axes of y the first of each row. `gap_mm` is the distance of columns.
    """
    height_mm = sum(block.height_mm for block in blocks)
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4))
    inner_mm = width_mm - left_mm - right_mm
    top_mm, lettered = height_mm, list[Axes]()
    for block in blocks:
        low_mm = top_mm - block.height_mm
        column_mm = (inner_mm + gap_mm) / len(block.columns) - gap_mm
        grid = figure.add_gridspec(
            len(block.y),
            len(block.columns),
            left=left_mm / width_mm,
            right=1.0 - right_mm / width_mm,
            bottom=(low_mm + BELOW_MM) / height_mm,
            top=(top_mm - block.above_mm - TITLE_MM) / height_mm,
            height_ratios=list(block.y.values()),
            width_ratios=list(block.columns),
            hspace=TITLE_MM * len(block.y) / (PANEL_MM * sum(block.y.values())),
            wspace=gap_mm / column_mm,
        )
        rows = grid.subplots(sharex="col", sharey="row" if block.share_y else False, squeeze=False)
        for label, row in zip(block.y, rows, strict=True):
            row[0].set_ylabel(label)
            lettered.extend(row[:1] if block.share_y else row)
            for axes, share in zip(row, block.columns, strict=True):
                wide_mm = column_mm * len(block.columns) * share / sum(block.columns)
                axes.yaxis.set_label_coords(-LABEL_MM / wide_mm, 0.5)
        for axes in rows[-1]:
            axes.set_xlabel(block.x)
        top_mm = low_mm
    if len(lettered) > 1:
        letter_panels(lettered)
    return figure, list(figure.axes)


def grow(figure: Figure, above_mm: float = 0.0, below_mm: float = 0.0) -> None:
    """Add room above and below; panels and words keep their sizes and their distances."""
    width, height = figure.get_size_inches()
    whole = height + (above_mm + below_mm) / 25.4
    figure.set_size_inches(width, whole)
    for axes in figure.axes:
        left, low, wide, tall = axes.get_position(original=True).bounds
        axes.set_position((left, (low * height + below_mm / 25.4) / whole, wide, tall * height / whole))


def new_figure(height_mm: float, width_mm: float = COLUMN_MM) -> Figure:
    """Return an empty figure for labels of any length: its margins follow from its texts."""
    layout = ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03, hspace=0.02, wspace=0.02)
    return Figure(figsize=(width_mm / 25.4, height_mm / 25.4), layout=layout)


def mark_below(figure: Figure, words: str) -> None:
    """Write small grey words into a strip of their own below the panels of a figure."""
    grow(figure, below_mm=STRIP_MM)
    width, height = figure.get_size_inches() * 25.4
    at = (1.0 - 0.8 / width, 0.6 / height)
    figure.text(*at, words, ha="right", va="bottom", fontsize=5.5, color=FAINT)


def letter_panels(axes: Iterable[Axes]) -> None:
    """Put (a), (b), … above the left end of every panel."""
    for one, letter in zip(axes, ascii_lowercase, strict=False):
        one.set_title(f"({letter})", loc="left", pad=2.0)


def note_above(axes: Axes, words: str) -> None:
    """Write words above the right end of a panel, beside its letter."""
    axes.set_title(words, loc="right", pad=2.0)


def legend_above(axes: Axes, ncols: int = 6) -> None:
    """Put the legend of a panel above its right end, beside its letter."""
    named = _named([axes])
    axes.legend(
        named.values(), named, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=ncols, handlelength=1.4,
        columnspacing=0.9, handletextpad=0.4, borderaxespad=0.0, borderpad=0.2,
    )  # fmt: skip


def shared_legend(figure: Figure, axes: Iterable[Axes], ncols: int = 2) -> None:
    """Put one legend of several panels above the figure."""
    named = _named(axes)
    form = {"ncols": ncols, "handlelength": 1.8, "columnspacing": 1.0}
    if figure.get_layout_engine() is not None:
        figure.legend(named.values(), named, loc="outside upper center", **form)
    elif named:
        grow(figure, above_mm=LEGEND_MM + LEGEND_LINE_MM * math.ceil(len(named) / ncols))
        form |= {"labelspacing": 0.3, "borderaxespad": 0.2, "borderpad": 0.2}
        figure.legend(named.values(), named, loc="upper center", **form)


def _named(axes: Iterable[Axes]) -> dict[str, Artist]:
    """Return what a legend shows, each name once."""
    return {
        name: handle for one in axes for handle, name in zip(*one.get_legend_handles_labels(), strict=True)
    }


def add_colours(axes: Axes, coloured: ScalarMappable, label: str) -> None:
    """Put the scale of a map's colours beside it."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    bar = figure.colorbar(coloured, cax=axes.inset_axes((1.03, 0.0, 0.045, 1.0)))
    bar.set_label(label)
    bar.outline.set_linewidth(0.6)


def plain_log_ticks(axis: Axis) -> None:
    """Label a logarithmic axis of one or two decades with 1, 2, 3, 5 and their multiples by ten, without powers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


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
    marker: str = "o",
    size: float = 3.5,
    label: str = "_",
) -> None:
    """Draw results with black bars of 95 %; marks are open for a value that was not measured with a sensor."""
    axes.errorbar(
        at, values, yerr=u95, fmt=marker, markersize=size, color=BLACK,
        markerfacecolor=colour if full else "white", markeredgecolor=BLACK if full else colour,
        markeredgewidth=0.4 if full else 0.7, elinewidth=0.7, capsize=1.8, capthick=0.7, label=label, zorder=4.0,
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


def draw_length(axes: Axes, at: float, ends: tuple[float, float], colour: str, words: str = "") -> None:
    """Draw an upright arrow between two heights, with its words beside it."""
    arrow = {"arrowstyle": "<|-|>,head_length=0.28,head_width=0.14", "color": colour, "linewidth": 0.8}
    low, high = ends
    axes.annotate("", (at, high), (at, low), arrowprops={**arrow, "shrinkA": 0.0, "shrinkB": 0.0})
    if words:
        axes.annotate(
            words, (at, 0.5 * (low + high)), xytext=(3.0, 0.0), textcoords="offset points", color=colour,
            va="center", fontsize=6.0,
        )  # fmt: skip


class NothingToDraw(Exception):
    """The run contains nothing for this figure. The message is a sentence with the reason and the remedy."""


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in the style of the project; a figure must be made and rendered within."""
    with rc_context(_SETTINGS):  # type: ignore[arg-type]
        yield


def rendered(figure: Figure, suffix: str) -> bytes:
    """Return the figure as a file with the ending `.png`, `.svg` or `.pdf` contains it."""
    file = BytesIO()
    figure.savefig(file, format=suffix[1:], dpi=PNG_DPI, metadata=_UNDATED.get(suffix, {}))
    return file.getvalue()


def time_unit(span_s: float) -> tuple[float, str]:
    """Return seconds per unit and the label of an axis of time of this span: in ms, s, min or h."""
    if span_s < 0.5:
        return 1e-3, "time (ms)"
    if span_s <= 300.0:
        return 1.0, "time (s)"
    return (60.0, "time (min)") if span_s <= 3.0 * 3600.0 else (3600.0, "time (h)")
