"""Source of faults.py."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from edmctl.link.emit.source import INDENT, LINE_LENGTH, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_FAULTS_HEAD = '''\
"""Faults of the machine, whoever detects them.

Made from faults.toml by `python -m edmctl.link.generate`; edit that file, not this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One fault: who detects it and how, what follows, what to tell.

    code, name : as in FAULT and in CLEAR_FAULT; codes from 7000 on never leave the host.
    who : "controller", "host" or "both".
    detect, reaction : how it is noticed, and what follows after the pulses are off.
    message, hint : what happened, what to do. A name in braces stands for the value of that parameter.
    exit_code, error : exit code and error code of the command that it ends.
    pulses_off_s : promised time from the cause to pulses off, in s, with every parameter at its default.
    latched : the controller holds it until CLEAR_FAULT names it.
    inject : injection that brings it about on the virtual machine; in small letters, another way.
    """

    code: int
    name: str
    who: str
    detect: str
    reaction: str
    message: str
    hint: str
    exit_code: int
    error: str
    pulses_off_s: float
    latched: bool
    inject: str


class FaultCode(IntEnum):
    """Code of a fault; those from 7000 on are the host's own."""

'''

_KEYS = (
    "code",
    "name",
    "who",
    "detect",
    "reaction",
    "message",
    "hint",
    "exit_code",
    "error",
    "pulses_off_s",
    "latched",
    "inject",
)


def faults_source(rows: Sequence[Mapping[str, object]]) -> str:
    """Return the source of faults.py."""
    codes = "".join(f"    {row['name']} = {row['code']}\n" for row in rows)
    table = ["\n\nFAULTS: dict[int, FaultRow] = {\n"]
    for row in rows:
        table.append(f"    {row['code']}: FaultRow(\n")
        table += [_string_argument(key, row[key]) for key in _KEYS]
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
