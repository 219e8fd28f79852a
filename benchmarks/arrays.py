"""What grows with the number of holes and of runs: `python -m benchmarks.arrays [--turns 3] [--runs 64]`.

Processor time per hole of an array of 25 holes and of one of 100, made in turns in one process, on a fresh virtual
machine and on one in a file, which keeps a journal. Then the most memory of a process during the first run of a job
and during all, as a worker of `edmctl simulate` makes them. Exit code 1 where a hole of 100 costs more than 1.05
times one of 25 on a fresh machine, or memory grows by more than 15 %. `--turns 0` measures memory alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from typing import TYPE_CHECKING

import edmctl
from edmctl.start_up import spare_start_up

if TYPE_CHECKING:
    from collections.abc import Sequence

SIDES = (5, 10)
COST_BAR, MEMORY_BAR = 1.05, 1.15
SHALLOW = ("target.depth_um=4.0", "target.tolerance_um=2.0")


def cost_s(side: int, port: str, out: Path) -> float:
    """Processor time per hole of a square array, s."""
    grid = (
        f'sites=[{{kind="grid",x_um=500.0,y_um=-900.0,columns={side},rows={side},dx_um=260.0,dy_um=260.0}}]'
    )
    limits = ("tool.max_wear_um=2000.0", "limits.max_time_s=100000.0")
    begin_s = time.process_time()
    report = edmctl.connect(port, seed=3).machine("array-3x3", overrides=(*SHALLOW, *limits, grid), out=out)
    if report.error is not None:
        raise report.error
    return (time.process_time() - begin_s) / side**2


def ratio_of_costs(turns: int, folder: Path, *, lasting: bool) -> float:
    """Measure both arrays in turns, print their least costs, and return the ratio."""
    costs_s: dict[int, list[float]] = {side: [] for side in SIDES}
    for turn in range(turns):
        for side in SIDES:
            name = f"{'file' if lasting else 'fresh'}-{side}-{turn}"
            port = f"sim:{folder / name}.h5" if lasting else "sim:"
            costs_s[side].append(cost_s(side, port, folder / name))
    few_s, many_s = (min(costs_s[side]) for side in SIDES)
    where = "sim:FILE" if lasting else "sim:"
    print(
        f"{where}: {1e3 * few_s:.1f} ms per hole of 25, {1e3 * many_s:.1f} ms of 100: {many_s / few_s:.3f} times"
    )
    return many_s / few_s


def growth(runs: int) -> float:
    """Make runs as a worker does, and return the most memory of all runs over that of the first."""
    from edmctl.jobs.batch import cases_of, perform, tasks_of
    from edmctl.jobs.parallel import silent_program
    from edmctl.jobs.plan import JobRequest
    from edmctl.jobs.surroundings import Surroundings

    cases = cases_of(JobRequest("cu270", SHALLOW, None, "sim:"), (), runs, Surroundings())
    peaks_mb: list[float] = []
    for task in tasks_of(cases, 1, runs, None):
        perform(task, silent_program())
        peaks_mb.append(getrusage(RUSAGE_SELF).ru_maxrss / 1024.0)
    ratio = peaks_mb[-1] / peaks_mb[0]
    print(f"memory {peaks_mb[0]:.1f} MB in one run, {peaks_mb[-1]:.1f} MB in {runs}: {ratio:.3f} times")
    return ratio


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--runs", type=int, default=64)
    given = parser.parse_args(arguments)
    spare_start_up()
    memory = growth(given.runs)
    if not given.turns:
        return int(memory > MEMORY_BAR)
    with tempfile.TemporaryDirectory() as folder:
        cost_s(2, "sim:", Path(folder) / "warm")
        fresh = ratio_of_costs(given.turns, Path(folder), lasting=False)
        ratio_of_costs(given.turns, Path(folder), lasting=True)
    return int(fresh > COST_BAR or memory > MEMORY_BAR)


if __name__ == "__main__":
    sys.exit(main())
