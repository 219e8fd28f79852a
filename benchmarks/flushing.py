"""Print what jumps are worth in clean and in badly flushed oil, and whether adaptive jumps meet their bars.

    python benchmarks/flushing.py [--seeds 4] [--first-seed 101] [--profile cu270]

Whole jobs of a shipped recipe on the virtual machine, with flush time constants of 0.5 s (clean), 3 s and 10 s:
without jumps, with fixed jumps every 10 s and every 2 s, and with adaptive ones. Jobs without jumps arc more than
`limits.arc_ratio` allows, so that limit is 1 in all of them. The law was chosen on the seeds 1 to 4.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import mean

FLUSH_TIMES_S = (0.5, 3.0, 10.0)
MODES = {
    "off": ('jump.mode="off"',),
    "fixed 10 s": ('jump.mode="fixed"', "jump.period_s=10"),
    "fixed 2 s": ('jump.mode="fixed"', "jump.period_s=2"),
    "adaptive": ('jump.mode="adaptive"',),
}
PROCESSES = 2


@dataclass(frozen=True)
class Found:
    """What one job took, and what the plant says of it."""

    machining_time_s: float
    arcs: float
    depth_um: float


def machined(home: Path, profile: str, flush_time_s: float, mode: str, seed: int) -> Found:
    """Run one job in a process of its own."""
    command = [sys.executable, "-m", "edmctl", "machine", "--profile", profile, "--seed", str(seed)]
    command += ["--json", "--quiet", "--out", str(home / f"{flush_time_s}-{mode}-{seed}")]
    for override in (*MODES[mode], f"sim.flush_time_s={flush_time_s}", "limits.arc_ratio=1"):
        command += ["--set", override]
    environment = {**os.environ, "EDMCTL_HOME": str(home), "PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(
        command,
        cwd=home,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        check=False,
    )
    answer = json.loads(done.stdout)
    if not answer["ok"]:
        raise SystemExit(f"{' '.join(command)}: {answer['error']}")
    (site,) = answer["result"]["sites"]
    return Found(site["machining_time_s"], site["ratios"]["arc"], site["truth"]["depth_um"])


def bars(found: dict[tuple[float, str], list[Found]]) -> list[tuple[str, float, float, float]]:
    """Every figure with the interval that it should lie in, of the means over the seeds."""

    def time_s(flush_time_s: float, mode: str) -> float:
        return mean(one.machining_time_s for one in found[flush_time_s, mode])

    def arcs(flush_time_s: float, mode: str) -> float:
        return mean(one.arcs for one in found[flush_time_s, mode])

    lines = [("clean: adaptive over none, time", time_s(0.5, "adaptive") / time_s(0.5, "off"), 0.0, 1.02)]
    for flush_time_s, most in ((3.0, 0.85), (10.0, 0.70)):
        ratio = time_s(flush_time_s, "adaptive") / time_s(flush_time_s, "off")
        lines.append((f"{flush_time_s:g} s: adaptive over none, time", ratio, 0.0, most))
        fewer = arcs(flush_time_s, "off") / arcs(flush_time_s, "adaptive")
        lines.append((f"{flush_time_s:g} s: none over adaptive, arcs", fewer, 3.0, float("inf")))
    for flush_time_s in FLUSH_TIMES_S:
        ratio = time_s(flush_time_s, "adaptive") / time_s(flush_time_s, "fixed 10 s")
        lines.append((f"{flush_time_s:g} s: adaptive over fixed 10 s, time", ratio, 0.0, 1.03))
    return lines


def main() -> None:
    """Run everything, print both tables, and exit with 1 when a bar was missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=101)
    parser.add_argument("--profile", default="cu270")
    args = parser.parse_args()
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    cases = list(product(FLUSH_TIMES_S, MODES, seeds))
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(PROCESSES) as pool:
        jobs = [pool.submit(machined, Path(folder), args.profile, *case) for case in cases]
        results = [job.result() for job in jobs]
    found: dict[tuple[float, str], list[Found]] = {}
    for (flush_time_s, mode, _), one in zip(cases, results, strict=True):
        found.setdefault((flush_time_s, mode), []).append(one)
    print(
        f"{'flush, s':>8} {'jumps':<11}{'machining, s':>13}{'over none':>11}{'arcs, %':>9}{'depth, µm':>11}"
    )
    for (flush_time_s, mode), ones in found.items():
        time_s = mean(one.machining_time_s for one in ones)
        none_s = mean(one.machining_time_s for one in found[flush_time_s, "off"])
        arcs, depth_um = mean(one.arcs for one in ones), mean(one.depth_um for one in ones)
        row = f"{time_s:13.0f}{time_s / none_s:11.3f}{100 * arcs:9.2f}{depth_um:11.2f}"
        print(f"{flush_time_s:8g} {mode:<11}{row}")
    met = True
    for what, value, low, high in bars(found):
        inside = low <= value <= high
        met = met and inside
        print(f"{what:<42}{value:8.3f}   [{low:g} … {high:g}]   {'ok' if inside else 'MISSED'}")
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
