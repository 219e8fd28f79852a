"""Print how deep the holes of the 3×3 array come out, and how many measuring stops that took.

    python benchmarks/nine_holes.py [--runs 20] [--seed 1]

Every figure comes from `edmctl simulate --json`, judged by the plant's truth. Bars: all depths within 2 µm, with at
most half the measuring stops of nine holes that are jobs of their own (the same recipe without its places).
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

HOLES = 9
BAR_UM = 2.0
TARGET_UM = 20.0


def simulate(profile: str, runs: int, seed: int) -> list[list[dict[str, Any]]]:
    """Run a profile over consecutive seeds and return the holes of each run."""
    command = [sys.executable, "-m", "edmctl", "simulate", "--profile", profile, "--json"]
    command += ["--runs", str(runs), "--seed", str(seed)]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False)
    answer = json.loads(done.stdout)
    if not answer["ok"]:
        raise SystemExit(f"{' '.join(command)}: {answer['error']}")
    return [run["sites"] for run in answer["result"]["cases"][0]["runs"]]


def alone(runs: int, seed: int) -> list[list[dict[str, Any]]]:
    """One hole of the same recipe, as a job of its own."""
    with tempfile.TemporaryDirectory() as folder:
        single = Path(folder) / "alone.toml"
        shipped = Path(__file__).parents[1] / "profiles" / "array-3x3.toml"
        single.write_text(f'extends = "{shipped}"\nsites = []\n', encoding="utf-8")
        return simulate(str(single), runs, seed)


def main() -> None:
    """Run both, print the figures, and exit with 1 when a bar was missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    arrays = simulate("array-3x3", args.runs, args.seed)
    holes = [hole for run in arrays for hole in run]
    errors = [abs(hole["truth"]["depth_um"] - TARGET_UM) for hole in holes]
    covered = statistics.fmean(
        abs(hole["truth"]["depth_um"] - hole["depth_um"]) <= hole["depth_u95_um"] for hole in holes
    )
    stops = statistics.fmean(sum(hole["measuring_stops"] for hole in run) for run in arrays)
    singles = [run[0]["measuring_stops"] for run in alone(args.runs, args.seed)]
    independent = HOLES * statistics.fmean(singles)
    met = max(errors) <= BAR_UM and stops <= independent / 2.0
    print(f"holes                 {len(holes)} in {len(arrays)} arrays")
    print(f"worst depth error     {max(errors):.2f} µm (bar {BAR_UM:g})")
    print(f"rms depth error       {statistics.fmean(e * e for e in errors) ** 0.5:.2f} µm")
    print(f"95 % interval covers  {100 * covered:.1f} %")
    print(f"stops per array       {stops:.2f} (bar {independent / 2.0:.2f}, half of nine holes alone)")
    print("ok" if met else "MISSED")
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
