"""Events as everyone reads them from a run file."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record.reader import RecordedCode, recorded_events

if TYPE_CHECKING:
    from edmctl.record.reader import RunFile

EVENTS = np.array(
    [
        (1.0, int(RecordedCode.JUMP_DONE), 0, b"Jumped.", b'{"height_um": 60.5, "asked": true}'),
        (2.0, 32000, 2, "Half a \u00b5".encode()[:-1], b'{"code": "E6'),
        (3.0, int(RecordedCode.SITE_MEASURED), 1, b"Measured.", b""),
    ],
    [("time", "f8"), ("code", "i4"), ("level", "i4"), ("message", "S40"), ("args", "S60")],
)


class Held:
    """As much of a run file as events are read from."""

    def table(self, path: str, start: int = 0) -> np.ndarray:
        assert path == "/entry/events"
        return EVENTS[start:]


def run() -> RunFile:
    return Held()  # type: ignore[return-value]


def test_an_event_whose_texts_were_damaged_still_happened() -> None:
    jumped, damaged, measured = recorded_events(run())
    assert (jumped.code, jumped.number("height_um"), jumped.message) == (
        RecordedCode.JUMP_DONE,
        60.5,
        "Jumped.",
    )
    assert (damaged.code, damaged.level, damaged.message, damaged.values) == (32000, 2, "Half a ", {})
    assert math.isnan(measured.number("depth_um"))
    assert math.isnan(jumped.number("asked")) is False


def test_only_what_is_wanted_is_told_and_from_the_row_that_is_asked_for() -> None:
    assert [
        event.time_s for event in recorded_events(run(), RecordedCode.SITE_MEASURED, RecordedCode.JUMP_DONE)
    ] == [1.0, 3.0]
    assert [event.time_s for event in recorded_events(run(), start=1)] == [2.0, 3.0]
