"""What happens to a served machine: said as it happens, and kept for the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.link.faults import FAULTS
from edmctl.simulator.plant_interface import TICK_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.simulator.bench import VirtualBench


class News:
    """Call it often: it says which injections and faults are new.

    rested : called when a machine that was armed is not any more.
    faults : codes of the faults latched since the start, in order.
    """

    def __init__(
        self, bench: VirtualBench, say: Callable[[str], None], rested: Callable[[], None] = lambda: None
    ) -> None:
        self._controller = bench.controller
        self._say, self._rested = say, rested
        self._injected = 0
        self._fault = self._controller.fault
        self._armed = False
        self.faults: list[int] = []
        if self._fault:
            say(f"{_fault_words(self._fault)} is latched from before")

    def __call__(self) -> None:
        """Say what is new."""
        controller = self._controller
        applied = controller.injector.applied
        for injection, tick in applied[self._injected :]:
            self._say(f"{tick * TICK_S:.3f} s: {injection} happened")
        self._injected = len(applied)
        if controller.fault != self._fault:
            old, self._fault = self._fault, controller.fault
            if self._fault:
                self.faults.append(self._fault)
            words = f"{_fault_words(self._fault)} latched" if self._fault else f"{_fault_words(old)} cleared"
            since = controller.black_box.frozen_tick if self._fault else None
            self._say(f"{(since or controller.tick) * TICK_S:.3f} s: {words}")
        was_armed, self._armed = self._armed, controller.armed
        if was_armed and not self._armed:
            self._rested()


def _fault_words(code: int) -> str:
    return f"fault {code} {FAULTS[code].name}"
