"""Bars in text: how far a depth is, with what is uncertain of it, and the mix of pulses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.console.style import Ink

if TYPE_CHECKING:
    from edmctl.console.cells import Span
    from edmctl.console.views import RatiosView

BEYOND = 1.08
"""The depth bar goes so far beyond its target, so that a hole that comes out too deep is seen."""


@dataclass(frozen=True, slots=True)
class _Glyphs:
    done: str
    band: str
    rest: str
    target: str
    open: str
    normal: str
    arc: str
    short: str


_UNICODE = _Glyphs("█", "▒", "─", "│", "░", "█", "▓", "▞")
_ASCII = _Glyphs("#", "~", "-", "|", ".", "#", "a", "S")
PULSE_INKS = {"open": Ink.OPEN, "normal": Ink.NORMAL, "arc": Ink.ARC, "short": Ink.SHORT}


def depth_bar(
    done_um: float, u95_um: float, target_um: float, cells: int, *, unicode: bool = True
) -> list[Span]:
    """Draw what is surely done, the band of the 95 % interval around the tip (a cell at least), and the target."""
    glyphs = _UNICODE if unicode else _ASCII
    full_um = BEYOND * target_um
    if not (full_um > 0.0 and math.isfinite(done_um)) or cells < 1:
        return [(glyphs.rest * cells, Ink.FAINT)]

    def place(value_um: float) -> float:
        return min(max(value_um / full_um, 0.0), 1.0) * cells

    band_um = u95_um if math.isfinite(u95_um) else 0.0
    sure, likely = math.floor(place(done_um - band_um)), math.ceil(place(done_um + band_um))
    if band_um == 0.0:
        sure = likely = round(place(done_um))
    at = min(round(place(target_um)), cells - 1)
    parts = [(0, sure, glyphs.done, Ink.SIGNAL), (sure, likely, glyphs.band, Ink.BAND)]
    parts += [(likely, cells, glyphs.rest, Ink.FAINT)]
    spans: list[Span] = []
    for begin, end, glyph, ink in parts:
        if begin <= at < end:
            spans += [
                (glyph * (at - begin), ink),
                (glyphs.target, Ink.STRONG),
                (glyph * (end - at - 1), ink),
            ]
        else:
            spans.append((glyph * (end - begin), ink))
    return [span for span in spans if span[0]]


def count_bar(done: int, total: int, cells: int, *, unicode: bool = True) -> list[Span]:
    """Draw how many of a number are done."""
    glyphs = _UNICODE if unicode else _ASCII
    filled = min(cells, cells * done // max(1, total))
    return [(glyphs.done * filled, Ink.SIGNAL), (glyphs.rest * (cells - filled), Ink.FAINT)]


def pulse_bar(ratios: RatiosView, cells: int, *, unicode: bool = True, colour: bool = True) -> list[Span]:
    """Draw the classes side by side; with colour all are solid, without it each has a pattern."""
    glyphs = _UNICODE if unicode else _ASCII
    spans: list[Span] = []
    drawn, total = 0, 0.0
    for name, ink in PULSE_INKS.items():
        share = float(getattr(ratios, name))
        total += share if math.isfinite(share) else 0.0
        end = max(drawn, min(cells, round(total * cells)))
        glyph = glyphs.done if unicode and colour else getattr(glyphs, name)
        spans.append((glyph * (end - drawn), ink))
        drawn = end
    spans.append((" " * (cells - drawn), None))
    return [span for span in spans if span[0]]
