"""Compare the speed of the virtual machine under the virtual controller and under the firmware's core.

    python benchmarks/firmware_speed.py [--repeat 40] [--least 0.9 0.8]

CPU time a tick (1 ms of the machine) of a cut at 2.3 kHz and at 50 kHz, by turns, the least of all repeats. With
`--least A B` the core has to be A and B times as fast.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from edmctl.link import messages as m
from edmctl.simulator.config import FIRMWARE, FIRMWARE_FLOAT, PYTHON
from tests.firmware.cuts import cut

FREQUENCIES_HZ = (2300.0, 50_000.0)
SLICES = {2300.0: 12, 50_000.0: 4}
SLICE_TICKS = 200

KINDS = (PYTHON, FIRMWARE, FIRMWARE_FLOAT)  # an emulated chip has another loop


def main() -> int:
    """Measure; 1 where the core is slower than it may be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeat", type=int, default=40)
    parser.add_argument("--least", type=float, nargs=2, default=(0.0, 0.0), metavar=("A", "B"))
    options = parser.parse_args()
    slow = False
    for frequency_hz, least in zip(FREQUENCIES_HZ, options.least, strict=True):
        benches = {kind: cut(kind, 0.5, frequency_hz, told=False) for kind in KINDS}
        assert all(bench.controller.state is m.State.MACHINING for bench in benches.values())
        best_us = dict.fromkeys(KINDS, 1e9)
        for _ in range(options.repeat):
            for kind, bench in benches.items():
                first, start_s = bench.controller.tick, time.thread_time()
                for _ in range(SLICES[frequency_hz]):
                    bench.controller.step(SLICE_TICKS)
                ticks = bench.controller.tick - first
                best_us[kind] = min(best_us[kind], (time.thread_time() - start_s) / ticks * 1e6)
        share = best_us[PYTHON] / best_us[FIRMWARE]
        slow = slow or share < least
        told = ", ".join(f"{kind} {us:.3f} µs" for kind, us in best_us.items())
        print(f"{frequency_hz:g} Hz: {told} a tick; the core has {share:.2f} of the speed")
    return 1 if slow else 0


if __name__ == "__main__":
    sys.exit(main())
