"""Schema errors as diagnostics: code, place, remedy."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import islice
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic
from edmctl.failures import Code
from edmctl.profile.read import Sources, dotted
from edmctl.profile.tables import (
    NO_UNIT,
    KeyPath,
    TomlTable,
    Unit,
    accepts,
    converted,
    keys_at,
    lists_tables,
    nearest,
    permitted_at,
    quantity,
    split,
)
from edmctl.toml_text import toml_value
from edmctl.wording import shortened

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError
    from pydantic_core import ErrorDetails


_CODES = {
    "missing": Code.MISSING_KEY,
    "union_tag_not_found": Code.MISSING_KEY,
    "extra_forbidden": Code.UNKNOWN_KEY,
    "literal_error": Code.NOT_A_CHOICE,
    "union_tag_invalid": Code.NOT_A_CHOICE,
    "multiple_of": Code.NOT_A_MULTIPLE,
    "file_name": Code.UNREADABLE,
}
_OUT_OF_RANGE = re.compile("greater_than|less_than|finite_number|too_small|string_(too|pattern)")
"""Codes by the types of pydantic's errors; the others are wrong types."""
MOST_SHOWN = 100
_MOST_SPECIFIC = (Code.OUT_OF_RANGE, Code.NOT_A_CHOICE)
"""Of several complaints about one value (a choice or a number), the most specific comes first."""


def schema_problems(error: ValidationError, model: type[BaseModel], data: TomlTable) -> dict[KeyPath, Code]:
    """What is wrong, one code per wrong key or value."""
    by_path: dict[KeyPath, Code] = {}
    for detail in error.errors(include_url=False, include_context=False):
        path, kind = _path(detail, data), detail["type"]
        code = Code.OUT_OF_RANGE if _OUT_OF_RANGE.match(kind) else _CODES.get(kind, Code.WRONG_TYPE)
        if path == ("meta", "schema") and code != Code.MISSING_KEY:
            code = Code.SCHEMA_VERSION
        if path not in by_path or _rank(code) < _rank(by_path[path]):
            by_path[path] = code
        if kind.startswith("union_tag"):  # pydantic does not read a table of unknown kind
            table, written = path[:-1], _value(data, path[:-1])
            keys = written if isinstance(written, dict) else {}
            unknown = [key for key in keys if key not in keys_at(model, table)]
            by_path |= {(*table, key): Code.UNKNOWN_KEY for key in unknown}
    return by_path


def schema_diagnostics(
    problems: Mapping[KeyPath, Code], model: type[BaseModel], data: TomlTable, sources: Sources
) -> list[Diagnostic]:
    """One diagnostic per wrong key or value, in the order of the file; of very many only some, and their number."""
    some = list(islice(problems.items(), MOST_SHOWN))
    diagnostics = [_diagnostic(code, path, model, data, sources) for path, code in some]
    diagnostics.sort(
        key=lambda one: (one.where.file, one.where.line, one.where.column) if one.where else ("", 0, 0)
    )
    if more := len(problems) - len(some):
        message = f"{more} more keys or values are wrong"
        diagnostics.append(Diagnostic(diagnostics[-1].code, message, "correct these first"))
    return diagnostics


def _rank(code: Code) -> int:
    return _MOST_SPECIFIC.index(code) if code in _MOST_SPECIFIC else len(_MOST_SPECIFIC)


def _path(detail: ErrorDetails, data: TomlTable) -> KeyPath:
    path: KeyPath = ()
    here: object = data
    parts = detail["loc"]
    for i, part in enumerate(parts):
        if isinstance(here, dict) and part == here.get("kind") and i < len(parts) - 1:
            continue  # a branch of a union may be called as a wrong key is: kind = "depth", depth = 20
        if _holds(here, part):
            path, here = (*path, part), _item(here, part)
        elif not isinstance(here, dict):
            break
        elif i == len(parts) - 1 and detail["type"] == "missing":
            path = (*path, part)
    return (*path, "kind") if detail["type"].startswith("union_tag") else path


def _diagnostic(
    code: Code, path: KeyPath, model: type[BaseModel], data: TomlTable, sources: Sources
) -> Diagnostic:
    name, value = shortened(dotted(path)), _value(data, path)
    if code == Code.MISSING_KEY:
        hint = f"add the table {_header(path)}"
        if not keys_at(model, path):
            hint = f"add {path[-1]} to {_header(path[:-1])}: {permitted_at(model, path) or 'a value'}"
        return Diagnostic(code, f"{name} is missing", hint, sources.key(path[:-1]))
    if code == Code.UNKNOWN_KEY:
        return Diagnostic(code, f"unknown key {name}", _hint_unknown(path, model, data), sources.key(path))
    if code == Code.WRONG_TYPE and isinstance(value, dict) and lists_tables(model, path):
        message, hint = f"{name} is one table, not a list of tables", f"write [[{name}]]"
    else:
        message = f"{name} = {shortened(toml_value(value))} {_COMPLAINTS[code]}"
        allowed = permitted_at(model, path)
        hint = _hint_quantity(path, model, value, f"write {allowed}" if allowed else "")
    return Diagnostic(code, message, hint, sources.value(path))


_COMPLAINTS = {
    Code.WRONG_TYPE: "has the wrong type",
    Code.OUT_OF_RANGE: "is out of range",
    Code.NOT_A_CHOICE: "is not one of the choices",
    Code.NOT_A_MULTIPLE: "lies between two permitted steps",
    Code.UNREADABLE: "is no path: it is too long, or its home folder is unknown",
    Code.SCHEMA_VERSION: "is not a profile format that this version reads",
}


def _hint_unknown(path: KeyPath, model: type[BaseModel], data: TomlTable) -> str:
    table, key = path[:-1], str(path[-1])
    known, of_any_kind = keys_at(model, table, _value(data, table)), keys_at(model, table)
    if key in of_any_kind:
        return f"it does not go with this kind of {dotted(table)}: remove it, or change kind"
    if close := nearest(key, known) or nearest(key, of_any_kind):
        meant, value = (*table, close), _value(data, path)
        return _hint_quantity(meant, model, value, f"did you mean {close}?", split(key)[1])
    if home := next((name for name in keys_at(model, ()) if key in keys_at(model, (name,))), None):
        return f"{key} belongs to [{home}]"
    where = _header(table) if table else "the file"
    return f"remove it; {where} may hold {', '.join(known)}"


def _hint_quantity(
    path: KeyPath, model: type[BaseModel], value: object, hint: str, written: Unit = NO_UNIT
) -> str:
    """Return how to write a value with a unit of its own, or of the key that was written instead; else `hint`."""
    key, stated = str(path[-1]), quantity(value)
    unit = (stated[1] or written) if stated else NO_UNIT
    own = split(key)[1]
    if stated and unit.symbol and unit.dimension == own.dimension:
        in_unit = converted(stated[0], unit, own)
        if accepts(model, path, in_unit):
            return f"write {key} = {in_unit:g}"
    return hint


def _value(data: TomlTable, path: KeyPath) -> object:
    here: object = data
    for part in path:
        here = _item(here, part)
    return here


def _holds(value: object, part: str | int) -> bool:
    if isinstance(value, list):
        return isinstance(part, int) and 0 <= part < len(value)
    return isinstance(value, dict) and part in value


def _item(value: object, part: str | int) -> object:
    """Return an item of a table or list; None if there is none."""
    if isinstance(value, list) and isinstance(part, int):
        return value[part]
    return value.get(part) if isinstance(value, dict) else None


def _header(path: KeyPath) -> str:
    return f"[[{dotted(path[:-1])}]]" if path and isinstance(path[-1], int) else f"[{dotted(path)}]"
