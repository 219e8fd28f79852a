"""Where every key and value of a profile is written: the file, the files it extends, the command line.

`tomllib` gives values without positions. The scanner here walks a text that `tomllib` has accepted and notes the
span of each key and value under its path; list items and entries of arrays of tables have their index in the
path. It runs only when there is something to point at.
"""

from __future__ import annotations

import re
import tomllib
from functools import cached_property
from typing import NamedTuple, TypeAlias

from edmctl.dataclasses import dataclass, field
from edmctl.errors import Location

KeyPath: TypeAlias = tuple[str | int, ...]
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

TomlTable: TypeAlias = "dict[str, object]"
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
