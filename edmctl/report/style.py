"""How figures look: widths, colours, fonts and lines, and how a figure becomes a file.

Colours are those of Okabe & Ito, which the colour-blind can tell apart; lines differ in dash or width too.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import TypeAlias

from matplotlib import rc_context
from matplotlib.figure import Figure

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
