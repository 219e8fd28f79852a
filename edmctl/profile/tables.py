"""What every table of a file is, and what it permits at a key: its type, its limits, its neighbours, in words.

Modules of tables do not postpone their annotations: pydantic would compile the text of each one.
"""

from __future__ import annotations

import difflib
import types
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    field_validator,
)
from pydantic_core import PydanticCustomError

from edmctl.errors import UsageError
from edmctl.files import user_path
from edmctl.profile.units import NO_UNIT, split

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from edmctl.profile.positions import KeyPath

ONE_LINE = r"^[^\x00-\x1f\x7f]*$"
"""No control characters: HDF5 texts end at a NUL, and a terminal obeys the others."""


def _possible(text: str) -> str:
    try:
        user_path(text)
    except UsageError as error:
        raise PydanticCustomError("file_name", "{message}", {"message": error.message}) from None
    return text


Line: TypeAlias = Annotated[str, Field(pattern=ONE_LINE)]
Name: TypeAlias = Annotated[str, Field(min_length=1, max_length=40, pattern=ONE_LINE)]
Coordinate: TypeAlias = Annotated[float, Field(ge=-1e6, le=1e6)]  # of the stages, µm
NAMES_FILE = "names a file"
"""Marks keys whose text `edmctl.files.user_path` makes a path of, relative to the file that has the key."""
FileName: TypeAlias = Annotated[
    str, Field(min_length=1, max_length=1000, pattern=ONE_LINE), AfterValidator(_possible), NAMES_FILE
]


LEAST = 1e-30  # of any number that is not zero, so that its powers and quotients are numbers too


def entry(default: Any, description: str, **limits: Any) -> Any:
    """Return the field of a key: its default (`...`: required), its meaning with the unit, its pydantic limits."""
    return Field(default, description=description, **limits)


class Table(BaseModel):
    """A table of a profile or setup file: closed, immutable, no silent conversions."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _no_denormal(cls, value: object) -> object:
        if isinstance(value, float) and 0.0 < abs(value) < LEAST:
            raise PydanticCustomError("too_small_to_divide_by", "no quantity is so small")
        return value


def field_at(model: type[BaseModel], path: KeyPath) -> FieldInfo | None:
    """The field of a key path, or None where the model has none. Items of a list share the list's field."""
    found = _fields_at(model, path)
    return found[0] if found else None


def _fields_at(model: type[BaseModel], path: KeyPath) -> list[FieldInfo]:
    tables = [model]
    found: list[FieldInfo] = []
    for part in path:
        if isinstance(part, int):
            continue
        found = [field for table in tables if (field := _fields(table).get(part))]
        tables = [table for field in found for table in _tables(field.annotation)]
    return found


def permitted_at(model: type[BaseModel], path: KeyPath) -> str:
    """What may be written at a key path, whichever of its tables is meant; empty where the model has no such key."""
    found = _fields_at(model, path)
    words = list(dict.fromkeys(word for info in found for word in _described(info.annotation, info.metadata)))
    return " or ".join(words) if len(found) > 1 and len(words) > 1 else permitted(found[0]) if found else ""


def accepts(model: type[BaseModel], path: KeyPath, value: object) -> bool:
    """Return whether a value may be written at a key path, whichever of its tables is meant."""
    for found in _fields_at(model, path):
        annotation: Any = Annotated[found.annotation, *found.metadata] if found.metadata else found.annotation
        with suppress(ValidationError):
            TypeAdapter(annotation).validate_python(value)
            return True
    return False


def choices_at(model: type[BaseModel], path: KeyPath) -> list[str]:
    """Words of which one may be written at a key path; empty where it takes a number or any text."""
    return list(dict.fromkeys(word for info in _fields_at(model, path) for word in _choices(info.annotation)))


def _choices(annotation: object) -> list[str]:
    if annotation is bool:
        return ["true", "false"]
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [word for argument in get_args(annotation) for word in _choices(argument)]


def keys_at(model: type[BaseModel], path: KeyPath) -> list[str]:
    """Keys that the table at a path may hold; empty when there is no such table."""
    tables = [model]
    if path:
        found = field_at(model, path)
        tables = _tables(found.annotation) if found else []
    return list(dict.fromkeys(key for table in tables for key in _fields(table)))


def keys_of_kind(model: type[BaseModel], path: KeyPath, written: object) -> list[str]:
    """Keys that a table written there may hold by its `kind`; those of all kinds where that is none of them."""
    found = field_at(model, path) if path else None
    kind = written.get("kind") if isinstance(written, dict) else None
    for table in _tables(found.annotation) if found else []:
        info = _fields(table).get("kind")
        if info and (kind in get_args(info.annotation) if kind is not None else not info.is_required()):
            return list(_fields(table))
    return keys_at(model, path)


def lists_tables(model: type[BaseModel], path: KeyPath) -> bool:
    """Whether the key stands for a list of tables."""
    found = field_at(model, path)
    return found is not None and get_origin(found.annotation) is list and bool(_tables(found.annotation))


def nearest(key: str, candidates: list[str]) -> str | None:
    """Return the candidate that is the key in another unit or is spelled most like it, of the same axis."""
    stem, unit = split(key)
    units = {name: split(name)[1] for name in candidates if split(name)[0] == stem}
    close = [name for name, own in units.items() if unit == NO_UNIT or own.dimension == unit.dimension]
    close = close or difflib.get_close_matches(key, candidates, n=len(candidates) or 1, cutoff=0.6)
    axis = _axis(key)
    return next((name for name in close if "" in (axis, _axis(name)) or axis == _axis(name)), None)


def _axis(key: str) -> str:
    word = key.lower().partition("_")[0]
    return word[-1] if word in ("x", "y", "z", "dx", "dy", "dz") else ""


def table_with_key(model: type[BaseModel], key: str) -> str | None:
    """The top-level table that has this key, for a key written into the wrong one."""
    return next((table for table in keys_at(model, ()) if key in keys_at(model, (table,))), None)


def permitted(found: FieldInfo) -> str:
    """What may be written: `a number from 20 to 1000 (diameter, µm)`."""
    words = " or ".join(_described(found.annotation, found.metadata))
    return f"{words} ({found.description})" if found.description else words


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    return {info.alias or name: info for name, info in model.model_fields.items()}


def _tables(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for argument in get_args(annotation) for table in _tables(argument)]


_ITEMS = {(str,): "texts in quotes", (int,): "whole numbers"}


def _described(annotation: object, metadata: list[object]) -> list[str]:
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *constraints = get_args(annotation)
        return _described(inner, [m for c in constraints for m in getattr(c, "metadata", [c])])
    if origin is Literal:
        return [" or ".join(f'"{v}"' if isinstance(v, str) else str(v) for v in get_args(annotation))]
    if origin is list:
        kinds = get_args(get_args(annotation)[0]) or get_args(annotation)
        items = "tables" if _tables(annotation) else _ITEMS.get(kinds, "values")
        return [f"a list of {items}"]
    if origin in (Union, types.UnionType):
        parts = [a for a in get_args(annotation) if a is not type(None)]
        return [words for part in parts for words in _described(part, metadata)]
    if annotation is bool:
        return ["true or false"]
    if annotation is str:
        return ["text in quotes"]
    if annotation is int or annotation is float:
        return [("a whole number" if annotation is int else "a number") + _limits(metadata)]
    return ["a table"]


def _limits(metadata: list[object]) -> str:
    bounds = {
        name: value
        for item in metadata
        for name in ("gt", "ge", "lt", "le")
        if (value := getattr(item, name, None)) is not None
    }
    words = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    text = "".join(f" {words[name]} {bounds[name]:g}" for name in words if name in bounds)
    steps = (step for item in metadata if (step := getattr(item, "multiple_of", None)) is not None)
    return text + "".join(f", a multiple of {step:g}" for step in steps)
