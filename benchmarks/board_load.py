"""Load the image as much as the line and the generator can, under emulation, and measure what it needs.

    python benchmarks/board_load.py [--seconds 60] [--compiler zig gcc] [--most 35]

The scene is tests/firmware/board_load.py. Told are halfwords executed in a millisecond in % of 168 000 clocks, one
clock each, without the boot; the worst of both stacks; memory by section; and how fast the emulation is in a cut at
2.3 kHz. Ends with 1 where something is lost or beyond its bar.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.common import options
from edmctl.board.board_build import COMPILERS
from edmctl.board.emulated import image
from edmctl.simulator import BenchConfig
from edmctl.simulator.config import STM32
from tests.firmware import board_load
from tests.firmware.board_load import FREQUENCY_HZ, MOST_PERCENT, RX_RING, STACK_MOST, TICK_CLOCKS, painted
from tests.firmware.board_twin import WatchedBench, board
from tests.firmware.cuts import OFFSET_UM, cut_on

if TYPE_CHECKING:
    from edmctl.board.image import Elf

FLASH_MOST, RAM_MOST = 96 * 1024, 220 * 1024
SPEED_LEAST = 8.0


def loaded(compiled_by: str, seconds: float, most_percent: float) -> bool:
    """Load the image of a compiler; whether everything is as it has to be."""
    load = board_load.loaded(compiled_by, seconds)
    host, share = load.host, load.percent
    print(
        f"{compiled_by}: {seconds:g} s at {FREQUENCY_HZ:g} Hz, {load.pulses} pulses, "
        f"{host.garbage_bytes} bytes of garbage, "
        f"{host.sent} commands ({', '.join(f'{n} {k}' for k, n in host.kinds.items())}), "
        f"{host.sent - host.unanswered} answered, {host.refused} refused; "
        f"{host.samples} samples, {host.gaps} gaps ({load.cpu_s:.0f} s of CPU)"
    )
    print(
        f"  received: {load.rx_frames} whole frames of {host.sent}, "
        f"{load.rx_bad} damaged of {host.rx_decoder.bad}; most in the ring {load.fullest} of {RX_RING} bytes"
    )
    print(
        f"  tick: mean {share.mean():.1f} %, 99.9 % of them below {np.quantile(share, 0.999):.1f} %, "
        f"most {share.max():.1f} % of {TICK_CLOCKS} clocks (bar {most_percent:g} %)"
    )
    print(f"  stack: main loop {load.loop_stack} bytes, tick {load.tick_stack} bytes (bar {STACK_MOST})")
    right = load.right(most_percent)
    for what in (what for what, is_right in right.items() if not is_right):
        print(f"  MISSED: {what}")
    return all(right.values())


def fits(compiled_by: str, elf: Elf) -> bool:
    """Tell the memory of an image by section; whether it is within its bars."""
    sections = {s.name: s.size_bytes for s in elf.sections if s.is_allocated and s.size_bytes}
    flash = elf.symbols["image_size"][0]
    ram = sum(
        s.size_bytes for s in elf.sections if s.is_allocated and not 0x08000000 <= s.address < 0x10000000
    )
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
    given = options(__doc__, {"compiler": COMPILERS}, seconds=60.0, compiler=COMPILERS, most=MOST_PERCENT)
    right = True
    for name in given.compiler:
        right &= fits(name, image(name))
        right &= loaded(name, given.seconds, given.most)
        right &= quick(name, min(20.0, given.seconds))
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
