"""Charts in text: bars of depth, counts and pulse classes, and the last minute of a signal.

Every column of a signal shows the lowest and the highest value of its time, so that no short peak is lost.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from edmctl.cli.render.layout import Span
from edmctl.cli.render.style import Ink
from edmctl.dataclasses import dataclass
from edmctl.results.telemetry import PulseShares

BEYOND = 1.08
"""The depth bar goes so far beyond its target, so that a hole that comes out too deep is seen."""
SPAN_S = 60.0
_MOST = 4000
"""Reports that are kept: a minute of them at 60 Hz."""
_LEFT = (0x01, 0x02, 0x04, 0x40)
_RIGHT = (0x08, 0x10, 0x20, 0x80)
"""Dots of a braille cell from top to bottom."""
_ASCII_CELL = {(False, False): " ", (True, False): "'", (False, True): ".", (True, True): ":"}


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


def pulse_bar(ratios: PulseShares, cells: int, *, unicode: bool = True, colour: bool = True) -> list[Span]:
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


class History:
    """Lows and highs of one signal in the last `SPAN_S` of the machine's time."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, float, float]] = deque(maxlen=_MOST)

    def update(self, time_s: float, low: float, high: float) -> None:
        """Add one report; unknown values are left out, and a clock that goes back begins anew."""
        rows = self._rows
        if not math.isfinite(time_s):
            return
        if rows and time_s < rows[-1][0]:
            rows.clear()
        while rows and rows[0][0] < time_s - SPAN_S:
            rows.popleft()
        if low <= high:
            rows.append((time_s, low, high))

    @property
    def low(self) -> float:
        """Lowest value; NaN without any."""
        return min((row[1] for row in self._rows), default=math.nan)

    @property
    def high(self) -> float:
        """Highest value; NaN without any."""
        return max((row[2] for row in self._rows), default=math.nan)

    def columns(self, count: int, now_s: float) -> list[tuple[float, float] | None]:
        """Low and high in each of `count` equal parts of the span, oldest first; None without a report.

        The parts begin at whole multiples of their length, so that a peak keeps its shape while it travels.
        """
        if not math.isfinite(now_s):
            return [None] * count
        step_s = SPAN_S / count
        oldest = math.floor(now_s / step_s) - count + 1
        found: list[tuple[float, float] | None] = [None] * count
        for time_s, low, high in self._rows:
            i = int(time_s / step_s) - oldest
            if not 0 <= i < count:
                continue
            other = found[i]
            if other is None:
                found[i] = (low, high)
            elif low < other[0] or high > other[1]:
                found[i] = (min(low, other[0]), max(high, other[1]))
        return found


def chart(
    history: History,
    now_s: float,
    cells: int,
    rows: int,
    scale: tuple[float, float],
    mark: float = math.nan,
    *,
    unicode: bool = True,
) -> list[list[Span]]:
    """Draw the history into `rows` of `cells`, top first; `mark` is a value that a faint line stands at.

    scale : values at the lower and the upper edge
    """
    if unicode:
        return _braille(history.columns(2 * cells, now_s), rows, scale, mark)
    return _ascii(history.columns(cells, now_s), rows, scale, mark)


def _level(value: float, scale: tuple[float, float], levels: int) -> int:
    """Return the row of dots, from the top, of a value."""
    low, high = scale
    share = (value - low) / (high - low) if high > low else 0.5
    return levels - 1 - min(max(round(share * (levels - 1)), 0), levels - 1)


def _braille(
    columns: Sequence[tuple[float, float] | None], rows: int, scale: tuple[float, float], mark: float
) -> list[list[Span]]:
    cells, levels = len(columns) // 2, 4 * rows
    dots = [[0] * cells for _ in range(rows)]
    for i, found in enumerate(columns):
        if found is None:
            continue
        bits, cell = (_RIGHT, i // 2) if i % 2 else (_LEFT, i // 2)
        for level in range(_level(found[1], scale, levels), _level(found[0], scale, levels) + 1):
            dots[level // 4][cell] |= bits[level % 4]
    marked, bit = -1, 0
    if math.isfinite(mark):
        level = _level(mark, scale, levels)
        marked, bit = level // 4, _LEFT[level % 4] | _RIGHT[level % 4]
    drawn = []
    for row, line in enumerate(dots):
        empty = chr(0x2800 + bit) if row == marked else " "
        drawn.append(_joined([chr(0x2800 + d) if d else empty for d in line], [d > 0 for d in line]))
    return drawn


def _ascii(
    columns: Sequence[tuple[float, float] | None], rows: int, scale: tuple[float, float], mark: float
) -> list[list[Span]]:
    levels = 2 * rows
    marked = _level(mark, scale, levels) // 2 if math.isfinite(mark) else -1
    spans = [(_level(f[1], scale, levels), _level(f[0], scale, levels)) if f else (1, 0) for f in columns]
    drawn = []
    for row in range(rows):
        upper, lower = 2 * row, 2 * row + 1
        cells = [_ASCII_CELL[top <= upper <= end, top <= lower <= end] for top, end in spans]
        empty = "-" if row == marked else " "
        drawn.append(_joined([c if c != " " else empty for c in cells], [c != " " for c in cells]))
    return drawn


def _joined(cells: Sequence[str], bright: Sequence[bool]) -> list[Span]:
    """Join neighbours of one ink."""
    spans: list[Span] = []
    begin = 0
    for i in range(1, len(cells) + 1):
        if i == len(cells) or bright[i] != bright[begin]:
            spans.append(("".join(cells[begin:i]), Ink.SIGNAL if bright[begin] else Ink.FAINT))
            begin = i
    return spans
