"""Virtual time and a host that waits: how far the clock goes on before the host gets to see what came."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.simulator.plant_interface import TICK_S

if TYPE_CHECKING:
    from edmctl.simulator.controller import VirtualController

ANSWERS_PER_TICK = 8


class HostWait:
    """Lets time pass for a host that waits.

    The controller answers commands at once, without time. So that a host which asks again and again cannot stop the
    clock, a millisecond passes after every eight answers.
    """

    def __init__(self, controller: VirtualController) -> None:
        self._controller = controller
        self._answers = 0

    def wait(self, timeout_s: float) -> None:
        """Let up to `timeout_s` pass: nothing where an answer is there already, else whole milliseconds."""
        urgent = self._controller.port.urgent
        if urgent and self._answers < ANSWERS_PER_TICK:
            self._answers += 1
            return
        self._answers = 0
        self._controller.advance(1 if urgent else max(1, math.floor(timeout_s / TICK_S + 0.5)))
