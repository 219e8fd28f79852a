"""Progress on a terminal: a block of lines that is redrawn in place, while other lines scroll by above it.

Each picture is one write that overwrites the one before, so nothing is ever blank in between. The cursor rests at
the begin of the last line, hidden: whatever the terminal echoes there is gone with the next picture.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TextIO

from edmctl.cli.render.live_view import Histories, count_bar, draw_view, painted, plain_ascii
from edmctl.cli.render.progress import Pacer, Reporter, left_words
from edmctl.cli.render.terminal import Ink, Span, Style, wrapped
from edmctl.results.progress import Progress
from edmctl.wording import escaped

REDRAW_EVERY_S = 0.1
_RUNS_WORDS = 48
HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
_BEGIN, _END = "\x1b[?2026h", "\x1b[?2026l"
"""Terminals that know it show everything between these at once; the others skip it."""
_TO_LINE_END, _LINE, _TO_SCREEN_END = "\x1b[K", "\x1b[2K", "\x1b[J"
_USUAL = (80, 24)


class LiveReporter(Reporter):
    """A block that follows the job at 10 Hz of wall time and vanishes when it ends; notes stay above it."""

    def __init__(self, stream: TextIO, style: Style, clock: Callable[[], float] = time.monotonic) -> None:
        self._screen = Screen(stream)
        self._style = style
        self._clock = clock
        self._due_s = -math.inf
        self._histories = Histories()
        self._pacer = Pacer(clock)

    def progress(self, p: Progress) -> None:
        """Keep the samples; redraw when the last picture is a tenth of a second old."""
        self._histories.update(p)
        if not self._is_due():
            return
        width, height = self._screen.size()
        # The last line but one of the terminal stays for a note; the last column would make some of them wrap.
        self._screen.show(draw_view(p, self._histories, width - 1, max(1, height - 2), self._style), width)

    def runs(self, done: int, total: int) -> None:
        """Redraw the count of runs."""
        left_s = self._pacer.time_left_s(done, total)
        if not (self._is_due() or done == total):
            return
        width, _ = self._screen.size()
        cells = max(0, min(60, width - 1 - _RUNS_WORDS)) if self._style.unicode else 0
        bar = count_bar(done, total, cells)
        line: list[Span] = [("runs  ", Ink.FAINT), *bar, (f"  {done} of {total}{left_words(left_s)}", None)]
        self._screen.show([painted(line, width - 1, self._style)], width)

    def note(self, text: str) -> None:
        """Print `text` above the picture, where it stays; the terminal itself would break it within a word."""
        shown = escaped(text if self._style.unicode else plain_ascii(text))
        width, _ = self._screen.size()
        for line in wrapped(shown, width - 1, "  "):
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
