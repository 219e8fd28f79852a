"""The JSON object of a result: on stdout with numbers rounded by the unit in their key, in a run file exact.

Keys have a fixed order, and a rounded result is the same bytes on every machine.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import TypeAlias

JsonValue: TypeAlias = "bool | int | float | str | list[JsonValue] | dict[str, JsonValue] | None"

SCHEMA = "edmctl-result/1"

# One nanometre and one millisecond lie well below what the machine can tell apart; delays and lags are of that
# order.
_DECIMALS_BY_UNIT = {"delay_s": 6, "lag_s": 6, "_um_per_s": 6, "_um_s": 4, "_um": 3, "_s": 3, "_v": 4}
_SIGNIFICANT = 6


def to_json_value(value: object, key: str = "", *, is_exact: bool = False) -> JsonValue:
    """Turn dataclasses, mappings, sequences and scalars into plain JSON values.

    Unless `is_exact`, lengths (`_um`) and times (`_s`) keep three decimals, other floats six significant digits.
    What is not finite becomes null. Raises TypeError for anything else.
    """
    if value is None or isinstance(value, bool | str):
        return str(value) if isinstance(value, Enum) else value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return float(value) if is_exact else _rounded(float(value), key)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): to_json_value(v, str(k), is_exact=is_exact) for k, v in value.items()}
    if isinstance(value, Sequence):
        return [to_json_value(item, key, is_exact=is_exact) for item in value]
    raise TypeError(f"{type(value).__name__} has no JSON form")


def render_json(document: Mapping[str, object], *, is_exact: bool = False) -> str:
    """Return `document` as indented JSON text with a final newline."""
    plain = to_json_value(document, is_exact=is_exact)
    return json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def render_json_line(document: Mapping[str, object]) -> str:
    """Return `document` as one line of JSON with a final newline."""
    return json.dumps(to_json_value(document), ensure_ascii=False, allow_nan=False) + "\n"


def _rounded(value: float, key: str) -> float:
    for suffix, decimals in _DECIMALS_BY_UNIT.items():
        if key.endswith(suffix):
            return round(value, decimals) + 0.0
    return float(f"{value:.{_SIGNIFICANT}g}") + 0.0
