"""The virtual bench and the line to it. Time passes only while the host reads."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.errors import LinkLost
from edmctl.simulator.controller import VirtualController
from edmctl.simulator.kernel import TICK_S
from edmctl.simulator.plant import Plant

if TYPE_CHECKING:
    from edmctl.simulator.config import BenchConfig

ANSWERS_PER_TICK = 8


@dataclass(frozen=True, slots=True)
class HoleTruth:
    """A hole as the plant knows it: axis and depth, µm."""

    x_um: float
    y_um: float
    depth_um: float


class MemoryTransport:
    """A line without wire: real frame bytes, virtual time.

    The controller answers commands at once; only `read` lets virtual time pass, at most `timeout_s`. So that a
    host which asks again and again cannot stop the clock, a millisecond passes after every eight answers.
    """

    def __init__(self, controller: VirtualController) -> None:
        self.name = "sim:"
        self.simulated = True
        self._controller = controller
        self._open = True
        self._answers = 0

    def write(self, data: bytes) -> None:
        """Hand bytes to the controller."""
        self._check()
        self._controller.receive(data)

    def read(self, timeout_s: float) -> bytes:
        """Let up to `timeout_s` of virtual time pass; bytes of the controller, or b"" when none came."""
        self._check()
        port = self._controller.port
        if port.urgent and self._answers < ANSWERS_PER_TICK:
            self._answers += 1
            return port.take_output()
        ticks = 1 if port.urgent else max(1, math.floor(timeout_s / TICK_S + 0.5))
        self._answers = 0
        self._controller.advance(ticks)
        return port.take_output()

    def now_s(self) -> float:
        """Virtual time: the controller's."""
        return self._controller.tick * TICK_S

    def close(self) -> None:
        """Cut the line; a controller left armed will notice that the host is silent."""
        self._open = False

    def _check(self) -> None:
        if not self._open:
            raise LinkLost("The line to the virtual machine is closed.", hint="Open the machine again.")


class VirtualBench:
    """A controller over a plant, and what an all-seeing observer would know of it."""

    def __init__(self, config: BenchConfig, seed: int) -> None:
        self.plant = Plant(config, seed)
        self.controller = VirtualController(self.plant)
        self.transport = MemoryTransport(self.controller)

    def truth(self) -> tuple[HoleTruth, ...]:
        """Every hole made so far, in the order of making."""
        return tuple(HoleTruth(h.x_um, h.y_um, h.depth_um) for h in self.plant.true_holes())

    @property
    def tool_wear_um(self) -> float:
        """Length that the tool has truly lost, µm."""
        return self.plant.tool_wear_um


def open_bench(config: BenchConfig, seed: int) -> VirtualBench:
    """Set up a fresh virtual bench; the same config and seed give the same machine and the same run."""
    return VirtualBench(config, seed)
