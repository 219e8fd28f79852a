"""The events of a run file: their codes, and the states of the controller, by which figures look for them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from edmctl.record import layout

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.record.reader import RunFile


class State(IntEnum):
    """States of the controller, by the names of the protocol."""

    BOOT = 0
    IDLE = 1
    ARMED = 2
    APPROACH = 3
    MACHINING = 4
    JUMP = 5
    TOUCH = 6
    MOVING = 7
    FAULT = 8
    ESTOP = 9


class Told(IntEnum):
    """What an event of a run file tells: below 100 by the controller, else by procedures, who have more codes."""

    JUMP_DONE = 5
    TOUCH = 6
    FACE_FITTED = 112
    SITE_MEASURED = 130
    LEFT_UNMEASURED = 133
    SITE_ESTIMATED = 134
    ENDED_EARLY = 160
    JUMP_PERIOD = 161
    CHANNEL_MEASURED = 171


_KNOWN = {int(code): code for code in Told}


@dataclass(frozen=True, slots=True)
class Happened:
    """One event: when, its code (one of Told or another), level, sentence, and the numbers that it tells."""

    time_s: float
    told: int
    level: int
    message: str
    values: Mapping[str, object]

    def number(self, name: str) -> float:
        """Return one of its numbers; NaN where it has none of that name."""
        value = self.values.get(name, math.nan)
        return float(value) if isinstance(value, int | float) else math.nan


def happened(run: RunFile, *wanted: Told, start: int = 0) -> list[Happened]:
    """Return the events from row `start` on, as they were written; those of every code where none is wanted."""
    codes = {int(code) for code in wanted}
    return [
        Happened(
            float(row["time"]),
            _KNOWN.get(int(row["code"]), int(row["code"])),
            int(row["level"]),
            row["message"].decode(errors="ignore"),
            _values(row["args"]),
        )
        for row in run.table(layout.EVENTS.path, start)
        if not codes or int(row["code"]) in codes
    ]


def error_code_of(run: RunFile) -> str:
    """Code of the error that ended a run early; empty where none did, or the file does not tell."""
    ends = happened(run, Told.ENDED_EARLY)
    return str(ends[-1].values.get("code", "")) if ends else ""


def _values(utf8: bytes) -> Mapping[str, object]:
    """An event whose text was damaged still happened."""
    try:
        values = json.loads(utf8)
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}
