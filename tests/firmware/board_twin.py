"""The image on the emulated chip, watched millisecond by millisecond, and the core on the host fed with the same.

What the board's half has measured is read out of the chip's memory, what has come over the line out of its ring.
"""

from __future__ import annotations

import ctypes as ct
import importlib
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from edmctl.board.emulated import controller_class, image
from edmctl.core.build import compiler, source_folder
from edmctl.simulator import BenchConfig, VirtualBench
from edmctl.simulator.bench import MemoryTransport
from edmctl.simulator.config import STM32
from edmctl.simulator.plant import Plant
from tests.firmware.cuts import OFFSET_UM, cut_on

SRAM, CCM = 0x20000000, 0x10000000
RX_BYTES, TX_BYTES, SLOW_HALFWORDS = 1024, 4096, 128
_IDENTITY_AT = 4  # behind the pointer that begins the controller
_AXIS_BYTES, _TRAVELS_AT = 24, 21  # struct axis of stages.c
_SCANS_AT_AND_GOOD = 8  # struct scans of measure.h
LAYOUT = (1064, 24, 26, 32, 40, 40 + 3 * 256)
"""struct edm_readings on the board: its size, where contact, pulses, first_pulse_ns, delay_us and energy_uj are."""


class WatchedBench(VirtualBench):
    """A bench whose controller is made for its plant by a function."""

    controller: Any

    def __init__(self, config: BenchConfig, seed: int, make: Callable[[Plant], Any]) -> None:
        self.plant = Plant(config, seed)
        self.controller = make(self.plant)
        self.transport = MemoryTransport(self.controller)


def board(plant: Plant, compiled_by: str | None, changed: Callable[[type[Any]], type[Any]]) -> Any:
    """Return an emulated board with the image of a compiler; `changed` makes another class of the emulator's."""
    return changed(controller_class())(plant, image(compiled_by))


class Memory:
    """Words of the chip's SRAM by the names of the image's variables."""

    def __init__(self, controller: Any) -> None:
        self._c = controller

    def at(self, name: str, size: int) -> Any:
        """Bytes of a variable; its size has to be that."""
        address, length = self._c.chip.image.symbols[name]
        assert length == size, f"{name} has {length} bytes"
        return self._c.chip.sram[address - SRAM : address - SRAM + size]

    def word(self, name: str) -> int:
        return int(self.at(name, 4).view("<u4")[0])

    def received(self) -> int:
        """Bytes of the line that wait in the ring."""
        dma = _registers()
        left = int(self._c.chip.r[dma.register(dma.DMA1, 0x10 + 0x18 + 4)])
        return (RX_BYTES - left - self.word("rx_at")) % RX_BYTES


def built(folder: Path) -> ct.CDLL:
    """Build the twin: core, what measures, and twin.c, in float."""
    source = source_folder()
    path = folder / "twin.so"
    here = source.parent / "tests" / "firmware" / "twin.c"
    files = [path for part in ("core", "gen", "math") for path in sorted((source / part).glob("*.c"))]
    flags = ["-std=c11", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared"]
    command = [*compiler(), *flags, f"-I{source}", str(here), str(source / "board" / "measure.c")]
    subprocess.run([*command, *map(str, files), "-o", str(path)], check=True)
    library = ct.CDLL(str(path))
    library.twin_inputs.argtypes = [ct.c_uint32, ct.c_int, ct.c_void_p, ct.c_uint32, ct.c_uint32, ct.c_int]
    library.twin_start.argtypes = [ct.c_char_p]
    library.twin_millisecond.argtypes = [ct.c_char_p, ct.c_char_p, ct.c_uint32]
    library.twin_millisecond.restype = ct.c_uint32
    library.twin_taken.restype = ct.c_void_p
    layout = (ct.c_uint32 * 7).in_dll(library, "twin_layout")
    assert tuple(layout)[:6] == LAYOUT, f"readings lie otherwise here: {tuple(layout)}"
    return library


class Twin:
    """The core on the host behind an image: `ticks` milliseconds so far, `sent` all that it had to send."""

    def __init__(self, library: ct.CDLL) -> None:
        self._library = library
        self.ticks = 0
        self.sent = bytearray()
        self._slow = np.zeros(SLOW_HALFWORDS, np.uint16)
        self.identity_bytes = int((ct.c_uint32 * 7).in_dll(library, "twin_layout")[6])

    def start(self, identity: bytes) -> None:
        """Begin as a board that has been switched on."""
        self._library.twin_start(identity)

    def inputs(self, port: int, stage_moves: bool, slow: bytes, at: int, good: bool) -> None:
        """Take levels of port G and the slow channels' ring."""
        self._slow[:] = np.frombuffer(slow, np.uint16)
        self._library.twin_inputs(port, stage_moves, self._slow.ctypes.data, SLOW_HALFWORDS, at, good)

    def millisecond(self, readings: bytes, line: bytes) -> None:
        """Let a millisecond pass."""
        self.ticks += 1
        size = self._library.twin_millisecond(readings, line, len(line))
        if size:
            self.sent += ct.string_at(self._library.twin_taken(), size)


def watched(kind: type[Any]) -> type[Any]:
    """A controller of that class that keeps what goes out, `uart`, and feeds its `twin`, if it is given one."""

    class Watched(kind):  # type: ignore[misc]
        twin: Twin | None = None
        uart: bytearray

        def __init__(self, *arguments: Any) -> None:
            self.uart = bytearray()
            super().__init__(*arguments)

        def _loop(self, ticks: int, stops_when_sent: bool) -> int:
            if self.twin is None:
                return super()._loop(ticks, stops_when_sent)  # type: ignore[no-any-return]
            return self._millisecond(self.twin, stops_when_sent)

        def _millisecond(self, twin: Twin, stops_when_sent: bool) -> int:
            """One turn of the emulator's loop; the twin follows where the image has done a millisecond."""
            memory = Memory(self)
            runs = self.bench.ticks > 0
            done = memory.word("finished")
            slow = memory.at("slow_ring", 2 * SLOW_HALFWORDS).tobytes()
            ring = memory.at("rx", RX_BYTES).tobytes()
            begin = memory.word("rx_at")
            port = int(self.chip.r[_registers().PINS + 6])
            axes = memory.at("axes", 3 * _AXIS_BYTES)
            moves = bool(axes[_TRAVELS_AT::_AXIS_BYTES].any())
            reason: int = super()._loop(1, stops_when_sent)
            if not runs or memory.word("finished") == done:
                return reason
            at = memory.at("scans", 16)[_SCANS_AT_AND_GOOD:]
            twin.inputs(port, moves, slow, int(at[:4].view("<u4")[0]), bool(at[4]))
            if twin.ticks == 0:
                start = self._at - CCM + _IDENTITY_AT
                twin.start(self.chip.ccm[start : start + twin.identity_bytes].tobytes())
            end = memory.word("rx_at")
            line = ring[begin:end] if end >= begin else ring[begin:] + ring[:end]
            twin.millisecond(self.bytes_of("readings", LAYOUT[0]).tobytes(), line)
            return reason

        def _see_to(self, reason: int) -> None:
            self.uart += self._tx[: self.bench.tx_size].tobytes()
            super()._see_to(reason)

        def waiting(self) -> int:
            """Bytes that the image has still to send, or is sending."""
            memory = Memory(self)
            dma = _registers()
            control = dma.register(dma.DMA1, 0x10 + 0x18 * 4)
            left = int(self.chip.r[control + 1]) if self.chip.r[control] & 1 else 0
            begun = (memory.word("tx_out") + memory.word("tx_piece")) % TX_BYTES
            return left + (memory.word("tx_in") - begun) % TX_BYTES

    return Watched


def _registers() -> Any:
    return importlib.import_module("firmware_sim.registers")


def beside(library: ct.CDLL) -> Callable[[type[Any]], type[Any]]:
    """Like `watched`, with a twin from the first millisecond on."""

    def make(kind: type[Any]) -> type[Any]:
        return type("Beside", (watched(kind),), {"twin": Twin(library)})

    return make


@dataclass
class Cut:
    """A cut of the image, the twin beside it: bytes of the board, of the twin, of the host."""

    bench: WatchedBench
    uart: bytes
    twin_sent: bytes
    twin_ticks: int
    line: bytes
    pulses: int
    cpu_s: float = 0.0


def cut(seconds: float, seed: int, compiled_by: str | None, library: ct.CDLL) -> Cut:
    """Cut at 2.3 kHz with telemetry and pulse blocks, all that has gone out."""
    config = BenchConfig(offset_um=OFFSET_UM, controller=STM32)
    bench = WatchedBench(config, seed, lambda plant: board(plant, compiled_by, beside(library)))
    controller, twin = bench.controller, bench.controller.twin
    written = bytearray()
    write = bench.transport.write

    def listen(data: bytes) -> None:
        written.extend(data)
        write(data)

    bench.transport.write = listen  # type: ignore[method-assign]
    cut_on(bench, seconds)
    size = len(controller.uart)
    assert len(twin.sent) - size == controller.waiting()  # what is on its way; nothing was lost
    return Cut(
        bench,
        bytes(controller.uart),
        bytes(twin.sent[:size]),
        twin.ticks,
        bytes(written),
        controller.word("gap.pulse_no"),
    )
