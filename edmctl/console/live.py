"""Progress on a terminal, redrawn in place."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, TextIO

from edmctl.console.bars import count_bar
from edmctl.console.cells import plain_ascii, render_line
from edmctl.console.live_view import Histories, draw_view
from edmctl.console.screen import Screen
from edmctl.console.style import Ink
from edmctl.console.tables import wrapped

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.console.cells import Span
    from edmctl.console.style import Style
    from edmctl.console.views import ProgressView

REDRAW_EVERY_S = 0.1
_RUNS_WORDS = 24


class LiveReporter:
    """A block that follows the job at 10 Hz of wall time and vanishes when it ends; notes stay above it."""

    def __init__(self, stream: TextIO, style: Style, clock: Callable[[], float] = time.monotonic) -> None:
        self._screen = Screen(stream)
        self._style = style
        self._clock = clock
        self._due_s = -math.inf
        self._histories = Histories()

    def progress(self, p: ProgressView) -> None:
        """Keep the samples; redraw when the last picture is a tenth of a second old."""
        self._histories.take(p)
        if not self._is_due():
            return
        width, height = self._screen.size()
        # The last line but one of the terminal stays for a note; the last column would make some of them wrap.
        self._screen.show(draw_view(p, self._histories, width - 1, max(1, height - 2), self._style), width)

    def runs(self, done: int, total: int) -> None:
        """Redraw the count of runs."""
        if not (self._is_due() or done == total):
            return
        width, _ = self._screen.size()
        cells = max(0, min(60, width - 1 - _RUNS_WORDS))
        bar = count_bar(done, total, cells, unicode=self._style.unicode)
        line: list[Span] = [("runs  ", Ink.FAINT), *bar, (f"  {done} of {total}", None)]
        self._screen.show([(render_line(line, width - 1, self._style), min(width - 1, cells + 24))], width)

    def note(self, text: str) -> None:
        """Print `text` above the picture, where it stays; the terminal itself would break it within a word."""
        shown = text if self._style.unicode else plain_ascii(text)
        width, _ = self._screen.size()
        for line in wrapped(shown, width - 1, "  "):
            self._screen.print_above(self._style.paint(line, Ink.FAINT))

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
