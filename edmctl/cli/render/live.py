"""Progress on a terminal: a block of lines that is redrawn in place, while other lines scroll by above it.

Each picture is one write that overwrites the one before, so nothing is ever blank in between. The cursor rests at
the begin of the last line, hidden: whatever the terminal echoes there is gone with the next picture.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import groupby
from operator import itemgetter
from typing import TextIO

from rich.cells import cell_len, set_cell_size

from edmctl.cli.render.progress import Pacer, Reporter, depth_words, has_pulses, left_words, while_cutting
from edmctl.cli.render.terminal import Ink, Span, Style, wrapped
from edmctl.results.progress import Progress
from edmctl.results.telemetry import PulseShares
from edmctl.wording import decimal, duration, escaped, printable

REDRAW_EVERY_S = 0.1
HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
_BEGIN, _END = "\x1b[?2026h", "\x1b[?2026l"
"""Terminals that know it show everything between these at once; the others skip it."""
_TO_LINE_END, _LINE, _TO_SCREEN_END = "\x1b[K", "\x1b[2K", "\x1b[J"
_USUAL = (80, 24)

LABEL, FIGURES, GAP = 8, 44, 2
"""Cells of a label, of the figures beside it, and before the bar."""
LEAST_BAR, MOST_BAR = 10, 60
BEYOND = 1.08
"""The depth bar extends this far beyond its target, so that a hole that is too deep is visible."""
_PULSES = {
    "open": ("░", Ink.OPEN),
    "normal": ("█", Ink.NORMAL),
    "arc": ("▓", Ink.ARC),
    "short": ("▞", Ink.SHORT),
}
_ASCII = str.maketrans(
    {"µ": "u", "±": "+-", "–": "-", "−": "-", "…": "~", "·": "*", "°": " deg ", "×": "x", "→": "->"}
)


class LiveReporter(Reporter):
    """A block that follows the job at 10 Hz of wall time and vanishes when it ends; notes stay above it."""

    def __init__(self, stream: TextIO, style: Style, clock: Callable[[], float] = time.monotonic) -> None:
        self._screen = Screen(stream)
        self._style = style
        self._clock = clock
        self._due_s = -math.inf
        self._pacer = Pacer(clock)

    def progress(self, p: Progress) -> None:
        """Redraw when the last picture is a tenth of a second old."""
        if self._is_due():
            width, height = self._screen.size()
            # The last line but one of the terminal stays for a note; the last column would make some of them wrap.
            self._screen.show(draw_view(p, width - 1, max(1, height - 2), self._style), width)

    def runs(self, done: int, total: int) -> None:
        """Redraw the count of runs."""
        left_s = self._pacer.time_left_s(done, total)
        if self._is_due() or done == total:
            width, _ = self._screen.size()
            figures = f"{done} of {total}{left_words(left_s)}"
            bar = count_bar(done, total, _bar_cells(width - 1, self._style))
            self._screen.show([painted(_row("runs", [(figures, None)], bar), width - 1, self._style)], width)

    def note(self, text: str) -> None:
        """Print `text` above the picture, where it stays; the terminal itself would break it within a word."""
        width, _ = self._screen.size()
        for line in wrapped(escaped(_plain(text, self._style)), width - 1, "  "):
            self._screen.print_above(self._style.paint(line, Ink.FAINT))

    def aside(self) -> None:
        """Take the picture away until the next progress: what is written past it would be drawn over."""
        self._screen.close()

    def close(self) -> None:
        """Take the picture away, and leave a line between the notes and the result."""
        if self._screen.is_shown:
            self._screen.close()
            self._screen.print_above("")

    def _is_due(self) -> bool:
        now_s = self._clock()
        if now_s < self._due_s:
            return False
        self._due_s = now_s + REDRAW_EVERY_S
        return True


class Screen:
    """The block on one stream. A terminal that is gone takes nothing, and that is no error."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lines: Sequence[tuple[str, int]] = ()
        self._width = 0

    @property
    def is_shown(self) -> bool:
        """Whether there is a block."""
        return bool(self._lines)

    def size(self) -> tuple[int, int]:
        """Width and height of the terminal now, in cells."""
        try:
            size = os.get_terminal_size(self._stream.fileno())
        except (OSError, ValueError):
            return _USUAL
        return (size.columns or _USUAL[0], size.lines or _USUAL[1])

    def show(self, lines: Sequence[tuple[str, int]], width: int) -> None:
        """Draw `lines`, each with the cells it takes, in the place of those before. `width` is the terminal's."""
        hide = "" if self._lines else HIDE_CURSOR
        # What the terminal has wrapped stays joined in its memory until it is erased.
        back = self._back(width) if width == self._width else self._erased(width)
        self._lines, self._width = lines, width
        self._write(f"{_BEGIN}{hide}{back}{self._block()}{_END}")

    def print_above(self, text: str) -> None:
        """Write a line of text that stays, above the block."""
        if not self._lines:
            self._write(f"{text}\n")
            return
        self._write(f"{_BEGIN}{self._erased(self.size()[0])}{text}\n{self._block()}{_END}")

    def close(self) -> None:
        """Take the block away, and give the cursor back."""
        if self._lines:
            self._write(f"{self._erased(self.size()[0])}{SHOW_CURSOR}")
            self._lines = ()

    def _back(self, width: int) -> str:
        return _up(_rows(self._lines[:-1], width))

    def _erased(self, width: int) -> str:
        """Go to the begin of the block and erase it.

        Line by line: tmux keeps a screen that is erased as a whole, and the block would stand above itself.
        """
        rows = _rows(self._lines, width)
        return self._back(width) + f"{_LINE}\x1b[B" * (rows - 1) + _LINE + _up(rows - 1) if rows else "\r"

    def _block(self) -> str:
        return f"{_TO_LINE_END}\n".join(text for text, _ in self._lines) + f"{_TO_SCREEN_END}\r"

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):
            self._stream.write(text)
            self._stream.flush()


def _rows(lines: Sequence[tuple[str, int]], width: int) -> int:
    """Return the rows of lines on a terminal that wraps them after it became narrower."""
    return sum(max(1, -(-cells // width)) for _, cells in lines)


def _up(rows: int) -> str:
    return f"\r\x1b[{rows}A" if rows > 0 else "\r"


def draw_view(p: Progress, width: int, height: int, style: Style) -> list[tuple[str, int]]:
    """Return at most `height` lines of at most `width` cells, painted, with the cells they take.

    The most important ones are first. Bars are beside the figures if there is room for them.
    """
    lines = [_head(p, width, style), *_lines(p, _bar_cells(width, style), style)]
    above: list[list[Span]] = [[]] if len(lines) < height else []
    return [painted(line, width, style) for line in (*above, *lines)[:height]]


def _bar_cells(width: int, style: Style) -> int:
    cells = width - LABEL - FIGURES - GAP
    return min(cells, MOST_BAR) if style.unicode and cells >= LEAST_BAR else 0


def _head(p: Progress, width: int, style: Style) -> list[Span]:
    """Step, place and times; names are cut before times."""
    done = f"{p.sites_done} of {p.sites_total} done" if p.sites_total > 1 else ""
    where = ", ".join(filter(None, [printable(p.site), p.step, done]))
    phase, times = str(p.phase), f"{duration(p.time_s)}{left_words(p.time_left_s)}"
    free = width - len(phase) - len(times) - GAP
    place = cut(_plain(f" {where}" if where else "", style), free)
    blanks = " " * (max(0, free - cell_len(place)) + GAP)
    return [(phase, Ink.STRONG), (place, None), (blanks, None), (times, Ink.FAINT)]


def _lines(p: Progress, bar_cells: int, style: Style) -> Iterator[list[Span]]:
    """Yield a line for what is known of the job."""
    target_is_feed = math.isfinite(p.feed_target_um) and math.isfinite(p.feed_um)
    if target_is_feed:
        done = f"{p.feed_um:.1f} of {p.feed_target_um:.1f} µm"
        yield _row("feed", [(done, None)], depth_bar(p.feed_um, math.nan, p.feed_target_um, bar_cells))
    elif math.isfinite(p.depth_um) and not (p.depth_um == 0.0 and math.isnan(p.depth_target_um)):
        bar = depth_bar(p.depth_um, p.depth_u95_um, p.depth_target_um, bar_cells)
        yield _row("depth", [(depth_words(p), None)], bar)
    if p.warning:
        ago = f" {duration(max(0.0, p.time_s - p.warned_s))} ago" if math.isfinite(p.warned_s) else ""
        yield [("warning", Ink.WARNING), (f"{ago}: {printable(p.warning)}", None)]
    if has_pulses(p.ratios):
        if math.isfinite(p.gap_v):
            yield _row("gap", [(f"{p.gap_v:.1f} V, reference {p.reference_v:.1f} V", None)])
        shares: list[Span] = []
        for name, (_, ink) in _PULSES.items():
            share = f"{100.0 * float(getattr(p.ratios, name)):.0f} % {name}"
            shares += [(", " if shares else "", None), (share, ink)]
        yield _row("pulses", shares, pulse_bar(p.ratios, bar_cells, colour=style.colour))
    if math.isfinite(p.displacement_um):
        yield _row("tool", [(f"at {p.displacement_um:.1f} µm", None)])
    u95 = f" ± {p.wear_u95_um:.1f}" if math.isfinite(p.wear_u95_um) else ""
    feed = [
        f"{p.feed_um:.1f} µm" if math.isfinite(p.feed_um) and not target_is_feed else "",
        f"{decimal(p.feed_um_s)} µm/s" if math.isfinite(p.feed_um_s) else "",
        f"tool wear {while_cutting(p)}{p.wear_um:.1f}{u95} µm" if math.isfinite(p.wear_um) else "",
    ]
    if any(feed):
        yield _row("" if target_is_feed else "feed", [(", ".join(filter(None, feed)), None)])
    if p.jumps:
        every = f", every {p.jump_period_s:.3g} s" if math.isfinite(p.jump_period_s) else ""
        ago = duration(max(0.0, p.time_s - p.last_jump_s))
        step = p.step.partition(" ")[0] or "job"
        yield _row("jumps", [(f"{p.jumps} in this {step}{every}, the last {ago} ago", None)])


def _row(label: str, figures: Sequence[Span], bar: Sequence[Span] = ()) -> list[Span]:
    blanks = FIGURES - sum(cell_len(text) for text, _ in figures) + GAP if bar else 0
    return [(f"{label:{LABEL}}", Ink.FAINT), *figures, (" " * blanks, None), *bar]


def depth_bar(done_um: float, u95_um: float, target_um: float, cells: int) -> list[Span]:
    """Draw the depth, the band of its 95 % interval (a cell at least), and the target."""
    full_um = BEYOND * target_um
    if not (cells and full_um > 0.0 and math.isfinite(done_um)):
        return [("─" * cells, Ink.FAINT)]

    def place(value_um: float) -> float:
        return min(max(value_um / full_um, 0.0), 1.0) * cells

    sure = likely = round(place(done_um))
    if u95_um > 0.0:
        sure, likely = math.floor(place(done_um - u95_um)), math.ceil(place(done_um + u95_um))
    bar: list[Span] = [
        *[("█", Ink.SIGNAL)] * sure,
        *[("▒", Ink.BAND)] * (likely - sure),
        *[("─", Ink.FAINT)] * (cells - likely),
    ]
    bar[min(round(place(target_um)), cells - 1)] = ("│", Ink.STRONG)
    return [("".join(text for text, _ in run), ink) for ink, run in groupby(bar, key=itemgetter(1))]


def count_bar(done: int, total: int, cells: int) -> list[Span]:
    """Draw how many of a number are done."""
    filled = min(cells, cells * done // max(1, total))
    return [("█" * filled, Ink.SIGNAL), ("─" * (cells - filled), Ink.FAINT)]


def pulse_bar(ratios: PulseShares, cells: int, *, colour: bool = True) -> list[Span]:
    """Draw the classes side by side; with colour all are solid, without it each has a pattern."""
    spans: list[Span] = []
    drawn, total = 0, 0.0
    for name, (pattern, ink) in _PULSES.items():
        share = float(getattr(ratios, name))
        total += share if math.isfinite(share) else 0.0
        end = max(drawn, min(cells, round(total * cells)))
        spans.append((("█" if colour else pattern) * (end - drawn), ink))
        drawn = end
    return spans


def _plain(text: str, style: Style) -> str:
    """Return `text`, without Unicode in ASCII; a character without an equivalent becomes `?`."""
    if style.unicode or text.isascii():
        return text
    return text.translate(_ASCII).encode("ascii", "replace").decode("ascii")


def cut(text: str, cells: int) -> str:
    """Return as much of `text` as fits into `cells`, with an ellipsis if it was cut."""
    if cell_len(text) <= cells:
        return text
    return f"{set_cell_size(text, cells - 1).rstrip()}…" if cells > 0 else ""


def painted(spans: Sequence[Span], cells: int, style: Style) -> tuple[str, int]:
    """Return the spans painted and cut to `cells`, and the cells that they take."""
    parts, used = [], 0
    for text, ink in spans:
        shown = _plain(cut(_plain(text, style), cells - used), style)
        used += cell_len(shown)
        parts.append(style.paint(shown, ink) if ink else shown)
    return "".join(parts), used
