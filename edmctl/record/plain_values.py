"""Records out of the plain values that JSON has: of journals, ledgers, series, run files."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from edmctl.results.job import SiteResult

T = TypeVar("T")
_LARGEST_INT = 1 << 1000
"""A float holds it."""


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def record_of(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return the record whose fields are kept as plain values, as JSON has them: None for a float is NaN.

    Raises TypeError or ValueError if the values are not those of such a record.
    """
    hints = _hints(kind)  # type: ignore[arg-type]
    if unknown := values.keys() - hints.keys():
        raise TypeError(f"{kind.__name__} has no {', '.join(sorted(map(str, unknown)))}")
    return kind(**{name: _typed(hints[name], value, name) for name, value in values.items()})


def _typed(kind: Any, value: Any, name: str) -> Any:
    """Return a plain value as the type of its field. Raises TypeError or ValueError for another one."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is UnionType:
        one = next(one for one in parts if one is not NoneType)
        return None if value is None else _typed(one, value, name)
    if origin is tuple and isinstance(value, list | tuple):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        return tuple(_typed(one, part, name) for one, part in zip(kinds, value, strict=True))
    if origin is Mapping and isinstance(value, Mapping):
        return {str(key): _typed(parts[1], part, name) for key, part in value.items()}
    if kind is object:
        return value
    if kind is float and value is None:
        return math.nan
    if kind is float and type(value) is int and abs(value) < _LARGEST_INT:
        return float(value)
    if dataclasses.is_dataclass(kind) and isinstance(value, Mapping):
        return record_of(kind, value)  # type: ignore[arg-type]
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise TypeError(f"{name} is no {getattr(kind, '__name__', kind)}")
    return value


def site_result_of(mapping: Mapping[str, object]) -> SiteResult:
    """Return the result that a journal has kept, estimated if without a basis. Raises TypeError for other values."""
    return record_of(SiteResult, {"depth_basis": "estimated", "wear_basis": "estimated"} | dict(mapping))
