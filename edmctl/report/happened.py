"""What the events of a run file tell, by their codes."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.record import layout

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.record.reader import RunFile
    from edmctl.record.told import Told


@dataclass(frozen=True, slots=True)
class Happened:
    """One event: when, and the numbers that it tells."""

    time_s: float
    told: Told
    values: Mapping[str, object]

    def number(self, name: str) -> float:
        """Return one of its numbers; NaN where it has none of that name."""
        value = self.values.get(name, math.nan)
        return float(value) if isinstance(value, int | float) else math.nan


def happened(run: RunFile, *wanted: Told) -> list[Happened]:
    """Return the events of the codes wanted, in order of time."""
    codes = {int(code): code for code in wanted}
    events = run.table(layout.EVENTS.path)
    return [
        Happened(float(row["time"]), codes[int(row["code"])], _values(row["args"]))
        for row in events
        if int(row["code"]) in codes
    ]


def _values(utf8: bytes) -> Mapping[str, object]:
    """An event whose text was damaged still happened."""
    try:
        values = json.loads(utf8)
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}
