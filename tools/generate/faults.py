"""Source of edmctl/link/faults.py."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from tools.generate.text import LINE_LENGTH, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_HEAD = '''\
"""Faults of the machine, whoever detects them.

Made from faults.toml by `python -m tools.generate`; edit that file, not this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One fault: who detects it, what to tell, what it leads to.

    code, name : as in FAULT and in CLEAR_FAULT; codes from 7000 on never leave the host.
    who : "controller", "host" or "both".
    message, hint : what happened, what to do. A name in braces stands for the value of that parameter.
    exit_code, error : exit code and error code of the command that it ends.
    pulses_off_s : promised time from the cause to pulses off, in s, with every parameter at its default.
    latched : the controller holds it until CLEAR_FAULT names it.
    inject : injection that brings it about on the virtual machine; in small letters, another way.
    """

    code: int
    name: str
    who: str
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
    made = "".join(f"FaultRow({''.join(_argument(key, row[key]) for key in _KEYS)}),\n" for row in rows)
    return f"{_HEAD}{codes}\n\nFAULTS = {{row.code: row for row in (\n{made})}}\n"


def _argument(key: str, value: object) -> str:
    literal = quoted(value) if isinstance(value, str) else str(value)
    if len(literal) > LINE_LENGTH - 25:
        pieces = textwrap.wrap(str(value), LINE_LENGTH - 20, drop_whitespace=False)
        literal = f"({' '.join(quoted(piece) for piece in pieces)})"
    return f"{key}={literal},"
