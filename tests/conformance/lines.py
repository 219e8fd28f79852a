"""Where the controller under test sits: in this process, behind a pty, or on a board.

Only this module touches the virtual machine, and only to start it and to spoil it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from tests.serving import serving


class Line(Protocol):
    """A byte stream to one controller.

    `bench` is the virtual bench behind it, None on a board. `virtual_time` is true where time passes only in `read`.
    `decides_us` is the part of a millisecond that the controller takes to see and decide, 0 where it takes no time.
    """

    name: str
    bench: Any
    virtual_time: bool
    decides_us: float

    def write(self, data: bytes) -> None: ...

    def read(self, timeout_s: float) -> bytes: ...

    def now_s(self) -> float: ...


STM32 = "stm32"
STM32_WAVEFORMS = 34_785
STM32_DECIDES_US = 350.0
"""Its tick takes 35 % of a millisecond at most (docs/firmware.md)."""


def new_bench(controller: str = "firmware", seed: int = 5) -> Any:
    """A virtual bench with a surface 20 µm away, so that the tool is soon at work."""
    from edmctl.simulator import BenchConfig, open_bench

    return open_bench(BenchConfig(offset_um=20.0, controller=controller), seed)


WRAP_16, WRAP_32 = 1 << 16, 1 << 32
BEFORE_WRAP_US, PULSES_BEFORE_WRAP, BEFORE_WRAP = 250_000, 300, 3


def count_to_the_wrap(bench: Any) -> None:
    """Let every counter of the virtual controller stand shortly before it starts over."""
    bench.controller.count_from(
        time_us=WRAP_32 - WRAP_32 % 1000 - BEFORE_WRAP_US,
        event_no=WRAP_16 - BEFORE_WRAP,
        boot_count=WRAP_32 - 1,
        frames=WRAP_16 - BEFORE_WRAP,
        pulse_no=WRAP_32 - PULSES_BEFORE_WRAP,
    )


def shorten_waveforms(bench: Any, samples: int) -> int:
    """Give the virtual controller a memory for so many samples of a waveform, and return what it has.

    That of a board is as large as it is.
    """
    if bench.plant.config.controller == STM32:
        return STM32_WAVEFORMS
    bench.controller.waveforms.memory = samples
    return samples


def cut_the_power(bench: Any) -> None:
    """Let the virtual controller lose its supply for a moment, whatever it does."""
    from edmctl.simulator.injection import parse_injection

    bench.inject(parse_injection("POWER_LOSS@0"))


def press_reset(bench: Any) -> None:
    """Reset the virtual controller alone, whatever it does: the actuator keeps its voltage."""
    from edmctl.link.messages import ResetCause

    bench.controller.reset(ResetCause.EXTERNAL)


def chip_errors(bench: Any) -> tuple[int, int | None]:
    """How often an image did on its emulated chip what no image may do, and where first; (0, None) elsewhere."""
    chip = getattr(getattr(bench, "controller", None), "chip", None)
    return chip.errors if chip is not None else (0, None)


class InProcess:
    """The virtual controller itself: bytes handed over, time let pass by the reader."""

    virtual_time = True

    def __init__(self, controller: str = "firmware") -> None:
        self.name = f"the virtual machine in process, controller: {controller}"
        self.decides_us = STM32_DECIDES_US if controller == STM32 else 0.0
        self.bench = new_bench(controller)

    def write(self, data: bytes) -> None:
        self.bench.transport.write(data)

    def read(self, timeout_s: float) -> bytes:
        data: bytes = self.bench.transport.read(timeout_s)
        return data

    def now_s(self) -> float:
        now_s: float = self.bench.transport.now_s()
        return now_s


class Serial:
    """A port opened by pyserial: a pty or a board."""

    virtual_time = False

    def __init__(self, url: str, baud: int, bench: Any = None) -> None:
        import serial

        self.name = url
        self.bench = bench
        chip = bench is None or bench.plant.config.controller == STM32
        self.decides_us = STM32_DECIDES_US if chip else 0.0
        self._port = serial.serial_for_url(url, baudrate=baud, timeout=0, write_timeout=2.0)

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def read(self, timeout_s: float) -> bytes:
        self._port.timeout = max(0.0, timeout_s)
        first: bytes = self._port.read(1)
        return first + self._port.read(self._port.in_waiting) if first else b""

    def now_s(self) -> float:
        return time.monotonic()

    def close(self) -> None:
        self._port.close()


@contextmanager
def served(controller: str = "firmware") -> Iterator[Serial]:
    """The virtual machine behind a pty, its clock driven by this host."""
    bench = new_bench(controller)
    with serving(bench) as path:
        line = Serial(path, 500_000, bench)
        try:
            yield line
        finally:
            line.close()
