"""A virtual machine that stays the same from one command line to the next, and can be broken and repaired."""

from __future__ import annotations

from edmctl.link.frame import encode_frame
from edmctl.simulator.bench import MemoryTransport, VirtualBench
from edmctl.simulator.config import BenchConfig
from edmctl.simulator.injection import parse_injection

ONE_TICK_S = 1e-3
DAMAGED = bytearray(encode_frame(0x02, 0, 1, 0, b"twelve bytes"))
DAMAGED[-3] ^= 0x10


class WatchedLine(MemoryTransport):
    """A line in memory that lets time pass in single milliseconds once something is to be timed.

    A noisy line brings the controller a damaged frame every millisecond, beside those of the host.
    """

    def __init__(self, workshop: Workshop) -> None:
        super().__init__(workshop.bench.controller)
        self._workshop = workshop

    def read(self, timeout_s: float) -> bytes:
        workshop, controller = self._workshop, self._workshop.bench.controller
        if workshop.bench.line.noise:
            controller.receive(bytes(DAMAGED))
        timed = workshop.fine and controller.plant.drive.pulses_on
        data = super().read(min(timeout_s, ONE_TICK_S) if timed else timeout_s)
        workshop.look()
        return data


class Workshop:
    """Stands in for `open_bench`: every command line gets the one bench, with a line of its own.

    Parameters
    ----------
    inject : what will go wrong, as `parse_injection` reads it; empty for nothing
    fine : time the pulses by the millisecond
    latent : what is wrong shows only later, so time counts from the fault
    """

    def __init__(self, inject: str = "", *, fine: bool = False, latent: bool = False) -> None:
        self._inject = inject
        self.fine = fine
        self._latent = latent
        self._bench: VirtualBench | None = None
        self.cause_s: float | None = None
        self.last_pulses_s = 0.0
        self.first_off_s: float | None = None

    @property
    def bench(self) -> VirtualBench:
        """The machine, from the first command on."""
        assert self._bench is not None
        return self._bench

    def __call__(self, config: BenchConfig, seed: int) -> VirtualBench:
        if self._bench is None:
            self._bench = VirtualBench(config, seed)
            if self._inject:
                self._bench.inject(parse_injection(self._inject))
        self._bench.transport = WatchedLine(self)
        return self._bench

    def look(self) -> None:
        """Note when something went wrong, and when pulses were last on after that."""
        controller = self.bench.controller
        applied = controller.injector.applied
        if self.cause_s is None:
            if self._latent and controller.fault:
                self.cause_s = self.last_pulses_s = controller.tick * ONE_TICK_S
            elif applied and not self._latent:
                self.cause_s = self.last_pulses_s = applied[0][1] * ONE_TICK_S
        if self.cause_s is None:
            return
        if controller.plant.drive.pulses_on:
            self.last_pulses_s = controller.tick * ONE_TICK_S
        elif self.first_off_s is None:
            self.first_off_s = self.last_pulses_s

    @property
    def pulses_after_cause_s(self) -> float:
        """How long pulses went on after something went wrong."""
        return 0.0 if self.cause_s is None else self.last_pulses_s - self.cause_s

    @property
    def pulses_off_after_s(self) -> float:
        """How long it took until pulses were first off; a host that recovers switches them on again."""
        assert self.cause_s is not None
        assert self.first_off_s is not None
        return self.first_off_s - self.cause_s

    def repair(self) -> None:
        """Put everything right that was broken."""
        self.bench.clear_injections()
        self.fine = False
