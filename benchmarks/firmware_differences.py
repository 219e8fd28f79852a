"""Send random schedules to the virtual controller and to the firmware's core over equal plants; compare all bytes.

    python benchmarks/firmware_differences.py [--schedules 200] [--steps 500] [--from 1] [--pair python firmware]
                                              [--wide]

A schedule mixes sensible work with damaged, repeated and foreign frames, aborts, restarts, injected faults and
senseless values (tests/firmware/schedules.py). After each step what both have sent, their states and their plants
have to be the same. Ends with 1 at the first difference, and tells what led to it.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.firmware.schedules import Difference, Schedule, WideSchedule


def main() -> int:
    """Run the schedules; 1 where there is a difference."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--schedules", type=int, default=200)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--from", dest="first", type=int, default=1)
    parser.add_argument("--pair", nargs=2, default=["python", "firmware"])
    parser.add_argument(
        "--wide", action="store_true", help="parameters of any value, readings that cannot be"
    )
    options = parser.parse_args()
    kind = WideSchedule if options.wide else Schedule
    commands, ticks, start_s = 0, 0, time.monotonic()
    faults: set[int] = set()
    for seed in range(options.first, options.first + options.schedules):
        schedule = kind(seed, *options.pair)
        try:
            schedule.run(options.steps)
        except Difference as difference:
            print(f"schedule {seed}, command {schedule.commands}: {difference}")
            return 1
        commands += schedule.commands
        ticks += schedule.twins.lead.controller.tick
        faults |= schedule.faults
    print(
        f"{commands} commands in {options.schedules} schedules, {ticks / 1000:.0f} s of machine time, "
        f"{time.monotonic() - start_s:.0f} s: no difference; faults met: {sorted(faults)}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
