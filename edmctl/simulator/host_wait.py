"""Lets virtual time pass for a host that waits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from edmctl.simulator.plant_interface import TICK_S

ANSWERS_PER_TICK = 100


class Answering(Protocol):
    """An end of the line."""

    @property
    def urgent(self) -> bool:
        """Whether somebody waits for what is to be sent."""


class HostWait:
    """Lets time pass for a host that waits.

    The controller answers commands at once, without time. So that a host which asks again and again cannot stop the
    clock, a millisecond passes after a hundred answers. No job asks so much without waiting.

    A wait that ends early has something for the host to see at once. Where that comes in the last millisecond of a
    wait, the next one ends without time.
    """

    def __init__(self, link: Answering, advance: Callable[[int], int]) -> None:
        self._link, self._advance = link, advance
        self._answers = 0
        self._came_last = False

    def wait(self, timeout_s: float) -> None:
        """Let up to `timeout_s` pass: nothing where an answer is there already, else whole milliseconds."""
        urgent = self._link.urgent or self._came_last
        self._came_last = False
        if urgent and self._answers < ANSWERS_PER_TICK:
            self._answers += 1
            return
        self._answers = 0
        ticks = 1 if urgent else max(1, math.floor(timeout_s / TICK_S + 0.5))
        self._came_last = self._advance(ticks) == ticks and self._link.urgent
