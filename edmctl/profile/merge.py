"""Laying one table over another, and saying what that changed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from edmctl.profile.locate import KeyPath
    from edmctl.profile.sources import TomlTable


def toml_repr(value: object) -> str:
    """A value as TOML would write it, on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml_repr(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(toml_repr(item) for item in value) + "]"
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    return str(value)


def dotted(path: KeyPath) -> str:
    """A key path as people write it: `servo.reference`, `sites[1].x_um`."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def extend(base: TomlTable, child: TomlTable) -> TomlTable:
    """The base with the child's keys laid over it, table by table.

    A table that states its `kind` is another kind of thing, not a change of the base's: it replaces it whole.
    """
    merged = dict(base)
    for key, value in child.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict) and not _changes_kind(below, value):
            merged[key] = extend(below, value)
        else:
            merged[key] = value
    return merged


def _changes_kind(below: TomlTable, value: TomlTable) -> bool:
    return "kind" in value and value["kind"] != below.get("kind")


def put(table: TomlTable, path: tuple[str, ...], value: object) -> TomlTable:
    """A copy of the table with one value set; raises KeyError where the path runs through a plain value."""
    if len(path) == 1:
        return {**table, path[0]: value}
    below = table.get(path[0], {})
    if not isinstance(below, dict):
        raise KeyError(path[0])
    return {**table, path[0]: put(below, path[1:], value)}


def changes(before: TomlTable, after: TomlTable, origin: str) -> Iterator[str]:
    """One line per value that differs: `servo.reference = 0.82 (was 0.8, --set)`."""
    old, new = dict(_leaves(before)), dict(_leaves(after))
    for path, value in new.items():
        if path not in old:
            yield f"{dotted(path)} = {toml_repr(value)} (was not given, {origin})"
        elif old[path] != value:
            yield f"{dotted(path)} = {toml_repr(value)} (was {toml_repr(old[path])}, {origin})"
    for path in old.keys() - new.keys():
        yield f"{dotted(path)} removed (was {toml_repr(old[path])}, {origin})"


def _leaves(table: TomlTable, prefix: KeyPath = ()) -> Iterator[tuple[KeyPath, object]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*prefix, key))
        else:
            yield (*prefix, key), value
