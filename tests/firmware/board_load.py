"""The image loaded as much as line and generator can: a cut at 50 kHz with telemetry at 1 kHz and blocks of pulses.

The line of 921 600 baud is full of garbage with commands in it. No byte may be lost in the ring that receives, every
command has to be answered, every sample that is sent has to come.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import Any

import numpy as np

from edmctl.link import messages as m
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.simulator import BenchConfig
from edmctl.simulator.config import STM32
from tests.firmware.board_twin import SRAM, Memory, WatchedBench, board, watched
from tests.firmware.cuts import OFFSET_UM, cut_on

TICK_CLOCKS = 168_000
MOST_PERCENT, STACK_MOST = 35.0, 2048
"""Bars: halfwords of a millisecond in % of its clocks, one clock each, and bytes of a stack."""
RX_RING = 1024
FREQUENCY_HZ = 50_000.0
_LINE_BYTES_MS = 93  # 921 600 baud come out as 913 043: the line never rests
_LINGER_MS = 100  # for what is on its way at the end
_GARBAGE_MOST, _COMMANDS_MOST = 400, 3
_BAD_FRAMES = 1000  # of `bad_frames`: so many in a second are the fault LINE_NOISE
_PAINT = 0xA5
_PARAMETERS = [param.id for param in m.PARAMS.values()]


def painted(kind: type[Any]) -> type[Any]:
    """A watched controller whose stacks are painted at every start."""

    class Painted(watched(kind)):  # type: ignore[misc]
        def _start(self, cause: Any) -> None:
            super()._start(cause)
            for stack in self.stacks():
                self.chip.sram[stack] = _PAINT

        def stacks(self) -> tuple[slice, slice]:
            """The main loop's and the interrupt's: places in SRAM."""
            names = ("guard_end", "loop_stack_top", "main_stack_end", "main_stack_top")
            at = [self.chip.image.symbols[name][0] - SRAM for name in names]
            return slice(*at[:2]), slice(*at[2:])

        def deepest(self) -> tuple[int, int]:
            """Bytes of the main loop's and of the interrupt's stack that were ever written."""
            loop, tick = (self.chip.sram[stack] != _PAINT for stack in self.stacks())
            return len(loop) - int(np.argmax(loop)), len(tick) - int(np.argmax(tick))

    return Painted


@dataclass
class Host:
    """Commands between garbage, and which of them were answered."""

    session: int
    random: Random = field(default_factory=lambda: Random(20))
    seq: int = 100
    sent: int = 0
    waiting: dict[tuple[int, int], int] = field(default_factory=dict)
    garbage_bytes: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    decoder: FrameDecoder = field(default_factory=lambda: FrameDecoder(watch_for_abort=False))
    rx_decoder: FrameDecoder = field(default_factory=lambda: FrameDecoder(watch_for_abort=False))
    refused: int = 0
    next_samples: int | None = None
    samples: int = 0
    gaps: int = 0

    def some(self) -> bytes:
        """Garbage and some commands."""
        garbage = self.random.randbytes(self.random.randrange(_GARBAGE_MOST))
        self.garbage_bytes += len(garbage)
        commands = b"".join(self._command() for _ in range(self.random.randint(1, _COMMANDS_MOST)))
        return garbage + commands

    def _command(self) -> bytes:
        message = self.random.choice((m.GetStatus(), m.GetParam(self.random.choice(_PARAMETERS))))
        self.seq = (self.seq + 1) % 256
        self.sent += 1
        self.kinds[message.NAME] += 1
        key = (message.ID | 0x40, self.seq)
        self.waiting[key] = self.waiting.get(key, 0) + 1
        return encode_frame(message.ID, self.seq, self.session, 0, message.pack())

    def heard(self, data: bytes) -> None:
        """Take what the board has sent."""
        for frame in self.decoder.feed(data):
            key = (frame.type_id, frame.seq)
            if key in self.waiting:
                self.waiting[key] -= 1
                if not self.waiting[key]:
                    del self.waiting[key]
                self.refused += frame.flags != m.Status.OK
            elif frame.type_id == m.Tlm.ID:
                told = m.Tlm.unpack(frame.payload)
                self.gaps += self.next_samples not in (None, told.counter) or told.dropped != 0
                self.next_samples = (told.counter + 1) % 65536
                self.samples += told.n

    @property
    def unanswered(self) -> int:
        """Commands without a reply."""
        return sum(self.waiting.values())


@dataclass
class Load:
    """What a loaded cut has come to. loads : halfwords executed, by millisecond. cpu_s : what it took here."""

    seconds: float
    goes_on: bool
    pulses: int
    host: Host
    rx_bad: int
    rx_frames: int
    fullest: int
    loads: np.ndarray[Any, np.dtype[np.int64]]
    loop_stack: int
    tick_stack: int
    cpu_s: float

    @property
    def percent(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Load of each millisecond, % of its clocks."""
        return 100.0 * self.loads / TICK_CLOCKS

    def right(self, most_percent: float = MOST_PERCENT) -> dict[str, bool]:
        """Whether each thing is as it has to be."""
        host = self.host
        return {
            "the cut goes on": self.goes_on and self.pulses > 0.95 * FREQUENCY_HZ * self.seconds,
            "nothing overran": self.fullest + _LINE_BYTES_MS < RX_RING and self.rx_bad == host.rx_decoder.bad,
            "every command came": self.rx_frames == host.sent,
            "and was answered": host.unanswered == 0 and host.refused == 0,
            "telemetry is whole": host.gaps == 0 and host.samples >= 990 * self.seconds,
            "the tick": bool(self.percent.max() <= most_percent),
            "the stacks": max(self.loop_stack, self.tick_stack) <= STACK_MOST,
        }


def loaded(compiled_by: str, seconds: float) -> Load:
    """Load the image of a compiler."""
    config = BenchConfig(offset_um=OFFSET_UM, controller=STM32)
    bench = WatchedBench(config, 2, lambda plant: board(plant, compiled_by, painted))
    controller = bench.controller
    session = cut_on(bench, 0.2, FREQUENCY_HZ, settings={"bad_frames": _BAD_FRAMES})
    host = Host(session._session)
    memory, bad, frames = Memory(controller), controller.link.rx_bad, controller.link.rx_frames
    loads = []
    fullest = 0
    start_s = time.process_time()
    pulses = controller.word("gap.pulse_no")
    end = round(seconds * 1000)
    for tick in range(end + _LINGER_MS):
        if tick < end:
            waiting = controller.bench.rx_tail - controller.bench.rx_head  # on the line, not received yet
            if waiting < _LINE_BYTES_MS:
                data = host.some()
                while len(data) < _LINE_BYTES_MS:
                    data += host.some()
                controller.receive(data)
                host.rx_decoder.feed(data)
        fullest = max(fullest, memory.received())
        loads_before = controller.watch.loads
        controller.advance(1)
        loads.append(controller.watch.loads - loads_before)
        host.heard(controller.link.take_output())
    loop_stack, tick_stack = controller.deepest()
    return Load(
        seconds=seconds,
        goes_on=controller.state is m.State.MACHINING,
        pulses=controller.word("gap.pulse_no") - pulses,
        host=host,
        rx_bad=controller.link.rx_bad - bad,
        rx_frames=controller.link.rx_frames - frames,
        fullest=fullest,
        loads=np.array(loads[:end]),
        loop_stack=loop_stack,
        tick_stack=tick_stack,
        cpu_s=time.process_time() - start_s,
    )
