"""Compare results of virtual jobs with those of another checkout, seed by seed: a change of arithmetic shifts none.

    python benchmarks/paired_seeds.py --against PATH [--runs 200] [--seed 1] [--profile cu270] [--set KEY=VALUE …]

Both simulate the same seeds. Errors are the stated depth and wear less the truth of the plant. Printed are the
mean shift in standard deviations of the other's and the ratio of the standard deviations, with 95 % intervals by
bootstrap over the pairs. Bars, but for the time of the whole job: a shift of at most 0.2, a ratio of 0.9 to 1.1, at
most 2 % more jobs that end early. Without --set the holes are 10 µm deep.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import options

Run = dict[str, Any]
MOST_SHIFT, RATIOS, MOST_LOST = 0.2, (0.9, 1.1), 0.02
QUANTITIES: dict[str, Callable[[Run], float]] = {
    "depth error, µm": lambda run: run["depth_um"] - run["truth"]["depth_um"],
    "wear error, µm": lambda run: run["wear_um"] - run["truth"]["wear_um"],
    "true depth, µm": lambda run: run["truth"]["depth_um"],
    "true wear, µm": lambda run: run["truth"]["wear_um"],
    "cut time, s": lambda run: run["machining_time_s"],
    "job time, s": lambda run: run["time_s"],
}
WITHOUT_BAR = ("job time, s",)
"""A host that waits less shortens jobs."""


def simulated(root: Path, options: list[str]) -> dict[int, Run]:
    """Return the runs of a checkout by their seeds, those that ended well."""
    command = [sys.executable, "-m", "edmctl", "simulate", "--json", *options]
    environ = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run(command, cwd=root, env=environ, stdout=subprocess.PIPE, check=False)
    runs = json.loads(done.stdout)["result"]["cases"][0]["runs"]
    return {run["seed"]: run for run in runs if run["ok"]}


def shift_and_ratio(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return the mean shift in standard deviations and the ratio of the standard deviations, along the last axis."""
    sd = there.std(axis=-1, ddof=1)
    return np.array([(here - there).mean(axis=-1) / sd, here.std(axis=-1, ddof=1) / sd])


def main() -> int:
    """Compare and print; the exit code is 1 where a bar is missed."""
    arguments = options(__doc__, against="", runs=200, seed=1, profile="cu270", set=["target.depth_um=10"])
    command = ["--profile", arguments.profile, "--runs", str(arguments.runs), "--seed", str(arguments.seed)]
    for value in arguments.set:
        command += ["--set", value]
    roots = (Path(__file__).resolve().parents[1], Path(arguments.against).resolve())
    here, there = (simulated(root, command) for root in roots)
    pairs = [(here[seed], there[seed]) for seed in sorted(here.keys() & there.keys())]
    lost = [arguments.runs - len(runs) for runs in (here, there)]
    missed = lost[0] > lost[1] + MOST_LOST * arguments.runs
    print(f"{len(pairs)} pairs; jobs that ended early: {lost[0]}, other {lost[1]}")
    draws = np.random.default_rng(1).integers(len(pairs), size=(2000, len(pairs)))
    for name, quantity in QUANTITIES.items():
        a, b = (np.array([quantity(pair[side]) for pair in pairs]) for side in (0, 1))
        shift, ratio = shift_and_ratio(a, b)
        low, high = np.percentile(shift_and_ratio(a[draws], b[draws]), (2.5, 97.5), axis=-1)
        is_met = name in WITHOUT_BAR or (abs(shift) <= MOST_SHIFT and RATIOS[0] <= ratio <= RATIOS[1])
        missed |= not is_met
        print(
            f"{name:16} {a.mean():8.3f} ± {a.std(ddof=1):7.3f}, other {b.mean():8.3f} ± {b.std(ddof=1):7.3f}; "
            f"shift {shift:+.3f} sd ({low[0]:+.2f} to {high[0]:+.2f}), "
            f"ratio {ratio:.3f} ({low[1]:.2f} to {high[1]:.2f}){'' if is_met else '  MISSED'}"
        )
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
