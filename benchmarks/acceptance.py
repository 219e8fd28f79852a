"""Print how the virtual machine reproduces the paper's holes, and how well depth targets are met.

    python benchmarks/acceptance.py [--runs 20] [--groups 1] [--depth-runs 40] [--seed 9001]

Every figure comes from `edmctl simulate --json`: the whole host over real frames, compared with the plant's truth.
The bars are those of Muralidhara et al. 2009 (180/70 µm with copper, 240/10 µm with tungsten at 250 µm of feed, a
time ratio of 2.9 between the 270 and 150 µm copper tools) and this project's own depth bar. Each group has seeds of
its own. ± is the standard error of a mean over its machines. `--depth-runs 0` prints the paper's holes alone.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import dataclass
from statistics import fmean, stdev

from benchmarks.common import options

FEED_250 = 'target={kind="feed",feed_um=250}'


@dataclass(frozen=True)
class Line:
    """One figure against its bar."""

    what: str
    value: float
    low: float
    high: float
    u: float = 0.0
    """Standard error of the figure."""

    @property
    def met(self) -> bool:
        """Whether the figure lies within its bar."""
        return self.low <= self.value <= self.high

    def __str__(self) -> str:
        verdict = "ok" if self.met else "MISSED"
        value = f"{self.value:9.3f}" + (f" ± {self.u:.3f}" if self.u else "")
        return f"{self.what:<58} {value:<17}   [{self.low:g} … {self.high:g}]   {verdict}"


def simulate(profile: str, runs: int, seed: int, *overrides: str) -> list[dict[str, float]]:
    """Run a profile over consecutive seeds and return what each run reached."""
    command = [sys.executable, "-m", "edmctl", "simulate", "--profile", profile, "--json"]
    command += ["--runs", str(runs), "--seed", str(seed)]
    for override in overrides:
        command += ["--set", override]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False)
    answer = json.loads(done.stdout)
    if not answer["ok"]:
        raise SystemExit(f"{' '.join(command)}: {answer['error']}")
    found = answer["result"]["cases"][0]["runs"]
    return [{**run, **{f"true_{key}": value for key, value in run["truth"].items()}} for run in found]


def mean(what: str, runs: list[dict[str, float]], key: str, low: float, high: float) -> Line:
    """Mean of one figure over the runs, with its standard error."""
    values = [run[key] for run in runs]
    return Line(what, fmean(values), low, high, stdev(values) / math.sqrt(len(values)))


def paper_lines(runs: int, seed: int) -> list[Line]:
    """The holes of the paper at 250 µm of feed, by the plant's truth."""
    cu270 = simulate("cu270", runs, seed, FEED_250)
    w252 = simulate("w252", runs, seed, FEED_250)
    cu150 = simulate("cu150", runs, seed, FEED_250)
    double = simulate("cu150", runs, seed, FEED_250, "pulse.current_a=0.24")
    time_270, time_150, time_double = (
        fmean(run["machining_time_s"] for run in found) for found in (cu270, cu150, double)
    )
    return [
        mean("Cu 270 true depth, µm", cu270, "true_depth_um", 178.5, 181.5),
        mean("Cu 270 true wear, µm", cu270, "true_wear_um", 68.5, 71.5),
        mean("W 252 true depth, µm", w252, "true_depth_um", 238.5, 241.5),
        mean("W 252 true wear, µm", w252, "true_wear_um", 9.0, 11.0),
        Line("machining time Cu 270 : Cu 150", time_270 / time_150, 2.8, 3.0),
        Line("Cu 150 shortened by twice the current, %", 100.0 * (1.0 - time_double / time_150), 35, 50),
    ]


def depth_lines(profile: str, runs: int, seed: int) -> list[Line]:
    """Depth-to-target of a profile as shipped."""
    found = simulate(profile, runs, seed)
    target_um = {"cu270": 180.0, "cu150": 175.0, "w252": 240.0}[profile]
    near = sum(abs(run["true_depth_um"] - target_um) <= 2.0 for run in found)
    covered = sum(abs(run["true_depth_um"] - run["depth_um"]) <= run["depth_u95_um"] for run in found)
    worst = max(abs(run["true_depth_um"] - target_um) for run in found)
    return [
        Line(f"{profile}: runs within 2 µm of {target_um:g} µm, %", 100.0 * near / runs, 95, 100),
        Line(f"{profile}: 95 % interval covers the truth, %", 100.0 * covered / runs, 90, 100),
        Line(f"{profile}: worst depth error, µm (no bar)", worst, 0, 99),
    ]


def main() -> None:
    """Run everything, print the table, and exit with 1 when a bar was missed."""
    args = options(__doc__, runs=20, groups=1, depth_runs=40, seed=9001)
    met = True
    for group in range(args.groups + 1):
        if group < args.groups:
            lines = paper_lines(args.runs, args.seed + group * args.runs)
        else:
            lines = depth_lines("cu270", args.depth_runs, args.seed) if args.depth_runs else []
        for line in lines:
            print(line, flush=True)
            met = met and line.met
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
