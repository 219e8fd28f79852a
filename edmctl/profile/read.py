"""Reading TOML: the text verbatim, syntax errors with their place, `extends` and `--set key=value` laid over it.

`tomllib` gives values without positions. The scanner here walks a text that `tomllib` has accepted and notes the
span of each key and value under its path; list items and entries of arrays of tables have their index in the path.
It runs only when there is something to point at.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from copy import deepcopy
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple, TypeAlias

from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import Diagnostic, Location, ProfileError, UsageError
from edmctl.failures import Code
from edmctl.files import read_bytes
from edmctl.profile.folders import find_profile
from edmctl.profile.tables import NO_UNIT, KeyPath, TomlTable, in_unit_of_key, quantity
from edmctl.toml_text import toml_value
from edmctl.wording import code_point, shortened

Span: TypeAlias = tuple[int, int]

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_BARE_VALUE = re.compile(r"[^,\]}#\r\n]*")
_STRINGS = (
    re.compile(r'"""(?:[^\\]|\\.)*?"{3,5}(?!")', re.DOTALL),
    re.compile(r"'''.*?'{3,5}(?!')", re.DOTALL),
    re.compile(r'"(?:[^"\\\n]|\\.)*"'),
    re.compile(r"'[^'\n]*'"),
)

SET_OPTION = "--set"


class Entry(NamedTuple):
    """Spans of a key and of its value; a list item has its value as key, a table its header's key as value."""

    key: Span
    value: Span


def scan(text: str) -> dict[KeyPath, Entry]:
    """Spans of every key and value of a valid TOML text, by path."""
    scanner = _Scanner(text)
    scanner.document()
    return scanner.entries


def location(file: str, text: str, span: Span) -> Location:
    """Line, column and length of a span; a span over several lines ends with its first."""
    start, end = span
    line_start = text.rfind("\n", 0, start) + 1
    line_end = text.find("\n", start)
    source_line = text[line_start : line_end if line_end >= 0 else len(text)].rstrip("\r")
    length = max(1, min(end, line_start + len(source_line)) - start)
    return Location(file, text.count("\n", 0, start) + 1, start - line_start + 1, length, source_line)


@dataclass(slots=True)
class _Scanner:
    text: str
    at: int = 0
    entries: dict[KeyPath, Entry] = field(default_factory=dict)
    array_sizes: dict[KeyPath, int] = field(default_factory=dict)

    def document(self) -> None:
        table: KeyPath = ()
        while self._next():
            if self._next() == "[":
                table = self._header()
            else:
                self._assignment(table)

    def _next(self, blank: re.Pattern[str] = _BLANK) -> str:
        """Skip blanks; return the next character, empty at the end."""
        self._skip(blank)
        return self.text[self.at : self.at + 1]

    def _skip(self, pattern: re.Pattern[str]) -> bool:
        match = pattern.match(self.text, self.at)
        self.at = match.end() if match else self.at
        return match is not None

    def _header(self) -> KeyPath:
        brackets = 2 if self.text.startswith("[[", self.at) else 1
        self.at += brackets
        self._skip(_SPACE)
        start = self.at
        *parents, (name, (_, end)) = self._dotted_key()
        self.at += brackets
        path: KeyPath = ()
        for parent, span in parents:
            path = self._latest((*path, parent))
            self.entries.setdefault(path, Entry(span, span))
        path, header = (*path, name), Entry((start, end), (start, end))
        if brackets == 2:
            self.entries.setdefault(path, header)
            self.array_sizes[path] = self.array_sizes.get(path, 0) + 1
            path = self._latest(path)
        self.entries[path] = header
        return path

    def _latest(self, path: KeyPath) -> KeyPath:
        """Path of the latest entry of an array of tables; that of any other table as it is."""
        return (*path, self.array_sizes[path] - 1) if path in self.array_sizes else path

    def _dotted_key(self) -> list[tuple[str, Span]]:
        parts = [self._simple_key()]
        while self._next(_SPACE) == ".":
            self.at += 1
            self._skip(_SPACE)
            parts.append(self._simple_key())
        return parts

    def _simple_key(self) -> tuple[str, Span]:
        start = self.at
        if self._string():
            raw = self.text[start : self.at]
            return str(tomllib.loads(f"key = {raw}")["key"]), (start, self.at)
        self._skip(_BARE_KEY)
        return self.text[start : self.at], (start, self.at)

    def _string(self) -> bool:
        return any(self._skip(pattern) for pattern in _STRINGS)

    def _assignment(self, table: KeyPath) -> None:
        path = table
        *parents, (name, span) = self._dotted_key()
        for parent, its_span in parents:
            path = (*path, parent)
            self.entries.setdefault(path, Entry(its_span, its_span))
        self.at += 1
        self._skip(_SPACE)
        path = (*path, name)
        self.entries[path] = Entry(span, self._value(path))

    def _value(self, path: KeyPath) -> Span:
        start = self.at
        if self.text[start : start + 1] in ("[", "{"):
            self._collection(path)
        elif not self._string():
            self._skip(_BARE_VALUE)
            self.at = start + len(self.text[start : self.at].rstrip())
        return start, self.at

    def _collection(self, path: KeyPath) -> None:
        """Note the items of a list or the keys of an inline table."""
        is_list = self.text[self.at] == "["
        self.at += 1
        index = 0
        while self._next() not in ("]", "}"):
            if is_list:
                value = self._value((*path, index))
                self.entries[*path, index] = Entry(value, value)
                index += 1
            else:
                self._assignment(path)
            if self._next() == ",":
                self.at += 1
        self.at += 1


@dataclass(frozen=True)
class Source:
    """One TOML text. Positions are looked up late, only when something is wrong."""

    name: str
    text: str

    @cached_property
    def entries(self) -> dict[KeyPath, Entry]:
        """Spans of all keys and values."""
        return scan(self.text)

    def value(self, path: KeyPath) -> Location:
        """Location of a value; where it is not written, the first character."""
        return Sources((self,), self).value(path)

    def start(self) -> Location:
        """The first character of the text."""
        return location(self.name, self.text, (0, 0))


@dataclass(frozen=True, slots=True)
class Sources:
    """All texts of a profile, those that prevail first: the latest `--set`, ..., the file, its parents."""

    texts: tuple[Source, ...]
    file: Source

    def key(self, path: KeyPath) -> Location:
        """Location of a key; where it is written nowhere, of the nearest table around it."""
        around = (self._written(path[:size]) for size in range(len(path), 0, -1))
        source, entry = next((one for one in around if one), (self.file, None))
        return location(source.name, source.text, entry.key) if entry else source.start()

    def value(self, path: KeyPath) -> Location:
        """Location of a value; where it is written nowhere, of the nearest table around it."""
        source, entry = self._written(path) or (self.file, None)
        return location(source.name, source.text, entry.value) if entry else self.key(path)

    def _written(self, path: KeyPath) -> tuple[Source, Entry] | None:
        return next(((one, one.entries[path]) for one in self.texts if path in one.entries), None)


MOST_PARENTS = 20
MOST_KEYS = 20_000  # a thousand places with five keys each, and some more
MOST_PARTS = 32
_SYNTAX_PLACE = re.compile(
    r"(?P<what>.*) \(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)", re.DOTALL
)
_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){""" + str(MOST_PARTS) + "}")
_DECIMAL_COMMA = re.compile(r"\s*([+-]?\d+),(\d+)\s*(?:#.*)?")
_STRING_OR_COMMENT = re.compile(r""""[^"]*"|'[^']*'|#.*""")
_BARE_WORD = re.compile(r"[A-Za-z][\w.+/ -]*")
_LONG = re.compile(r"[\dA-Fa-f_]{256}")
_SITES = re.compile(r"\s*sites\s*[.\[]")
_HINT_SITES = (
    "write all places, --set 'sites=[{x_um=600},{x_um=1000,y_um=400}]', or put them into the profile"
)
_HINT = "write --set servo.reference=0.82, with the value as in a file: 0.8 and not .8, text in quotes"


@dataclass(frozen=True, slots=True)
class Merged:
    """Texts laid over one another: those that prevail first, the merged table, and what each changed, in words."""

    sources: tuple[Source, ...]
    table: TomlTable
    changes: tuple[str, ...]


_source = lru_cache(maxsize=8)(Source)
"""A study reads one profile a thousand times: its positions are found once."""


def read_source(path: Path) -> Source:
    """Read a text file. Raises ProfileError when it cannot be read as UTF-8."""
    try:
        # Some editors put a mark of the byte order before the text.
        return _source(str(path), read_bytes(path).decode("utf-8").removeprefix("\ufeff"))
    except OSError as error:
        message, hint = f"cannot read {path}: {error.strerror}", "check the path and its permissions"
    except UnicodeDecodeError as error:
        message = f"{path} is not UTF-8 text (byte {error.start})"
        hint = "name a TOML file, saved as UTF-8 (`edmctl run show FILE` reads run files)"
    raise _refusal(Code.UNREADABLE, message, hint)


def parse(source: Source) -> TomlTable:
    """Parse a TOML text. Raises ProfileError with the place of the syntax error, or for more than anybody writes."""
    if long_key := _LONG_KEY.search(source.text):
        where, message = location(source.name, source.text, long_key.span()), f"more than {MOST_PARTS} parts"
        hint = "tables are at most three deep"
        raise _refusal(Code.SYNTAX, f"a key has {message}", hint, replace(where, column=1))
    try:
        table, keys = _loads(source.text)
        if keys > MOST_KEYS:
            raise _refusal(Code.SYNTAX, f"{source.name} holds more than {MOST_KEYS} keys", "split it")
        return deepcopy(table)
    except tomllib.TOMLDecodeError as error:
        where, what = _syntax_place(source, str(error))
    except (ValueError, RecursionError):
        where, what = source.start(), "a number is too long or values are nested too deeply"
    hint = _value_hint(where.source_line, where.column) or (
        "texts are in quotes, a table begins with [name], a key is given once"
    )
    raise _refusal(Code.SYNTAX, f"not TOML: {what}", hint, where)


@lru_cache(maxsize=64)
def _loads(text: str) -> tuple[TomlTable, int]:
    """Parse a TOML text, count its keys. Raises ValueError, also for an integer beyond any float; RecursionError."""
    table, keys = tomllib.loads(text), 0
    values: list[object] = [table]
    for value in values:  # which grows meanwhile
        if isinstance(value, dict):
            values += value.values()
            keys += len(value)
        elif isinstance(value, list):
            values += value
        elif isinstance(value, int) and abs(value) > sys.float_info.max:
            raise ValueError("a number is too long")
    return table, keys


def _value_hint(line: str, column: int = 1) -> str:
    """Return the remedy for a decimal comma, a unit behind a number, or a look-alike character; else an empty
    text.
    """
    key, _, value = line.partition("=")
    if number := _DECIMAL_COMMA.fullmatch(value):
        return f"a number has a decimal point, not a comma: {number[1]}.{number[2]}"
    if found := quantity(value.partition("#")[0]):
        number_of, unit = found
        fitting = in_unit_of_key(key.strip().rpartition(".")[2], number_of, unit or NO_UNIT)
        written = "{} = {:.12g}".format(*fitting) if fitting else "a number"
        return f"write {written}, without a unit: the unit is in the key"
    outside = _STRING_OR_COMMENT.sub("", line)
    for character in (line[column - 1 : column], *outside):
        if not character.isascii():
            return f"{code_point(character)} is not TOML here: write plain ASCII, and texts in quotes"
    return ""


def read_chain(path: Path, children: tuple[Path, ...] = ()) -> Merged:
    """Read a profile and, through `extends`, its parents. Raises ProfileError, also for a circle."""
    source = read_source(path)
    own = parse(source)
    if "extends" not in own:
        return Merged((source,), own, ())
    seen = (*children, path.resolve())
    if len(seen) > MOST_PARENTS:
        message = f"more than {MOST_PARENTS} profiles extend one another"
        raise _refusal(Code.EXTENDS, message, "put them together", source.value(("extends",)))
    below = read_chain(_parent(source, own.pop("extends"), path, seen), seen)
    merged = extend(below.table, own)
    changed = (*below.changes, *changes(below.table, merged, path.name))
    return Merged((source, *below.sources), merged, changed)


def _parent(source: Source, name: object, path: Path, seen: tuple[Path, ...]) -> Path:
    try:
        parent = find_profile(name, path.parent) if isinstance(name, str) else None
        if parent is None:
            message, hint = "extends does not name a file", 'write extends = "other.toml"'
        elif parent.resolve() not in seen:
            return parent
        else:
            circle = " -> ".join(one.name for one in (*seen, parent.resolve()))
            message, hint = f"profiles extend each other in a circle: {circle}", "break it here"
    except UsageError as error:
        message, hint = f"extends = {toml_value(name)}: {error.message}", error.hint
    raise _refusal(Code.EXTENDS, message, hint, source.value(("extends",)))


def _refusal(code: Code, message: str, hint: str, where: Location | None = None) -> ProfileError:
    return ProfileError((Diagnostic(code, message, hint, where),))


def _syntax_place(source: Source, message: str) -> tuple[Location, str]:
    """Return the location that a syntax error names; the last line's end for the end of the document."""
    match, lines = _SYNTAX_PLACE.match(message), source.text.split("\n")
    line, column = len(lines), len(lines[-1]) + 1
    if match and match["line"]:
        line, column = int(match["line"]), int(match["column"])
    what = match["what"] if match else message
    source_line = lines[line - 1].rstrip("\r") if line <= len(lines) else ""
    return Location(source.name, line, column, 1, source_line), what


def apply_overrides(below: Merged, overrides: Sequence[str]) -> Merged:
    """Lay `key=value` texts, values in TOML or bare words, over files. Raises ProfileError for malformed ones."""
    table, sources, lines = below.table, list(below.sources), list(below.changes)
    wrong: list[Diagnostic] = []
    for text in overrides:
        hint = _HINT
        try:
            if _SITES.match(text.partition("=")[0]):
                message, hint = "sites is a list, and only the whole of it can be set", _HINT_SITES
                raise KeyError(message)
            path, value = _parse(text)
            after = put(table, path, value)
        except ValueError:
            message = f"cannot read --set {shortened(text)}: it is not key=value with a TOML value"
            hint = "the number is too long" if _LONG.search(text) else _value_hint(text) or hint
        except KeyError as error:
            message = f"cannot use --set {text}: {error.args[0]}"
        else:
            lines += changes(table, after, SET_OPTION)
            table = after
            sources.insert(0, Source(SET_OPTION, text))
            continue
        where = Location(SET_OPTION, 1, 1, max(1, len(text)), text)
        wrong.append(Diagnostic(Code.OVERRIDE, message, hint, where))
    if wrong:
        raise ProfileError(tuple(wrong))
    return Merged(tuple(sources), table, tuple(lines))


def _parse(text: str) -> tuple[tuple[str, ...], object]:
    """Return key path and value. Raises ValueError when the text is not `key=value`."""
    key, _, value = text.partition("=")
    path, value = _key_path(key), value.strip(" \t")
    if not path or not value or "\n" in text:
        raise ValueError("no key or no value")
    try:
        return path, deepcopy(_loads(f"value = {value}")[0]["value"])
    except (ValueError, RecursionError):
        if _BARE_WORD.fullmatch(value):
            return path, value
        raise ValueError("no TOML value") from None


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
    return path if len(path) <= MOST_PARTS else ()


def dotted(path: KeyPath) -> str:
    """A key path as people write it: `servo.reference`, `sites[1].x_um`."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def extend(base: TomlTable, child: TomlTable) -> TomlTable:
    """The base with the child's keys laid over it; a table that states another `kind` replaces the base's whole."""
    merged = dict(base)
    for key, value in child.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            is_change = value.get("kind") in (None, below.get("kind"))
            value = extend(below, value) if is_change else value
        merged[key] = value
    return merged


def put(table: TomlTable, path: tuple[str, ...], value: object) -> TomlTable:
    """A copy of the table with one value set; raises KeyError where the path runs through a plain value."""
    if len(path) == 1:
        return {**table, path[0]: value}
    below = table.get(path[0], {})
    if not isinstance(below, dict):
        raise KeyError(f"{path[0]} is a value, not a table")
    return {**table, path[0]: put(below, path[1:], value)}


def changes(before: TomlTable, after: TomlTable, origin: str) -> Iterator[str]:
    """One line per value that differs: `servo.reference = 0.82 (was 0.8, --set)`."""
    old, new = dict(_leaves(before)), dict(_leaves(after))
    for path, value in new.items():
        if path not in old or old[path] != value:
            was = f"was {toml_value(old[path])}" if path in old else "was not given"
            yield f"{dotted(path)} = {toml_value(value)} ({was}, {origin})"
    for path in [path for path in old if path not in new]:
        yield f"{dotted(path)} removed (was {toml_value(old[path])}, {origin})"


def _leaves(table: TomlTable, prefix: KeyPath = ()) -> Iterator[tuple[KeyPath, object]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*prefix, key))
        else:
            yield (*prefix, key), value
