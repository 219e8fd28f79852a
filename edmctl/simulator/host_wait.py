"""Lets virtual time pass for a host that waits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from edmctl.simulator.plant_interface import TICK_S

ANSWERS_PER_TICK = 8


class Answering(Protocol):
    """An end of the line."""

    @property
    def urgent(self) -> bool:
        """Whether somebody waits for what is to be sent."""


class HostWait:
    """Lets time pass for a host that waits.

    The controller answers commands at once, without time. So that a host which asks again and again cannot stop the
    clock, a millisecond passes after every eight answers.
    """

    def __init__(self, link: Answering, advance: Callable[[int], None]) -> None:
        self._link, self._advance = link, advance
        self._answers = 0

    def wait(self, timeout_s: float) -> None:
        """Let up to `timeout_s` pass: nothing where an answer is there already, else whole milliseconds."""
        urgent = self._link.urgent
        if urgent and self._answers < ANSWERS_PER_TICK:
            self._answers += 1
            return
        self._answers = 0
        self._advance(1 if urgent else max(1, math.floor(timeout_s / TICK_S + 0.5)))
