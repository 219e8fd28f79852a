"""TOML documents for the profile tests: the shipped ones, written with one thing changed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from edmctl.errors import Diagnostic, EdmError, ProfileError
from edmctl.planning.rules.load import LoadedProfile, load_profile
from edmctl.profile.folders import shipped_folder
from edmctl.profile.setup import Setup

NAMES = ("cu270", "cu150", "w252")
NEWER = ("array-3x3", "channel-rectangle", "channel-circle", "channel-spiral", "foil-through")

_TABLE = re.compile(r"^\[\[?(\w+)\]")
_KEY = re.compile(r'^(\w+)(\s*=\s*)("[^"]*"|[^#\s]+)')


@dataclass(frozen=True, slots=True)
class WrittenKey:
    """One `key = value` line of a shipped profile; line and columns count from 1."""

    table: str
    key: str
    value: str
    line: int
    value_column: int


def shipped_text(name: str) -> str:
    return (shipped_folder() / f"{name}.toml").read_text(encoding="utf-8")


def written_keys(text: str) -> list[WrittenKey]:
    """Every key of a profile, found by its line alone."""
    found, table = [], ""
    for number, line in enumerate(text.splitlines(), 1):
        if header := _TABLE.match(line):
            table = header[1]
        elif pair := _KEY.match(line):
            found.append(WrittenKey(table, pair[1], pair[3], number, pair.end(2) + 1))
    return found


def with_line(text: str, number: int, line: str) -> str:
    lines = text.split("\n")
    lines[number - 1] = line
    return "\n".join(lines)


def copy_shipped(folder: Path) -> None:
    """Copy the shipped profiles; each copy extends the copy beside it."""
    for name in (*NAMES, *NEWER):
        text = re.sub(r'extends = "(\w+)"', r'extends = "\1.toml"', shipped_text(name))
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")


def problems(name_or_path: str | Path, *overrides: str, setup: Setup | None = None) -> tuple[Diagnostic, ...]:
    """What loading reports: errors, or else warnings."""
    try:
        return load_profile(str(name_or_path), overrides, setup).warnings
    except ProfileError as error:
        return error.diagnostics


def place_of(found: Diagnostic | EdmError) -> tuple[str, int, int]:
    """Name of the file, line and column of a problem."""
    assert found.where is not None
    return Path(found.where.file).name, found.where.line, found.where.column


def marked(found: Diagnostic) -> str:
    """The text that a problem marks."""
    assert found.where is not None
    start = found.where.column - 1
    return found.where.source_line[start : start + found.where.length]


def loaded(*overrides: str) -> LoadedProfile:
    return load_profile("cu270", overrides)


def written(folder: Path, text: str) -> Path:
    """A file with this text."""
    path = folder / "p.toml"
    path.write_text(text, encoding="utf-8")
    return path
