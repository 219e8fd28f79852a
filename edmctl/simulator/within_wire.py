"""What a controller tells of a value beyond its wire type: the limit of the type (docs/protocol.md, Messages)."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from edmctl.link.wire import NUMPY_CODES

if TYPE_CHECKING:
    from edmctl.link.wire import Message

_M = TypeVar("_M", bound="Message")


def within_wire(message: _M) -> _M:
    """Take every value to the limits of its wire type, what is no number to the least; returns the message."""
    for name, least, most in _limits(type(message)):  # type: ignore[arg-type]
        value = getattr(message, name)
        if not least <= value <= most:
            setattr(message, name, most if value > most else least)
    return message


@cache
def _limits(kind: type[Message]) -> tuple[tuple[str, float, float], ...]:
    """Name, least and greatest value of each field that is told in counts."""
    limits = []
    for field, wire in zip(fields(kind), kind.WIRE.split(), strict=True):
        type_, _, per_unit = wire.partition("/")
        if per_unit:
            info = np.iinfo(NUMPY_CODES[type_])
            limits.append((field.name, info.min / float(per_unit), info.max / float(per_unit)))
    return tuple(limits)
