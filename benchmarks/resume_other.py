"""What `--resume` does with other work and tools: `python -m benchmarks.resume_other [--count 20] [--jobs 2]`.

Each job is on a virtual bench in a file and is killed (SIGKILL) at an instant of the machine's time drawn evenly
over what it takes. The recipe believes another wear ratio (true × 0.3 to 2) and another removal (true × 0.3 to 5)
than the bench has. What is left is taken up four times: as it is; with untouched work; with the work half a
millimetre further on; with the tool seated anew by 10 to 30 µm. Exit code 1 where a job that is as it was left is
refused, or other work than was left is machined although the journal expects a hole that is deep enough to tell.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.resume import run_until
from benchmarks.serving import result, start
from edmctl.procedures.job import job_state
from edmctl.record.bench_file import read_bench, write_bench
from edmctl.record.journal import read_journal
from edmctl.simulator.saving import bench_state, restored_bench
from edmctl.simulator.workpiece import TILE

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.simulator import VirtualBench

PROFILE, RATIO, REMOVAL_UM3_PER_UJ = "cu270", 0.389, 0.0424
REFUSED = ("E8060", "E8061")
MISSED = "E62005"
"""No contact in reach: a refusal too, by the machine."""
LONGEST_S = 200.0
SURELY_UM = 25.0
"""A journal that expects so much cannot take an untouched face for its hole: 5 s of a cut and a belief are less."""


@dataclass(slots=True)
class Left:
    """One job: what its journal expected, µm, and how each way of going on ended (error code, empty when done)."""

    seed: int
    expected_um: float = 0.0
    phase: str = ""
    ends: dict[str, str] = field(default_factory=dict)

    def line(self) -> str:
        """One row of the table."""
        ends = ", ".join(f"{how} {end or 'done'}" for how, end in self.ends.items())
        return f"  {self.seed:4d}: left at {self.expected_um:5.1f} µm while {self.phase or 'nothing'}: {ends}"


def as_it_is(_: VirtualBench) -> None:
    """Nobody was there."""


def other_work(bench: VirtualBench) -> None:
    """Put in a board that nobody has cut."""
    bench.plant.leave()
    bench.plant.work_under_tool.holes.clear()
    bench.plant.work_under_tool.work.tiles.clear()
    bench.plant.arrive()


def moved_work(bench: VirtualBench) -> None:
    """Clamp the board half a millimetre further on."""
    ground = bench.plant.work_under_tool
    bench.plant.leave()
    tiles_on = round(500.0 / (TILE * ground.work.cell_um))
    ground.work.tiles = {
        (column + tiles_on, row): cells for (column, row), cells in ground.work.tiles.items()
    }
    for hole in ground.holes:
        hole.x_um += tiles_on * TILE * ground.work.cell_um
    bench.plant.arrive()


def seated_anew(way_um: float) -> Callable[[VirtualBench], None]:
    """Return what puts the tool in further out or in."""

    def change(bench: VirtualBench) -> None:
        bench.plant.state.wear_um += way_um
        bench.plant.arrive()

    return change


def one_job(home: Path, seed: int, depth_um: float) -> Left:
    """Kill a job, and go on with what is left in each way."""
    chance, done, folder = random.Random(seed), Left(seed), home / f"j{seed}"
    folder.mkdir()
    ratio = RATIO / chance.uniform(0.3, 2.0)
    removal = REMOVAL_UM3_PER_UJ / chance.uniform(0.3, 5.0)
    order = (
        *("machine", "-p", PROFILE, "--port", "sim:bench.h5", "--seed", str(seed), "--run-id", "a"),
        *("--set", f'target={{kind="depth",depth_um={depth_um},tolerance_um=2.0}}'),
        *("--set", f"wear.expected_ratio={ratio:.3f}", "--set", f"work.removal_um3_per_uj={removal:.4f}"),
        *("--set", 'log.pulses="off"'),
    )
    done.phase = run_until(folder, chance.uniform(20.0, LONGEST_S), *order)
    journal = folder / "runs" / "a.journal"
    state = job_state(read_journal(journal).state) if done.phase and journal.exists() else None
    if state is None or not state.begun:
        return done
    done.expected_um = state.depth_um
    way_um = chance.choice((-1.0, 1.0)) * chance.uniform(10.0, 30.0)
    ways = {"as left": as_it_is, "other work": other_work, "moved": moved_work, "tool": seated_anew(way_um)}
    for number, (how, change) in enumerate(ways.items()):
        copy = home / f"j{seed}-{number}"
        shutil.copytree(folder, copy)
        bench = restored_bench(read_bench(copy / "bench.h5"))
        change(bench)
        write_bench(copy / "bench.h5", bench_state(bench))
        arguments = ("machine", "--resume", "a", "--port", "sim:bench.h5", "--json", "-q")
        _, document, err = result(start(copy, *arguments))
        error = document.get("error") or {}
        done.ends[how] = str(error.get("code", "")) or ("" if document else err[-200:])
        shutil.rmtree(copy)
    return done


def main() -> int:
    """Run all and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--depth", type=float, default=60.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(arguments.jobs) as pool:
        seeds = range(arguments.seed, arguments.seed + arguments.count)
        rows = []
        for row in pool.map(lambda seed: one_job(Path(folder), seed, arguments.depth), seeds):
            if row.ends:
                rows.append(row)
                print(row.line(), flush=True)
    wrong = [row for row in rows if row.ends["as left"] in REFUSED]
    print(f"as it was left: {len(rows) - len(wrong)} of {len(rows)} taken up")
    for how in ("other work", "moved", "tool"):
        deep = [row for row in rows if how == "tool" or row.expected_um >= SURELY_UM]
        refused = [row for row in deep if row.ends[how] in (*REFUSED, MISSED)]
        print(f"{how}: {len(refused)} of {len(deep)} refused")
        if how != "tool":
            wrong += [row for row in deep if row not in refused]
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
