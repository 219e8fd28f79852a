"""Every figure of a run as a page carries it: as SVG, or as PNG where that is shorter."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.report.kinds import KINDS, Kind, draw
from edmctl.report.style import NothingToDraw, house_style, rendered

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from edmctl.record.reader import RunFile

MOST_SVG_BYTES = 200_000
"""A figure with more in it than this goes into the page as PNG, so that no page grows beyond a few megabytes."""

_MEDIA_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of the page, or why there is none: then `address` is empty."""

    kind: Kind
    address: str = ""
    """A data URI that holds the picture."""
    width_mm: float = 0.0
    height_mm: float = 0.0
    why_not: str = ""


def pictures_of(run: RunFile) -> list[Picture]:
    """Draw all that the run has something for."""
    return [_picture(kind, run) for kind in KINDS]


def _picture(kind: Kind, run: RunFile) -> Picture:
    from matplotlib import rc_context

    # Letters as outlines: the page looks the same where the font of the figures is not installed.
    with house_style(), rc_context({"svg.fonttype": "path"}):
        try:
            figure = draw(kind, run)
        except NothingToDraw as reason:
            return Picture(kind, why_not=str(reason))
        width_mm, height_mm = (25.4 * inches for inches in figure.get_size_inches())
        return Picture(kind, _address(figure), width_mm, height_mm)


def _address(figure: Figure) -> str:
    suffix, content = ".svg", rendered(figure, ".svg")
    if len(content) > MOST_SVG_BYTES:
        suffix, content = ".png", rendered(figure, ".png")
    return f"data:{_MEDIA_TYPES[suffix]};base64,{base64.b64encode(content).decode()}"
