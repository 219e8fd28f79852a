"""Where the values of a profile were written: the file, the files it extends, the command line."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

from edmctl.profile.locate import Entry, KeyPath, location, scan

if TYPE_CHECKING:
    from edmctl.errors import Location

TomlTable: TypeAlias = "dict[str, object]"

SET_OPTION = "--set"


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
