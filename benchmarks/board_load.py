"""Load the image as much as the line and the generator can, under emulation, and measure what it needs.

    python benchmarks/board_load.py [--seconds 60] [--compiler zig gcc] [--most 35]

A cut at 50 kHz with telemetry at 1 kHz and blocks of pulses, while a line of 921 600 baud is full of garbage with
commands in it. No byte may be lost in the ring that receives, every command has to be answered, every frame that is
sent has to come. Told are halfwords executed in a millisecond in % of 168 000 clocks, one clock each, without the
boot; the worst of both stacks; memory by section; and how fast the emulation is in a cut at 2.3 kHz. Ends with 1
where something is lost or beyond its bar.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from edmctl.firmware.board_build import COMPILERS
from edmctl.link import messages as m
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.simulator import BenchConfig
from edmctl.simulator.config import STM32
from edmctl.simulator.emulated import image
from tests.firmware.board_twin import SRAM, Memory, WatchedBench, board, watched
from tests.firmware.cuts import OFFSET_UM, cut_on

if TYPE_CHECKING:
    from edmctl.firmware.elf import Elf

TICK_CLOCKS = 168_000
LINE_BYTES_MS = 93  # 921 600 baud come out as 913 043: the line never rests
RX_RING = 1024
LINGER_MS = 100  # for what is on its way at the end
GARBAGE_MOST, COMMANDS_MOST = 400, 3
BAD_FRAMES = 1000  # of `bad_frames`: so many in a second are the fault LINE_NOISE
PAINT = 0xA5
FLASH_MOST, RAM_MOST, STACK_MOST = 96 * 1024, 220 * 1024, 2048
SPEED_LEAST = 8.0
FREQUENCY_HZ = 50_000.0
PARAMETERS = [param.id for param in m.PARAMS.values()]


def painted(kind: type[Any]) -> type[Any]:
    """A watched controller whose stacks are painted at every start."""

    class Painted(watched(kind)):  # type: ignore[misc]
        def _start(self, cause: Any) -> None:
            super()._start(cause)
            for stack in self.stacks():
                self.chip.sram[stack] = PAINT

        def stacks(self) -> tuple[slice, slice]:
            """The main loop's and the interrupt's: places in SRAM."""
            names = ("guard_end", "loop_stack_top", "main_stack_end", "main_stack_top")
            at = [self.chip.image.symbols[name][0] - SRAM for name in names]
            return slice(*at[:2]), slice(*at[2:])

        def deepest(self) -> tuple[int, int]:
            """Bytes of the main loop's and of the interrupt's stack that were ever written."""
            loop, tick = (self.chip.sram[stack] != PAINT for stack in self.stacks())
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
        garbage = self.random.randbytes(self.random.randrange(GARBAGE_MOST))
        self.garbage_bytes += len(garbage)
        commands = b"".join(self._command() for _ in range(self.random.randint(1, COMMANDS_MOST)))
        return garbage + commands

    def _command(self) -> bytes:
        message = self.random.choice((m.GetStatus(), m.GetParam(self.random.choice(PARAMETERS))))
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


def loaded(compiled_by: str, seconds: float, most_percent: float) -> bool:
    """Load the image of a compiler; whether everything is as it has to be."""
    config = BenchConfig(offset_um=OFFSET_UM, controller=STM32)
    bench = WatchedBench(config, 2, lambda plant: board(plant, compiled_by, painted))
    controller = bench.controller
    session = cut_on(bench, 0.2, FREQUENCY_HZ, settings={"bad_frames": BAD_FRAMES})
    host = Host(session._session)
    memory, bad, frames = Memory(controller), controller.link.rx_bad, controller.link.rx_frames
    loads = []
    fullest = 0
    start_s = time.process_time()
    pulses = controller.word("gap.pulse_no")
    end = round(seconds * 1000)
    for tick in range(end + LINGER_MS):
        if tick < end:
            waiting = controller.bench.rx_tail - controller.bench.rx_head  # on the line, not received yet
            if waiting < LINE_BYTES_MS:
                data = host.some()
                while len(data) < LINE_BYTES_MS:
                    data += host.some()
                controller.receive(data)
                host.rx_decoder.feed(data)
        fullest = max(fullest, memory.received())
        loads_before = controller.watch.loads
        controller.advance(1)
        loads.append(controller.watch.loads - loads_before)
        host.heard(controller.link.take_output())
    cpu_s = time.process_time() - start_s
    share = 100.0 * np.array(loads[:end]) / TICK_CLOCKS
    pulses = controller.word("gap.pulse_no") - pulses
    rx_bad, rx_frames = controller.link.rx_bad - bad, controller.link.rx_frames - frames
    answered = host.sent - host.unanswered
    loop_stack, tick_stack = controller.deepest()
    print(
        f"{compiled_by}: {seconds:g} s at {FREQUENCY_HZ:g} Hz, {pulses} pulses, "
        f"{host.garbage_bytes} bytes of garbage, "
        f"{host.sent} commands ({', '.join(f'{n} {k}' for k, n in host.kinds.items())}), {answered} answered, "
        f"{host.refused} refused; {host.samples} samples, {host.gaps} gaps ({cpu_s:.0f} s of CPU)"
    )
    print(
        f"  received: {rx_frames} whole frames of {host.sent}, {rx_bad} damaged of {host.rx_decoder.bad}; "
        f"most in the ring {fullest} of {RX_RING} bytes"
    )
    print(
        f"  tick: mean {share.mean():.1f} %, 99.9 % of them below {np.quantile(share, 0.999):.1f} %, "
        f"most {share.max():.1f} % of {TICK_CLOCKS} clocks (bar {most_percent:g} %)"
    )
    print(f"  stack: main loop {loop_stack} bytes, tick {tick_stack} bytes (bar {STACK_MOST})")
    right = {
        "the cut goes on": controller.state is m.State.MACHINING and pulses > 0.95 * FREQUENCY_HZ * seconds,
        "nothing overran": fullest + LINE_BYTES_MS < RX_RING and rx_bad == host.rx_decoder.bad,
        "every command came": rx_frames == host.sent,
        "and was answered": host.unanswered == 0 and host.refused == 0,
        "telemetry is whole": host.gaps == 0 and host.samples >= 990 * seconds,
        "the tick": share.max() <= most_percent,
        "the stacks": max(loop_stack, tick_stack) <= STACK_MOST,
    }
    for what in (what for what, is_right in right.items() if not is_right):
        print(f"  MISSED: {what}")
    return all(right.values())


def fits(compiled_by: str, elf: Elf) -> bool:
    """Tell the memory of an image by section; whether it is within its bars."""
    sections = {s.name: s.size for s in elf.sections if s.is_allocated and s.size}
    flash = elf.symbols["image_size"][0]
    ram = sum(s.size for s in elf.sections if s.is_allocated and not 0x08000000 <= s.address < 0x10000000)
    told = ", ".join(f"{name} {size}" for name, size in sections.items())
    print(f"{compiled_by}: flash {flash} bytes, RAM {ram} bytes ({told})")
    return flash <= FLASH_MOST and ram <= RAM_MOST


def quick(compiled_by: str, seconds: float) -> bool:
    """Tell how fast the emulation is in a cut at 2.3 kHz; whether that is enough."""
    config = BenchConfig(offset_um=OFFSET_UM, controller=STM32)
    bench = WatchedBench(config, 2, lambda plant: board(plant, compiled_by, painted))
    session = cut_on(bench, 0.5)
    watch = bench.controller.watch
    loads, count, watch.most_load = watch.loads, watch.loads_count, 0
    start_s = time.process_time()
    session.pump(seconds)
    speed = seconds / (time.process_time() - start_s)
    mean = (watch.loads - loads) / (watch.loads_count - count)
    print(
        f"{compiled_by}: a cut at 2.3 kHz is emulated with {speed:.1f} times the pace of a machine, waveforms on "
        f"(bar {SPEED_LEAST:g}); tick: mean {100 * mean / TICK_CLOCKS:.1f} %, "
        f"most {100 * watch.most_load / TICK_CLOCKS:.1f} %"
    )
    return speed >= SPEED_LEAST


def main() -> int:
    """Measure; 1 where something is lost or beyond its bar."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--compiler", nargs="+", choices=COMPILERS, default=COMPILERS)
    parser.add_argument("--most", type=float, default=35.0, help="of a tick, %%")
    options = parser.parse_args()
    right = True
    for name in options.compiler:
        right &= fits(name, image(name))
        right &= loaded(name, options.seconds, options.most)
        right &= quick(name, min(20.0, options.seconds))
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
