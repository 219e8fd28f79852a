"""Reactions of a host that looks at a calm cut every 0.5 s, as in virtual time, against one that looks every 0.1 s.

    python -m benchmarks.supervision [--seeds 3] [--first 1] [--jobs 2] [--only NAME ...]

Every injection breaks the same machines under both hosts while they make a hole of 12 µm. Compared are how the job
ends, what the host did about it, and how long after the injection it ended the job. A host in virtual time is to
end a job as a live one does, and not later. 0.1 s, a frame of samples, is allowed for, and 1 % where cuts and
touches come between. Exit code 1 where it differs.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from random import Random
from statistics import median

from edmctl.errors import EdmError
from edmctl.jobs.connect import bench_config
from edmctl.link.session import Session
from edmctl.machine import waits
from edmctl.machine.controller import LinkMachine
from edmctl.machine.interface import SLICE_S
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import job_of
from edmctl.procedures.machining import run_job
from edmctl.profile.setup import Setup
from edmctl.record.rows import EventLevel, EventRow, NullRecorder, Row, RunEvent
from edmctl.results.progress import Progress
from edmctl.simulator import open_bench
from edmctl.simulator.injection import INJECTIONS, parse_injection

RECIPE = ('target={kind="depth",depth_um=12.0,tolerance_um=2.0}', "pulse.current_a=0.5", "measure.touches=2")
BY_CHANCE = (RunEvent.TOUCH_DOUBTED, RunEvent.DOUBT_WITHDRAWN, RunEvent.BELIEF_CONTRADICTED)
"""Warnings about measurements, which scatter."""
ANSWERS = (RunEvent.SHORT_RECOVERY, RunEvent.ARC_BURN_RECOVERY, RunEvent.STALL_JUMP, RunEvent.BREAKTHROUGH)
RATES_S = (SLICE_S, waits.VIRTUAL_SLICE_S)
LATER_S, LATER_SHARE = 0.1, 0.01

Ending = tuple[str, frozenset[str], float]
"""Code of the error, empty for none; reactions; seconds from the injection to the end by an error."""


class _Seen(NullRecorder):
    """Keeps what the host has done about a fault."""

    def __init__(self) -> None:
        self.reactions: set[str] = set()

    def append(self, row: Row) -> None:
        if isinstance(row, EventRow) and row.code in set(RunEvent):
            code = RunEvent(row.code)
            if code in ANSWERS or (row.level >= EventLevel.WARNING and code not in BY_CHANCE):
                self.reactions.add(code.name)

    def progress(self, p: Progress) -> None:
        """Show nothing."""

    def note(self, text: str) -> None:
        """Show nothing."""


def ending(inject: str, seed: int, slice_s: float) -> Ending:
    """Make a hole on a machine that breaks."""
    waits.VIRTUAL_SLICE_S = slice_s
    loaded, setup, seen = load_profile("cu270", RECIPE), Setup(), _Seen()
    bench = open_bench(bench_config(loaded, setup), seed)
    bench.inject(parse_injection(inject))
    session = Session(bench.direct_line(), Random(seed))
    code = ""
    try:
        session.open()
        run_job(
            LinkMachine(session), job_of(loaded.profile, setup, loaded.places), recorder=seen, observer=seen
        )
    except EdmError as error:
        code = error.code
    found_s = bench.transport.now_s()
    applied = bench.controller.injector.applied
    after_s = found_s - 1e-3 * applied[0][1] if applied and code else 0.0
    return code, frozenset(seen.reactions), after_s


def shown(endings: Iterable[Ending]) -> str:
    """Return how often jobs ended in which way."""
    counts = Counter(
        f"{code or 'no error'} ({', '.join(sorted(done)) or 'no reaction'})" for code, done, _ in endings
    )
    return "; ".join(f"{n} × {what}" for what, n in sorted(counts.items()))


def main() -> int:
    """Compare every injection, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=sorted(INJECTIONS))
    arguments = parser.parse_args()
    seeds, differ = range(arguments.first, arguments.first + arguments.seeds), 0
    with ProcessPoolExecutor(arguments.jobs) as pool:
        made = {
            name: [[pool.submit(ending, name, seed, rate_s) for seed in seeds] for rate_s in RATES_S]
            for name in arguments.only
        }
        for name, rates in made.items():
            often, seldom = [[one.result() for one in rate] for rate in rates]
            after_s = [median(one[2] for one in rate) for rate in (often, seldom)]
            later = after_s[1] > after_s[0] + max(LATER_S, LATER_SHARE * after_s[0])
            same = shown(often) == shown(seldom)
            differ += later or not same
            mark = "" if same and not later else "  DIFFERS"
            print(f"{name:20s} {after_s[0]:8.3f} s {after_s[1]:8.3f} s  {shown(seldom)}{mark}")
            if not same:
                print(f"{'':20s} at 0.1 s: {shown(often)}")
    print(f"{len(made)} injections, {differ} differ")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
