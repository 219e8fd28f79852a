"""The events of a run file: their codes, and the states of the controller, by which figures look for them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from enum import IntEnum

from edmctl.dataclasses import dataclass
from edmctl.record import layout
from edmctl.record.reader import RunFile


class RecordedState(IntEnum):
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


class RecordedCode(IntEnum):
    """Codes of events: below 100 those of the controller, else those of procedures, which have more."""

    JUMP_DONE = 5
    TOUCH = 6
    FACE_FITTED = 112
    CUT_PLANNED = 120
    SITE_MEASURED = 130
    LEFT_UNMEASURED = 133
    SITE_ESTIMATED = 134
    ENDED_EARLY = 160
    JUMP_PERIOD = 161
    CHANNEL_MEASURED = 171


_KNOWN = {int(code): code for code in RecordedCode}


@dataclass(frozen=True, slots=True)
class RecordedEvent:
    """One event: its time, code (a RecordedCode or another), level, sentence, and values."""

    time_s: float
    code: int
    level: int
    message: str
    values: Mapping[str, object]

    def number(self, name: str) -> float:
        """Return one of its numbers; NaN where it has none of that name."""
        value = self.values.get(name, math.nan)
        return float(value) if isinstance(value, int | float) else math.nan


def recorded_events(run: RunFile, *wanted: RecordedCode, start: int = 0) -> list[RecordedEvent]:
    """Return the events of the `wanted` codes, all where none is given, from row `start` on."""
    codes = {int(code) for code in wanted}
    return [
        RecordedEvent(
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
    """Return the code of the error that ended a run early; empty where none did, or the file has none."""
    ends = recorded_events(run, RecordedCode.ENDED_EARLY)
    return str(ends[-1].values.get("code", "")) if ends else ""


def _values(utf8: bytes) -> Mapping[str, object]:
    """The values of an event; none where their text is damaged."""
    try:
        values = json.loads(utf8)
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}
