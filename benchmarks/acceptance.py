"""Print how the virtual machine reproduces the paper's holes, and how well depth targets are met.

    python benchmarks/acceptance.py [--runs 20] [--depth-runs 40] [--seed 1]

Every figure comes from `edmctl simulate --json`: the whole host over real frames, judged by the plant's truth.
The bars beside them are those of Muralidhara et al. 2009 (180/70 µm with copper, 240/10 µm with tungsten at
250 µm of feed, a time ratio of 2.9 between the 270 and 150 µm tools) and this project's own depth bar.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass

FEED_250 = 'target={kind="feed",feed_um=250}'


@dataclass(frozen=True)
class Line:
    """One figure against its bar."""

    what: str
    value: float
    low: float
    high: float

    @property
    def met(self) -> bool:
        """Whether the figure lies within its bar."""
        return self.low <= self.value <= self.high

    def __str__(self) -> str:
        verdict = "ok" if self.met else "MISSED"
        return f"{self.what:<58} {self.value:9.3f}   [{self.low:g} … {self.high:g}]   {verdict}"


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


def mean(runs: list[dict[str, float]], key: str) -> float:
    """Mean of one figure over the runs."""
    return sum(run[key] for run in runs) / len(runs)


def paper_lines(runs: int, seed: int) -> list[Line]:
    """The holes of the paper at 250 µm of feed, by the plant's truth."""
    cu270 = simulate("cu270", runs, seed, FEED_250)
    w252 = simulate("w252", runs, seed, FEED_250)
    cu150 = simulate("cu150", runs, seed, FEED_250)
    double = simulate("cu150", runs, seed, FEED_250, "pulse.current_a=0.24")
    time_270, time_150 = mean(cu270, "machining_time_s"), mean(cu150, "machining_time_s")
    return [
        Line("Cu 270 true depth, µm", mean(cu270, "true_depth_um"), 177, 183),
        Line("Cu 270 true wear, µm", mean(cu270, "true_wear_um"), 67, 73),
        Line("W 252 true depth, µm", mean(w252, "true_depth_um"), 237, 243),
        Line("W 252 true wear, µm", mean(w252, "true_wear_um"), 8.5, 11.5),
        Line("machining time Cu 270 : Cu 150", time_270 / time_150, 2.75, 3.05),
        Line(
            "Cu 150 shortened by twice the current, %",
            100.0 * (1.0 - mean(double, "machining_time_s") / time_150),
            35,
            50,
        ),
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--depth-runs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    met = True
    for lines in (
        paper_lines(args.runs, args.seed),
        depth_lines("cu270", args.depth_runs, args.seed),
    ):
        for line in lines:
            print(line, flush=True)
            met = met and line.met
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
