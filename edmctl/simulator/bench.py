"""The virtual bench and the line to it. Time passes only while the host reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module

from edmctl import failures
from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.link.transport import MergedTlm
from edmctl.simulator.config import FIRMWARE_FLOAT, STM32, BenchConfig
from edmctl.simulator.controller import Controller
from edmctl.simulator.injection import Injection, LineDamage, LineState
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_records import TICK_S

SETTLE_TICKS, MOST_SETTLES = 50, 2000


@dataclass(frozen=True, slots=True)
class HoleTruth:
    """A hole as the plant knows it: axis, depth under the tool's face, and whether the face is through.

    side_gap_um : the widest at the wall. taper_um : how much wider the mouth is, on the radius. ra_um : floor.
    """

    x_um: float
    y_um: float
    depth_um: float
    through: bool = False
    side_gap_um: float = math.nan
    taper_um: float = math.nan
    ra_um: float = math.nan


class MemoryTransport:
    """A line without wire: real frame bytes, virtual time, which passes only while the host reads (`HostWait`)."""

    def __init__(self, controller: Controller) -> None:
        self.name = "sim:"
        self.live = False
        self._controller = controller
        self._damage = LineDamage(controller.injector.line)
        self._open = True
        self._set_merging(on=False)

    def _set_merging(self, *, on: bool) -> None:
        if isinstance(self._controller, Controller):
            self._controller.seen.merges = int(on)
            self._controller.take_samples()  # of an earlier host

    def write(self, data: bytes) -> None:
        self._check()
        self._controller.receive(self._damage.to(data))

    def read(self, timeout_s: float) -> bytes:
        """Let up to `timeout_s` of virtual time pass; bytes of the controller, or b"" when none came."""
        self._check()
        self._controller.host_wait.wait(timeout_s)
        return self._controller.link.take_output()

    def now_s(self) -> float:
        return self._controller.plant.readings.tick * TICK_S

    def close(self) -> None:
        """Cut the line; a controller left armed will notice that the host is silent."""
        self._open = False

    def _check(self) -> None:
        if not self._open:
            raise failures.simulated_line_closed()
        if self._controller.injector.line.unplugged:
            raise failures.simulated_line_broken()


class DirectLine(MemoryTransport):
    """A `VirtualLine`: samples come as columns without frames, and a waiting host needs no heartbeats."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self._watched = False
        self._set_merging(on=True)

    def read(self, timeout_s: float) -> bytes:
        self._controller.seen.watched = int(self.is_watched)
        try:
            return super().read(timeout_s)
        finally:
            self._controller.seen.watched = 0

    def samples(self) -> list[MergedTlm]:
        """Return the samples since the last call."""
        return self._controller.take_samples()

    @property
    def is_watched(self) -> bool:
        """Whether the controller hears its host while that reads: not on a line that is damaged."""
        return self._watched and not self._controller.injector.line.is_damaged

    def watch(self, *, watched: bool) -> None:
        """Let the controller hear its host while that reads, or no longer."""
        self._watched = watched


OTHERS = {STM32: "edmctl.board.emulated:emulated_controller"}
"""Controllers of annexes: function that makes one over a plant."""


def _controller_of(plant: Plant, kind: str) -> Controller:
    if kind in OTHERS:
        module, _, name = OTHERS[kind].partition(":")
        return getattr(import_module(module), name)(plant)  # type: ignore[no-any-return]
    return Controller(plant, "float" if kind == FIRMWARE_FLOAT else "double")


class VirtualBench:
    """A controller over a plant, and what an all-seeing observer would know of it."""

    def __init__(self, config: BenchConfig, seed: int) -> None:
        self.plant = Plant(config, seed)
        self.controller: Controller = _controller_of(self.plant, config.controller)
        self.transport = MemoryTransport(self.controller)

    def direct_line(self) -> MemoryTransport:
        """Put the fastest line in the place of the first one, and return it; a board has only frames."""
        if type(self.transport) is MemoryTransport and isinstance(self.controller, Controller):
            self.transport = DirectLine(self.controller)
        return self.transport

    @property
    def line(self) -> LineState:
        """What is wrong with the line."""
        return self.controller.injector.line

    def inject(self, injection: Injection) -> None:
        """Let something go wrong at the time that the injection says."""
        self.controller.injector.add(injection)

    def clear_injections(self) -> None:
        """Forget what is still to go wrong and repair what did."""
        self.controller.injector.clear()

    def settle(self) -> None:
        """Let a machine whose host is gone become safe: what the watchdog would do, and the retreat.

        Raises RuntimeError where it has not become safe within 100 s: its state cannot be.
        """
        for _ in range(MOST_SETTLES):
            if self.is_safe:
                return
            self.controller.advance(SETTLE_TICKS)
        raise RuntimeError("the virtual machine does not come to rest")

    @property
    def is_safe(self) -> bool:
        """Whether the controller is not armed and the tool is retracted."""
        return not self.controller.armed and self.controller.loop.command_v == 0.0

    def truth(self) -> tuple[HoleTruth, ...]:
        """Every hole made so far, in the order of making; what was cut on a path is in the map alone."""
        return tuple(
            HoleTruth(h.x_um, h.y_um, h.depth_um, h.through, h.side_gap_um, h.taper_um, h.ra_um)
            for h in self.plant.work_under_tool.true_holes()
        )

    def truth_map(self) -> tuple[Array, Array, Array]:
        """The smallest rectangle with all that was cut so far: x (n,), y (m,) and depth (m, n) of its cells, µm."""
        return self.plant.work_under_tool.true_map()

    def fit_tool(self, label: str, diameter_um: float, tool_wear: float, tip_rounding_um: float) -> None:
        """Put the tool of that label in; one that was in before comes back with its wear. The work stays."""
        self.plant.fit_tool(label, diameter_um, tool_wear, tip_rounding_um)

    def new_tool(self) -> None:
        """Change the tool for a new one of its kind and name."""
        self.plant.state.wear_um = 0.0
        self.plant.arrive()

    @property
    def tool_label(self) -> str:
        return self.plant.config.tool_label

    @property
    def true_drifts_um_per_s(self) -> dict[str, float]:
        """Drift of the sensor's zero, without its random walk, and of the workpiece away from the tool."""
        unit = self.plant.unit
        return {"sensor_um_per_s": unit.sensor_drift_um_s, "machine_um_per_s": unit.machine_drift_um_s}

    @property
    def tool_wear_um(self) -> float:
        """Length that the tool has truly lost, µm."""
        return self.plant.state.wear_um


def open_bench(config: BenchConfig, seed: int) -> VirtualBench:
    """Set up a fresh virtual bench; the same config and seed give the same machine and the same run."""
    return VirtualBench(config, seed)


def run_many(benches: Sequence[VirtualBench], ticks: int, threads: int) -> None:
    """Let `ticks` ms pass on each of several machines, `threads` at a time; each does what it would do alone.

    What a controller sends waits in `controller.link.take_output()`; `controller.host_heard()` feeds its watchdog;
    a copy made before (`copy.deepcopy`) resets a machine. Raises the error of the first that fails.
    """
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(lambda bench: bench.controller.advance(ticks), benches):
            pass
