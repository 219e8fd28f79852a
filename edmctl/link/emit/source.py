"""Lays Python source out as ruff would."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

LINE_LENGTH = 110
INDENT = "    "


def quoted(text: str) -> str:
    """Return a Python string literal in double quotes."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def call(indent: str, head: str, arguments: Sequence[str], tail: str = ")") -> str:
    """Return `head` arguments `tail`, one argument per line where they exceed one line."""
    line = f"{indent}{head}{', '.join(arguments)}{tail}\n"
    if len(line) <= LINE_LENGTH + 1:
        return line
    inner = "".join(f"{indent}{INDENT}{argument},\n" for argument in arguments)
    return f"{indent}{head}\n{inner}{indent}{tail}\n"
