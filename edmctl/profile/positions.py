"""Where every key and value of a profile is written: the file, the files it extends, the command line.

`tomllib` gives values without positions. The scanner here walks a text that `tomllib` has accepted and notes the
span of each key and value under its path; list items and entries of arrays of tables have their index in the
path. It runs only when there is something to point at.
"""

from __future__ import annotations

import re
import tomllib
from functools import cached_property
from typing import TypeAlias

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


@dataclass(frozen=True, slots=True)
class Entry:
    """Spans of a key (none for a list item) and of its value; a table's value is its header's key."""

    key: Span | None
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
        while not self._finished():
            if self.text[self.at] == "[":
                table = self._header()
            else:
                self._assignment(table)

    def _finished(self) -> bool:
        self._skip(_BLANK)
        return self.at >= len(self.text)

    def _skip(self, pattern: re.Pattern[str]) -> None:
        match = pattern.match(self.text, self.at)
        self.at = match.end() if match else self.at

    def _header(self) -> KeyPath:
        is_array = self.text.startswith("[[", self.at)
        self.at += 2 if is_array else 1
        self._skip(_SPACE)
        start = self.at
        parts = self._dotted_key()
        end = parts[-1][1][1]
        self._skip(_SPACE)
        self.at += 2 if is_array else 1
        names = [name for name, _ in parts]
        path = (*self._inside(names[:-1]), names[-1])
        self._note_parents(parts[:-1])
        if is_array:
            self.entries.setdefault(path, Entry((start, end), (start, end)))
            index = self.array_sizes.get(path, 0)
            self.array_sizes[path] = index + 1
            path = (*path, index)
        self.entries[path] = Entry((start, end), (start, end))
        return path

    def _note_parents(self, parts: list[tuple[str, Span]]) -> None:
        for count in range(1, len(parts) + 1):
            span = parts[count - 1][1]
            self.entries.setdefault(self._inside([name for name, _ in parts[:count]]), Entry(span, span))

    def _inside(self, names: list[str]) -> KeyPath:
        """Path of a header's table: within an array of tables it is the latest entry."""
        path: KeyPath = ()
        for name in names:
            path = (*path, name)
            if path in self.array_sizes:
                path = (*path, self.array_sizes[path] - 1)
        return path

    def _dotted_key(self) -> list[tuple[str, Span]]:
        parts = [self._simple_key()]
        while True:
            self._skip(_SPACE)
            if not self.text.startswith(".", self.at):
                return parts
            self.at += 1
            self._skip(_SPACE)
            parts.append(self._simple_key())

    def _simple_key(self) -> tuple[str, Span]:
        start = self.at
        if self.text[start] in "\"'":
            self._string()
            raw = self.text[start : self.at]
            return str(tomllib.loads(f"key = {raw}")["key"]), (start, self.at)
        self._skip(_BARE_KEY)
        return self.text[start : self.at], (start, self.at)

    def _string(self) -> None:
        for pattern in _STRINGS:
            match = pattern.match(self.text, self.at)
            if match:
                self.at = match.end()
                return

    def _assignment(self, table: KeyPath) -> None:
        parts = self._dotted_key()
        path = table
        for name, span in parts[:-1]:
            path = (*path, name)
            self.entries.setdefault(path, Entry(span, span))
        name, span = parts[-1]
        path = (*path, name)
        self._skip(_SPACE)
        self.at += 1
        self._skip(_SPACE)
        self.entries[path] = Entry(span, self._value(path))

    def _value(self, path: KeyPath) -> Span:
        start = self.at
        first = self.text[start : start + 1]
        if first == "[":
            self._items(path)
        elif first == "{":
            self._inline_table(path)
        elif first in ("'", '"'):
            self._string()
        else:
            self._skip(_BARE_VALUE)
            self.at = start + len(self.text[start : self.at].rstrip())
        return start, self.at

    def _items(self, path: KeyPath) -> None:
        self.at += 1
        index = 0
        while True:
            self._skip(_BLANK)
            if self.text[self.at] == "]":
                break
            item = (*path, index)
            self.entries[item] = Entry(None, self._value(item))
            index += 1
            self._skip(_BLANK)
            if self.text[self.at] == ",":
                self.at += 1
        self.at += 1

    def _inline_table(self, path: KeyPath) -> None:
        self.at += 1
        while True:
            self._skip(_BLANK)
            if self.text[self.at] == "}":
                break
            self._assignment(path)
            self._skip(_BLANK)
            if self.text[self.at] == ",":
                self.at += 1
        self.at += 1


@dataclass(frozen=True)
class Source:
    """One TOML text. Positions are looked up late, only when something is wrong."""

    name: str
    text: str

    @cached_property
    def _entries(self) -> dict[KeyPath, Entry]:
        return scan(self.text)

    def key(self, path: KeyPath) -> Location | None:
        """Location of a key, or None when this text does not hold it."""
        entry = self._entries.get(path)
        if entry is None:
            return None
        return location(self.name, self.text, entry.key or entry.value)

    def value(self, path: KeyPath) -> Location | None:
        """Location of a value, or None when this text does not hold it."""
        entry = self._entries.get(path)
        return None if entry is None else location(self.name, self.text, entry.value)

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
        for size in range(len(path), 0, -1):
            for source in self.texts:
                found = source.key(path[:size])
                if found is not None:
                    return found
        return self.file.start()

    def value(self, path: KeyPath) -> Location:
        """Location of a value; where it is written nowhere, of the nearest table around it."""
        for source in self.texts:
            found = source.value(path)
            if found is not None:
                return found
        return self.key(path)
