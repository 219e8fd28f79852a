"""Random schedules of line faults: `python -m benchmarks.link_faults [--schedules 2000] [--seed 1]`.

Each schedule sends a dozen commands to the virtual controller over a line that drops, duplicates, delays (and so
reorders) and damages frames in both directions and restarts the controller now and then. Every command must have
acted exactly once where it was answered, and at most once where it failed, with an error that names a remedy. Exit
code 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
from time import perf_counter

from tests.link.schedules import COMMANDS, LOSS, Tally, run_schedule


def main() -> int:
    """Print the tally and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--schedules", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    tally, start_s = Tally(), perf_counter()
    for seed in range(arguments.seed, arguments.seed + arguments.schedules):
        run_schedule(seed, tally)
    print(
        f"{arguments.schedules} schedules of up to {COMMANDS} commands, each way {100 * LOSS.drop:.0f} % dropped, "
        f"{100 * LOSS.duplicate:.0f} % duplicated, {100 * LOSS.delay:.0f} % delayed by up to "
        f"{LOSS.longest_delay_s:g} s, {100 * LOSS.corrupt:.0f} % damaged; {perf_counter() - start_s:.0f} s"
    )
    print(
        f"acted exactly once: {tally.done + tally.refused} ({tally.refused} of them answered with a refusal)\n"
        f"clean failures, acted at most once: {tally.lost}\n"
        f"repeated frames: {tally.retries}; restarts of the controller: {tally.reboots}\n"
        f"breaches: {len(tally.breaches)} (bar: 0)"
    )
    for breach in tally.breaches[:20]:
        print(f"  {breach}")
    return 1 if tally.breaches else 0


if __name__ == "__main__":
    sys.exit(main())
