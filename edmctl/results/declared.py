"""Declarations of result fields, once each: run file, its page, exported columns and JSON derive from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from edmctl.dataclasses import dataclass, field, fields

PURE = "1"
"""Unit of a pure number."""
TEXT = ""
"""Unit of a text."""
_ENDINGS = {"%": "pct", "L/min": "lpm", "degC": "c", "mm3/min": "mm3_min", "um/s": "um_s"}
GROUPS = (
    "place",
    "readings",
    "lengths",
    "lengths by voltage",
    "machining",
    "error of the model",
    "measurement",
    "uncertainty",
    "further",
)
"""Columns of the results table are in this order, and within a group in that of their declaration."""
ONLY_JSON = ""
"""Group of fields that the results table does not have."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """Unit, title, type and group of a field; `column` if the column's name does not follow from the field's.

    `nested` is the class of a value with columns of its own, whose names begin with `column`.
    """

    units: str
    title: str
    group: str
    dtype: str = "f8"
    column: str = ""
    nested: type | None = None


@dataclass(frozen=True, slots=True)
class StoredColumn:
    """A column of the results table; `source` is the name of its value, with a dot where that is nested."""

    name: str
    source: str
    quantity: Quantity


def quantity(
    units: str,
    title: str,
    group: str = "further",
    *,
    dtype: str = "f8",
    column: str = "",
    nested: type | None = None,
    **options: Any,
) -> Any:
    """Declare a field; `options` are those of `dataclasses.field`."""
    return field(metadata={"quantity": Quantity(units, title, group, dtype, column, nested)}, **options)


def um(title: str, group: str = "further", **options: Any) -> Any:
    """Declare a length in µm."""
    return quantity("um", title, group, **options)


def flag(title: str, group: str = "further", *, default: bool = False) -> Any:
    """Declare a yes or no."""
    return quantity(PURE, title, group, dtype="u1", default=default)


class Derived(property):
    """A property of a result that has a column of its own."""

    quantity: Quantity


def derived(units: str, title: str, group: str) -> Callable[[Callable[[Any], float]], Derived]:
    """Declare a property; in its group it comes before the fields."""

    def declare(compute: Callable[[Any], float]) -> Derived:
        declared = Derived(compute)
        declared.quantity = Quantity(units, title, group)
        return declared

    return declare


def quantities(kind: type) -> dict[str, Quantity]:
    """Return the declaration of each field of a result, by its name."""
    return {one.name: one.metadata["quantity"] for one in fields(kind) if "quantity" in one.metadata}


def stored_columns(kind: type) -> list[StoredColumn]:
    """Return the columns of the table for a kind of result or row."""
    return sorted(_columns(kind), key=lambda one: GROUPS.index(one.quantity.group))


def _columns(kind: type) -> Iterator[StoredColumn]:
    declared = {name: one.quantity for name, one in vars(kind).items() if isinstance(one, Derived)}
    for name, one in (declared | quantities(kind)).items():
        if one.group == ONLY_JSON:
            continue
        if one.nested is None:
            yield StoredColumn(one.column or _without_unit(name, one.units), name, one)
            continue
        for inner, part in quantities(one.nested).items():
            if part.group == ONLY_JSON:
                continue
            own = Quantity(part.units, part.title, one.group, part.dtype)
            column = part.column or _without_unit(inner, part.units)
            yield StoredColumn(f"{one.column}{column}", f"{name}.{inner}", own)


def ending_of(units: str) -> str:
    """Return the end of a name that stands for a unit; empty for pure numbers and texts."""
    return "" if units in (PURE, TEXT) else f"_{_ENDINGS.get(units, units.lower())}"


def _without_unit(name: str, units: str) -> str:
    return name.removesuffix(ending_of(units))


def shared(kind: type, source: Any) -> dict[str, Any]:
    """Return the values of `source` that have the names of fields of `kind`."""
    return {name: getattr(source, name) for name in _names_in_both(kind, source.__class__)}


@cache
def _names_in_both(kind: type, source: type) -> tuple[str, ...]:
    held = {*dir(source), *(one.name for one in fields(source))}
    return tuple(one.name for one in fields(kind) if one.name in held)
