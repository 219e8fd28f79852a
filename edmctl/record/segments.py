"""Pulse times without a time per pulse."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmctl.results.telemetry import PulseTrain

TIME_TOLERANCE_S = 2e-6
"""How far the start of a train may be from a segment's count: twice the LSB of a controller's time."""


@dataclass(frozen=True, slots=True)
class Segment:
    """Pulses from row `first_row` on: pulse first_row + i begins at start_s + i × period_s."""

    first_row: int
    first_pulse: int
    start_s: float
    period_s: float


class Segments:
    """Joins trains that follow each other without a gap into segments."""

    def __init__(self) -> None:
        self._current: Segment | None = None

    def follow(self, train: PulseTrain, row: int) -> Segment | None:
        """Return the segment that `train`, stored from `row` on, begins; None when it continues the last."""
        current = self._current
        if current is not None and self._continues(current, train, row):
            return None
        self._current = Segment(row, train.first_pulse, train.start_s, train.period_s)
        return self._current

    @staticmethod
    def _continues(current: Segment, train: PulseTrain, row: int) -> bool:
        passed = row - current.first_row
        return (
            train.period_s == current.period_s
            and train.first_pulse == current.first_pulse + passed
            and abs(current.start_s + passed * current.period_s - train.start_s) <= TIME_TOLERANCE_S
        )
