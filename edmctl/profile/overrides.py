"""`--set key=value`: one value of the profile from the command line."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic, Location, ProfileError
from edmctl.profile.codes import Code
from edmctl.profile.merge import changes, put
from edmctl.profile.read import decimal_comma
from edmctl.profile.sources import SET_OPTION, Source

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.profile.sources import TomlTable

_DEEPEST = 32
_BARE_WORD = re.compile(r"[A-Za-z][\w.+/ -]*")
_SITES = re.compile(r"\s*sites\s*[.\[]")
_HINT_SITES = (
    "write all places, --set 'sites=[{x_um=600},{x_um=1000,y_um=400}]', or put them into the profile"
)
_HINT = "write --set servo.reference=0.82, with the value as in a file: 0.8 and not .8, text in quotes"


@dataclass(frozen=True, slots=True)
class Overridden:
    """A table after the overrides, and each override as a text of its own, in the order given."""

    table: TomlTable
    sources: tuple[Source, ...]
    changes: tuple[str, ...]


def apply_overrides(table: TomlTable, overrides: Sequence[str]) -> Overridden:
    """Lay `key=value` texts over a table; a whole table as value replaces the table.

    Values are TOML; a bare word stands for itself in quotes. Raises ProfileError with every malformed text.
    """
    sources: list[Source] = []
    lines: list[str] = []
    wrong: list[Diagnostic] = []
    for text in overrides:
        if _SITES.match(text.partition("=")[0]):
            message = f"cannot read --set {text}: sites is a list, and only the whole of it can be set"
            wrong.append(_diagnostic(text, message, _HINT_SITES))
            continue
        given = _parse(text)
        if given is None:
            message = f"cannot read --set {text}: it is not key=value with a TOML value"
            wrong.append(_diagnostic(text, message, decimal_comma(text.partition("=")[2]) or _HINT))
            continue
        path, value = given
        try:
            after = put(table, path, value)
        except KeyError as error:
            wrong.append(_diagnostic(text, f"--set {text}: {error.args[0]} is a value, not a table"))
            continue
        lines += changes(table, after, SET_OPTION)
        table = after
        sources.append(Source(SET_OPTION, text))
    if wrong:
        raise ProfileError(tuple(wrong))
    return Overridden(table, tuple(sources), tuple(lines))


def _parse(text: str) -> tuple[tuple[str, ...], object] | None:
    """Key path and value, or None when the text is not `key=value`."""
    key, _, value = text.partition("=")
    path = _key_path(key)
    value = value.strip()
    if not path or not value or "\n" in text:
        return None
    try:
        return path, tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):
        return (path, value) if _BARE_WORD.fullmatch(value) else None


def _key_path(key: str) -> tuple[str, ...]:
    """The parts of a dotted key; none when it is not one."""
    try:
        below: object = tomllib.loads(f"{key} = 0")
    except (ValueError, RecursionError):
        return ()
    path: tuple[str, ...] = ()
    while isinstance(below, dict) and len(below) == 1:
        ((part, below),) = below.items()
        path = (*path, part)
    return path if len(path) <= _DEEPEST else ()


def _diagnostic(text: str, message: str, hint: str = _HINT) -> Diagnostic:
    return Diagnostic(Code.OVERRIDE, message, hint, Location(SET_OPTION, 1, 1, max(1, len(text)), text))
