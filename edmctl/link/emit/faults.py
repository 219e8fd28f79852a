"""Source of faults.py."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from edmctl.link.emit.source import INDENT, LINE_LENGTH, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_FAULTS_HEAD = '''\
"""Faults of the controller.

Made from faults.toml by `python -m edmctl.link.generate`; edit that file, not this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One fault: who detects it and how, what happened, what to do.

    A name in braces in `message` stands for the value of that parameter.
    """

    code: int
    name: str
    who: str
    detect: str
    message: str
    hint: str


class FaultCode(IntEnum):
    """Code of a FAULT."""

'''


def faults_source(rows: Sequence[Mapping[str, object]]) -> str:
    """Return the source of faults.py."""
    codes = "".join(f"    {row['name']} = {row['code']}\n" for row in rows)
    keys = ("code", "name", "who", "detect", "message", "hint")
    table = ["\n\nFAULTS: dict[int, FaultRow] = {\n"]
    for row in rows:
        table.append(f"    {row['code']}: FaultRow(\n")
        table += [_string_argument(key, row[key]) for key in keys]
        table.append("    ),\n")
    return _FAULTS_HEAD + codes + "".join(table) + "}\n"


def _string_argument(key: str, value: object) -> str:
    literal = quoted(value) if isinstance(value, str) else str(value)
    line = f"{INDENT * 2}{key}={literal},\n"
    if len(line) <= LINE_LENGTH + 1:
        return line
    pieces = textwrap.wrap(str(value), LINE_LENGTH - 14, drop_whitespace=False)
    lines = "".join(f"{INDENT * 3}{quoted(piece)}\n" for piece in pieces)
    return f"{INDENT * 2}{key}=(\n{lines}{INDENT * 2}),\n"
