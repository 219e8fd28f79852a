"""A profile of which some values could not be read, for the rules that do not need those.

A value that is wrong or missing is absent: asking for it raises AttributeError (see `lacks_value`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from pydantic import TypeAdapter

from edmctl.profile.codes import Code
from edmctl.profile.fields import keys_at, nearest
from edmctl.profile.model import DepthTarget, FeedTarget, Profile, ThroughTarget
from edmctl.profile.sites import SiteTable
from edmctl.profile.table import Table

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from edmctl.profile.locate import KeyPath
    from edmctl.profile.sources import TomlTable

_TARGETS: dict[object, type[Table]] = {"depth": DepthTarget, "feed": FeedTarget, "through": ThroughTarget}
_SITES = TypeAdapter(list[SiteTable])


def draft(table: TomlTable, problems: Mapping[KeyPath, Code]) -> Profile:
    """What can be read of a profile whose problems are these."""
    lacking = [lost for path, code in problems.items() if (lost := _lost(path, code, table))]
    tables: dict[str, Any] = {
        name: _read_table(name, written)
        for name in Profile.model_fields
        if isinstance(written := table.get(name), dict) and not _is_gone(name, lacking)
    }
    if "sites" in table and ("sites",) not in lacking:
        tables["sites"] = _SITES.validate_python(table["sites"])
    return without(Profile.model_construct(**tables), *lacking)


def without(profile: Profile, *paths: tuple[str, ...]) -> Profile:
    """A copy that lacks these tables (`("servo",)`) and values (`("servo", "reference")`)."""
    copy = profile.model_copy()
    for table, *keys in paths:
        if _is_gone(table, paths):
            copy.__dict__.pop(table, None)
        elif table in copy.__dict__:
            held = copy.__dict__[table].model_copy()
            held.__dict__.pop(keys[0], None)
            copy.__dict__[table] = held
    return copy


def lacks_value(error: AttributeError) -> bool:
    """Whether the error comes from asking a draft for a value that it lacks."""
    return isinstance(error.obj, Table) and error.name in type(error.obj).model_fields


def _read_table(name: str, written: TomlTable) -> Table:
    model = Profile.model_fields[name].annotation
    if name == "target":
        model = _TARGETS[written["kind"]]
    if not isinstance(model, type):
        model, _ = get_args(model)
    assert isinstance(model, type)
    assert issubclass(model, Table)
    values = {key: value for key, value in written.items() if key in keys_at(model, ())}
    return model.model_construct(_fields_set=set(values), **values)


def _is_gone(name: str, lacking: Collection[tuple[str, ...]]) -> bool:
    """Whether nothing of a table can be read: it is missing or no table, or a target of unknown kind."""
    return (name,) in lacking or (name == "target" and (name, "kind") in lacking)


def _lost(path: KeyPath, code: Code, table: TomlTable) -> tuple[str, ...] | None:
    """The table or value whose value a problem hides; None for an unknown key that stands for nothing."""
    if path[0] == "sites":
        return ("sites",)
    names = tuple(str(part) for part in path[:2])
    return _meant(names, table) if code == Code.UNKNOWN_KEY else names


def _meant(path: tuple[str, ...], table: TomlTable) -> tuple[str, ...] | None:
    """The key that an unknown one is a misspelling of, unless that is written too."""
    *above, key = path
    below: object = table
    for part in above:
        below = below.get(part) if isinstance(below, dict) else None
    close = nearest(key, keys_at(Profile, tuple(above)))
    is_written = isinstance(below, dict) and close in below
    return (*above, close) if close and not is_written else None
