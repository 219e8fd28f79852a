"""Plain values as TOML."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import date, time
from typing import TypeAlias

Scalar: TypeAlias = bool | int | float | str


def toml_scalar(value: Scalar) -> str:
    """Return a scalar as TOML writes it; a JSON string is a TOML basic string."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    # A float of numpy is a float, but says so in its representation.
    return repr(float(value)) if isinstance(value, float) else repr(value)


def toml_tables(tables: Mapping[str, Mapping[str, Scalar]]) -> str:
    """Return tables of scalars as TOML."""
    blocks = (
        "\n".join([f"[{name}]", *(f"{key} = {toml_scalar(value)}" for key, value in values.items())])
        for name, values in tables.items()
    )
    return "\n\n".join(blocks)


def toml_value(value: object) -> str:
    """Return a scalar, a date or time, a scalar of numpy, a sequence or a mapping as TOML writes it in one line.

    Raises TypeError for anything else.
    """
    if isinstance(value, bool | int | float | str):
        return toml_scalar(value)
    if isinstance(value, date | time):
        return str(value)
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {toml_value(one)}' for key, one in value.items())}}}"
    if isinstance(value, Sequence):
        return f"[{', '.join(toml_value(one) for one in value)}]"
    if hasattr(value, "tolist"):
        return toml_value(value.tolist())
    raise TypeError(f"{type(value).__name__} has no TOML form")
