"""Reading TOML files: the text verbatim, syntax errors with their place, `extends`."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic, Location, ProfileError
from edmctl.files import read_bytes
from edmctl.profile.codes import Code
from edmctl.profile.merge import changes, extend
from edmctl.profile.shipped import find_shipped, is_file, shipped_names
from edmctl.profile.sources import Source, TomlTable

if TYPE_CHECKING:
    from pathlib import Path

MOST_PARENTS = 20
MOST_KEYS = 20_000
"""A thousand places with five keys each, and some more."""
MOST_PARTS = 32
_SYNTAX_PLACE = re.compile(
    r"(?P<what>.*) \(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)", re.DOTALL
)
_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){""" + str(MOST_PARTS) + "}")
_DECIMAL_COMMA = re.compile(r"\s*([+-]?\d+),(\d+)\s*(?:#.*)?")


@dataclass(frozen=True, slots=True)
class Chain:
    """A file and those it extends: texts from child to root, the merged table, what was overridden."""

    sources: tuple[Source, ...]
    table: TomlTable
    changes: tuple[str, ...]


def read_source(path: Path) -> Source:
    """Read a text file. Raises ProfileError when it cannot be read as UTF-8."""
    try:
        # Some editors put a mark of the byte order before the text.
        return Source(str(path), read_bytes(path).decode("utf-8").removeprefix("\ufeff"))
    except OSError as error:
        message, hint = f"cannot read {path}: {error.strerror}", "check the path and its permissions"
    except UnicodeDecodeError as error:
        message, hint = f"{path} is not UTF-8 text (byte {error.start})", "save it as UTF-8"
    raise _refusal(Code.UNREADABLE, message, hint)


def parse(source: Source) -> TomlTable:
    """Parse a TOML text. Raises ProfileError with the place of the syntax error, or for more than anybody writes."""
    long_key = _LONG_KEY.search(source.text)
    if long_key:
        line = source.text.count("\n", 0, long_key.start()) + 1
        message = f"a key has more than {MOST_PARTS} parts"
        raise _refusal(
            Code.SYNTAX, message, "tables stand at most three deep", Location(source.name, line, 1)
        )
    try:
        table = tomllib.loads(source.text)
        if _holds_more(table, MOST_KEYS):
            raise _refusal(Code.SYNTAX, f"{source.name} holds more than {MOST_KEYS} keys", "split it")
        return table
    except tomllib.TOMLDecodeError as error:
        where, what = _syntax_place(source, str(error))
    except (ValueError, RecursionError):
        where, what = source.start(), "a number is too long or values stand too deep in each other"
    hint = decimal_comma(where.source_line.partition("=")[2]) or (
        "texts stand in quotes, a table begins with [name], a key is given once"
    )
    raise _refusal(Code.SYNTAX, f"not TOML: {what}", hint, where)


def _holds_more(table: TomlTable, most: int) -> bool:
    """Whether the tables in a table, and those in lists, have more keys than that."""
    keys, left = 0, list[object]([table])
    while left and keys <= most:
        value = left.pop()
        if isinstance(value, dict):
            keys += len(value)
            left += value.values()
        elif isinstance(value, list):
            left += value
    return keys > most


def decimal_comma(value: str) -> str:
    """What to write instead of a number with a decimal comma; nothing for any other text."""
    number = _DECIMAL_COMMA.fullmatch(value)
    return f"a number has a decimal point, not a comma: {number[1]}.{number[2]}" if number else ""


def read_chain(path: Path) -> Chain:
    """Read a profile and, through `extends`, its parents. Raises ProfileError, also for a circle."""
    return _read_chain(path, ())


def _read_chain(path: Path, children: tuple[Path, ...]) -> Chain:
    source = read_source(path)
    own = parse(source)
    if "extends" not in own:
        return Chain((source,), own, ())
    seen = (*children, path.resolve())
    if len(seen) > MOST_PARENTS:
        message = f"more than {MOST_PARENTS} profiles extend one another"
        raise _refusal(Code.EXTENDS, message, "put them together", source.value(("extends",)))
    below = _read_chain(_parent(source, own.pop("extends"), path, seen), seen)
    merged = extend(below.table, own)
    changed = (*below.changes, *changes(below.table, merged, path.name))
    return Chain((source, *below.sources), merged, changed)


def _parent(source: Source, name: object, path: Path, seen: tuple[Path, ...]) -> Path:
    where = source.value(("extends",))
    if not isinstance(name, str):
        hint = 'write extends = "other.toml"'
        raise _refusal(Code.EXTENDS, "extends does not name a file", hint, where)
    beside = path.parent / name
    parent = beside if is_file(beside) else find_shipped(name)
    if parent is None:
        hint = f"the name is relative to this file, or one of {', '.join(shipped_names())}"
        raise _refusal(Code.EXTENDS, f"extends names {name}, and there is no file {beside}", hint, where)
    if parent.resolve() in seen:
        circle = " -> ".join(p.name for p in (*seen, parent.resolve()))
        raise _refusal(
            Code.EXTENDS, f"profiles extend each other in a circle: {circle}", "break it here", where
        )
    return parent


def _refusal(code: Code, message: str, hint: str, where: Location | None = None) -> ProfileError:
    return ProfileError((Diagnostic(code, message, hint, where),))


def _syntax_place(source: Source, message: str) -> tuple[Location, str]:
    """Location in a syntax error's message; at the end of the document it is the last line's end."""
    match = _SYNTAX_PLACE.match(message)
    lines = source.text.split("\n")
    if match and match["line"]:
        line, column = int(match["line"]), int(match["column"])
    else:
        line, column = len(lines), len(lines[-1]) + 1
    what = match["what"] if match else message
    source_line = lines[line - 1].rstrip("\r") if line <= len(lines) else ""
    return Location(source.name, line, column, 1, source_line), what
