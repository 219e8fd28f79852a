"""The state of a running job, and who is told of it."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Protocol

from edmctl.dataclasses import dataclass
from edmctl.results.telemetry import PulseShares


class Phase(StrEnum):
    """What the job is doing."""

    CONDITIONING = "conditioning"
    CALIBRATING = "calibrating"
    MOVING = "moving"
    MEASURING = "measuring"
    APPROACHING = "approaching"
    MACHINING = "machining"
    JUMPING = "jumping"
    RETRACTING = "retracting"


@dataclass(slots=True)
class Progress:
    """The state of a job, 10 Hz on a live line, 2 Hz in virtual time.

    Unknown values are NaN, unknown numbers 0, unknown words empty.

    `depth_um` is estimated while a cut runs, with the half-width `depth_u95_um` of its 95 % interval; so is the
    wear. `feed_um` is their sum; `feed_target_um` is what the job wants of it where it wants no depth. `step` is
    the cut or pass under way, and `jumps` were made in it, the last one at `last_jump_s`.

    `sites_done` of `sites_total` places are finished. `warning` is the newest one, reported at `warned_s`.
    """

    phase: Phase
    time_s: float
    gap_v: float
    reference_v: float
    ratios: PulseShares
    depth_um: float
    depth_target_um: float
    displacement_um: float
    time_left_s: float
    depth_u95_um: float = math.nan
    site: str = ""
    step: str = ""
    feed_um: float = math.nan
    feed_target_um: float = math.nan
    feed_um_s: float = math.nan
    wear_um: float = math.nan
    wear_u95_um: float = math.nan
    jumps: int = 0
    jump_period_s: float = math.nan
    last_jump_s: float = math.nan
    sites_done: int = 0
    sites_total: int = 0
    warning: str = ""
    warned_s: float = math.nan


class Observer(Protocol):
    """Who watches a job for a person."""

    def progress(self, p: Progress) -> None:
        """Take the newest state; called often, may drop."""

    def note(self, text: str) -> None:
        """Take one line about a decision or a result."""


class SeriesObserver(Observer, Protocol):
    """Is told how many runs of a series are done as well."""

    def runs(self, done: int, total: int) -> None:
        """`done` of `total` runs are finished."""
        ...
