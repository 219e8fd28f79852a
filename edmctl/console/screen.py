"""A block of lines at the bottom of a terminal that is redrawn in place, while other lines scroll by above it.

Each picture is one write that overwrites the one before, so nothing is ever blank in between. The cursor rests at
the begin of the last line, hidden: whatever the terminal echoes there is gone with the next picture.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from collections.abc import Sequence

HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
_BEGIN, _END = "\x1b[?2026h", "\x1b[?2026l"
"""Terminals that know it show everything between these at once; the others skip it."""
_TO_LINE_END, _LINE, _TO_SCREEN_END = "\x1b[K", "\x1b[2K", "\x1b[J"
_USUAL = (80, 24)


class Screen:
    """The block on one stream. A terminal that is gone takes nothing, and that is no error."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lines: list[str] = []
        self._cells: list[int] = []
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
        self._lines, self._cells = [text for text, _ in lines], [cells for _, cells in lines]
        self._width = width
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
            self._lines, self._cells = [], []

    def _back(self, width: int) -> str:
        """Go to the begin of the block."""
        return _up(self._rows(self._cells[:-1], width))

    def _erased(self, width: int) -> str:
        """Go to the begin of the block and erase it.

        Line by line: tmux keeps a screen that is erased as a whole, and the block would stand above itself.
        """
        rows = self._rows(self._cells, width)
        return self._back(width) + f"{_LINE}\x1b[B" * (rows - 1) + _LINE + _up(rows - 1) if rows else "\r"

    @staticmethod
    def _rows(cells: Sequence[int], width: int) -> int:
        """Rows that lines take on a terminal, which wraps them where it became narrower."""
        return sum(max(1, -(-count // width)) for count in cells)

    def _block(self) -> str:
        return f"{_TO_LINE_END}\n".join(self._lines) + f"{_TO_SCREEN_END}\r"

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):
            self._stream.write(text)
            self._stream.flush()


def _up(rows: int) -> str:
    return f"\r\x1b[{rows}A" if rows > 0 else "\r"
