"""Tables of files: their form, what they permit at a key in words, and the units at the end of keys.

The key of a value is the only declaration of its unit: `diameter_um`, `speed_um_s`, `removal_um3_per_uj`. Modules of
tables do not postpone their annotations: pydantic would compile the text of each one.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import types
from collections.abc import Mapping, Sequence
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

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo


import math
import re
from typing import NamedTuple


class Unit(NamedTuple):
    """A unit: how keys and people write it, its dimension, and its size in SI units."""

    ending: str
    symbol: str
    dimension: str
    scale: float


_PREFIXES = {"n": ("n", 1e-9), "u": ("µ", 1e-6), "m": ("m", 1e-3), "": ("", 1.0)}
_BASES = {"m": "m", "s": "s", "v": "V", "a": "A", "j": "J"}
_SIMPLE = {
    prefix + base: Unit(prefix + base, prefix_symbol + symbol, symbol, scale)
    for base, symbol in _BASES.items()
    for prefix, (prefix_symbol, scale) in _PREFIXES.items()
}
_SIMPLE |= {
    unit.ending: unit
    for unit in (
        Unit("cm", "cm", "m", 1e-2),
        Unit("kv", "kV", "V", 1e3),
        Unit("hz", "Hz", "Hz", 1.0),
        Unit("khz", "kHz", "Hz", 1e3),
        Unit("mhz", "MHz", "Hz", 1e6),
        Unit("h", "h", "s", 3600.0),
        Unit("days", "days", "s", 86_400.0),
        Unit("deg", "°", "angle", math.pi / 180.0),
        Unit("mrad", "mrad", "angle", 1e-3),
        Unit("rad", "rad", "angle", 1.0),
        Unit("lpm", "L/min", "flow", 1.0),
        Unit("c", "°C", "temperature", 1.0),
        Unit("pct", "%", "", 0.01),
    )
}
_DIVISORS = {**_SIMPLE, "min": Unit("min", "min", "s", 60.0)}
"""Minutes are no unit at the end of a key: `duty_min` is a least duty."""
NO_UNIT = Unit("", "", "", 1.0)
_USUAL = {_SIMPLE[ending].dimension: _SIMPLE[ending] for ending in ("um", "v", "a", "hz")}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-zµμ°%][\w/³²√]*)\s*")
_SPELLINGS = str.maketrans({"µ": "u", "μ": "u", "/": "_", "³": "3", "²": "2", "°": "deg", "√": "sqrt_"})


def unit_of(ending: str) -> Unit | None:
    """Return the unit that keys write as `um`, `um_s`, `um_per_v` or `um3_per_uj`; None if it is none."""
    if ending in _SIMPLE:
        return _SIMPLE[ending]
    for separator in ("_per_", "_"):
        top, found, bottom = ending.partition(separator)
        over, under = _power(top, _SIMPLE), _power(bottom, _DIVISORS)
        if found and over and under:
            dimension = f"{over.dimension}/{under.dimension}"
            return Unit(ending, f"{over.symbol}/{under.symbol}", dimension, over.scale / under.scale)
    return None


def _power(ending: str, known: dict[str, Unit]) -> Unit | None:
    if ending.startswith("sqrt_") and (root := known.get(ending.removeprefix("sqrt_"))):
        return Unit(ending, f"√{root.symbol}", f"√{root.dimension}", math.sqrt(root.scale))
    base = known.get(ending.rstrip("23"))
    power = ending[-1:] if ending[-1:] in ("2", "3") else ""
    if base is None or not power:
        return base
    symbol = f"{base.symbol}{'²' if power == '2' else '³'}"
    return Unit(ending, symbol, base.dimension + power, base.scale ** int(power))


def split(key: str) -> tuple[str, Unit]:
    """Return a key without its unit, and the unit: the last part of the key that is one, and the longest."""
    parts = key.split("_")
    for end in range(len(parts), 1, -1):
        for start in range(1, end):
            if unit := unit_of("_".join(parts[start:end])):
                return "_".join((*parts[:start], *parts[end:])), unit
    return key, NO_UNIT


def quantity(value: object) -> tuple[float, Unit | None] | None:
    """Return number and unit of a text such as `20um`, `0.3 mm/min` or `55 %`, or a number and None; else None."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value), None
    match = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return None
    ending = "pct" if match[2] == "%" else match[2].lower().translate(_SPELLINGS)
    unit = unit_of(ending) or _DIVISORS.get(ending)
    return (float(match[1]), unit) if unit else None


def in_unit_of_key(key: str, number: float, unit: Unit) -> tuple[str, float] | None:
    """Return key, with the usual unit if it has none, and number as a file writes them; None if units differ."""
    own = split(key)[1]
    if own == NO_UNIT and (usual := _USUAL.get(unit.dimension)):
        own, key = usual, f"{key}_{usual.ending}"
    return (key, converted(number, unit, own)) if own.dimension == unit.dimension else None


def converted(number: float, unit: Unit, into: Unit) -> float:
    """Return a number in another unit, without the digits that the conversion adds; whole if it is whole."""
    rounded = float(f"{number * unit.scale / into.scale:.12g}")
    return int(rounded) if rounded.is_integer() else rounded


KeyPath: TypeAlias = tuple[str | int, ...]
TomlTable: TypeAlias = "dict[str, object]"
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


def content_hash(values: Mapping[str, object]) -> str:
    """SHA-256 of values as JSON: keys sorted, no spaces, ASCII, numbers as short as they are read back exactly."""
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


def fields_at(model: type[BaseModel], path: KeyPath) -> list[FieldInfo]:
    """The fields of a key path, one for each kind of its table. Items of a list share the list's field."""
    tables = [model]
    infos: list[FieldInfo] = []
    for part in path:
        if isinstance(part, str):
            infos = [field for table in tables if (field := _fields(table).get(part))]
            tables = [table for field in infos for table in _tables(field.annotation)]
    return infos


def field_at(model: type[BaseModel], path: KeyPath) -> FieldInfo | None:
    """The first of them; None where the model has none."""
    return next(iter(fields_at(model, path)), None)


def permitted_at(model: type[BaseModel], path: KeyPath) -> str:
    """What may be written at a key path, whichever of its tables is meant; empty where the model has no such key."""
    infos = fields_at(model, path)
    kinds = list(dict.fromkeys(kind for info in infos for kind in _described(info.annotation, info.metadata)))
    return " or ".join(kinds) if len(infos) > 1 and len(kinds) > 1 else permitted(infos[0]) if infos else ""


def accepts(model: type[BaseModel], path: KeyPath, value: object) -> bool:
    """Return whether a value may be written at a key path, whichever of its tables is meant."""
    for info in fields_at(model, path):
        annotation: Any = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
        with suppress(ValidationError):
            TypeAdapter(annotation).validate_python(value)
            return True
    return False


def choices_at(model: type[BaseModel], path: KeyPath) -> list[str]:
    """Words of which one may be written at a key path; empty where it takes a number or any text."""
    return list(dict.fromkeys(word for info in fields_at(model, path) for word in _choices(info.annotation)))


def _choices(annotation: object) -> list[str]:
    if annotation is bool:
        return ["true", "false"]
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [word for argument in get_args(annotation) for word in _choices(argument)]


def keys_at(model: type[BaseModel], path: KeyPath, written: object = None) -> list[str]:
    """Keys that the table at a path may hold, of the `kind` in `written` or of all kinds; empty without such a
    table.
    """
    tables = (
        [table for info in fields_at(model, path) for table in _tables(info.annotation)] if path else [model]
    )
    kind = written.get("kind") if isinstance(written, dict) else None
    for table in tables if isinstance(written, dict) else ():
        info = _fields(table).get("kind")
        if info and (kind in get_args(info.annotation) if kind is not None else not info.is_required()):
            return list(_fields(table))
    return list(dict.fromkeys(key for table in tables for key in _fields(table)))


def lists_tables(model: type[BaseModel], path: KeyPath) -> bool:
    """Whether the key is that of a list of tables."""
    return any(
        get_origin(info.annotation) is list and _tables(info.annotation) for info in fields_at(model, path)
    )


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


def permitted(info: FieldInfo) -> str:
    """What may be written: `a number from 20 to 1000 (diameter, µm)`."""
    kinds = " or ".join(_described(info.annotation, info.metadata))
    return f"{kinds} ({info.description})" if info.description else kinds


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    return {info.alias or name: info for name, info in model.model_fields.items()}


def _tables(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for argument in get_args(annotation) for table in _tables(argument)]


_PLAIN: dict[object, str] = {
    bool: "true or false",
    str: "text in quotes",
    int: "a whole number",
    float: "a number",
}
_ITEMS: dict[object, str] = {str: "texts in quotes", int: "whole numbers"}
_LIMITS = {"gt": " above", "ge": " from", "lt": " below", "le": " to", "multiple_of": ", a multiple of"}


def _described(annotation: object, metadata: Sequence[object] = ()) -> list[str]:
    """Return what may be written for each type of an annotation."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        limits = [m for limit in arguments[1:] for m in getattr(limit, "metadata", [limit])]
        return _described(arguments[0], limits)
    if origin is Literal:
        return [" or ".join(f'"{value}"' if isinstance(value, str) else str(value) for value in arguments)]
    if origin is list:
        item = (get_args(arguments[0]) or arguments)[0]
        return [f"a list of {'tables' if _tables(annotation) else _ITEMS.get(item, 'values')}"]
    if origin in (Union, types.UnionType):
        kinds = [one for one in arguments if one is not type(None)]
        return [text for kind in kinds for text in _described(kind, metadata)]
    bounds = {
        name: value
        for name in _LIMITS
        for item in metadata
        if annotation in (int, float) and (value := getattr(item, name, None)) is not None
    }
    limited = "".join(f"{_LIMITS[name]} {value:g}" for name, value in bounds.items())
    return [_PLAIN.get(annotation, "a table") + limited]
