"""How deep the shipped holes come out in good and bad flushing, how well it is known, what measuring costs.

    python benchmarks/depth.py [--runs 40] [--seed 1] [--profiles cu150 cu270 w252] [--removal 1.5] [--sensor 2]
        [--spread 0.15]

Every figure comes from `edmctl simulate --json`, judged by the plant's truth. Bars: 95 % of the holes within 1 % of
the depth or 1.5 µm, whichever is larger; the stated 95 % interval holds the truth in 90 %; for cu270 the median time
of everything that is not machining is at most a quarter of the machining time. With `--removal` the plant removes so
many times what the profile believes. With `--sensor` gain, drift and tilt scatter by so many times what the setup
states: then what is stated cannot hold, and the bar is that a job which ended with exit code 0 is within the bar of
depth and the tolerance of its profile together in 95 %. With `--spread` machines differ by so much from the book.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from edmctl.profile.model import SimSettings
from edmctl.profile.setup import Setup

TARGET_UM = {"cu270": 180.0, "cu150": 175.0, "w252": 240.0}
TOLERANCE_UM = 2.0
"""Of the shipped profiles."""
FLUSHING = {"good": 0.5, "bad": 3.0, "very bad": 10.0}
"""Time constant of the debris' clearance of a shallow gap of 270 µm, s."""


@dataclass(frozen=True)
class Case:
    """The runs of one profile in one oil."""

    profile: str
    flushing: str
    runs: list[dict[str, Any]]
    failed: list[str]
    reported: bool = False
    is_other: bool = False
    """The plant is not what the profile believes: nobody could foresee its times."""

    @property
    def bar_um(self) -> float:
        """Permitted error of the true depth."""
        return max(1.5, 0.01 * TARGET_UM[self.profile])

    def errors_um(self) -> list[float]:
        """True depth less the target."""
        return [run["truth"]["depth_um"] - TARGET_UM[self.profile] for run in self.runs]

    def row(self, total: int) -> str:
        """One line of the table, with whether it meets the bars."""
        errors = self.errors_um()
        near = sum(abs(error) <= self.bar_um for error in errors) / total
        covered = sum(_is_covered(run) for run in self.runs) / total
        share = statistics.median(
            (run["time_s"] - run["machining_time_s"]) / run["machining_time_s"] for run in self.runs
        )
        machining_s = statistics.fmean(run["machining_time_s"] for run in self.runs)
        met = near >= 0.95 and covered >= 0.9 and (self.profile != "cu270" or share <= 0.25 or self.is_other)
        if self.reported:  # an exit code of 0 promises the tolerance, and the stated interval is too narrow
            promised = self.bar_um + TOLERANCE_UM
            met = sum(abs(error) <= promised for error in errors) / max(1, len(errors)) >= 0.95
        cells = (
            f"{self.profile:<6} {self.flushing:<9}",
            f"{100 * near:5.1f} % within {self.bar_um:.2f} µm",
            f"bias {statistics.fmean(errors):+.2f} worst {max(map(abs, errors)):.2f} µm",
            f"covered {100 * covered:5.1f} %",
            f"machining {machining_s:5.0f} s, else {100 * share:4.1f} %",
            f"failed {len(self.failed)}",
            "ok" if met else "MISSED",
        )
        return "   ".join(cells)


def _is_covered(run: dict[str, Any]) -> bool:
    return bool(abs(run["truth"]["depth_um"] - run["depth_um"]) <= run["depth_u95_um"])


def simulate(
    profile: str,
    flushing: str,
    runs: int,
    seed: int,
    more: list[str],
    *,
    reported: bool = False,
    is_other: bool = False,
) -> Case:
    """Run a profile over consecutive seeds, with more options of `edmctl simulate`."""
    command = [sys.executable, "-m", "edmctl", "simulate", "--profile", profile, "--json"]
    command += [
        "--runs",
        str(runs),
        "--seed",
        str(seed),
        "--set",
        f"sim.flush_time_s={FLUSHING[flushing]}",
        *more,
    ]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False)
    found = json.loads(done.stdout)["result"]["cases"][0]["runs"]
    failed = [f"seed {run['seed']}: {run['error']}" for run in found if not run["ok"]]
    return Case(profile, flushing, [run for run in found if run["ok"]], failed, reported, is_other)


def main() -> None:
    """Run everything, print the table, and exit with 1 when a bar was missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--profiles", nargs="+", default=list(TARGET_UM))
    parser.add_argument("--flushing", nargs="+", default=["good", "bad"])
    parser.add_argument("--removal", type=float, default=1.0)
    parser.add_argument("--sensor", type=float, default=1.0)
    parser.add_argument("--spread", type=float, default=SimSettings().spread)
    args = parser.parse_args()
    with TemporaryDirectory() as folder:
        met = measure(args, options_of(args, Path(folder)))
    sys.exit(0 if met else 1)


def options_of(args: argparse.Namespace, folder: Path) -> list[str]:
    """Options of `edmctl simulate` for a plant that differs from profile and setup."""
    more = ["--set", f"sim.spread={args.spread:g}"]
    if args.removal != 1.0:
        more += ["--set", f"sim.removal_um3_per_uj={args.removal * SimSettings().removal_um3_per_uj:.6g}"]
    if args.sensor != 1.0:
        sensor, surface = Setup().sensor, Setup().surface
        setup = folder / "setup.toml"
        setup.write_text(
            f"[sensor]\ngain_u_rel = {sensor.gain_u_rel / args.sensor:.6g}\n"
            f"drift_um_per_s = {sensor.drift_um_per_s / args.sensor:.6g}\n"
            f"[surface]\ntilt_u_mrad = {surface.tilt_u_mrad / args.sensor:.6g}\n"
        )
        more += ["--setup", str(setup)]
    return more


def measure(args: argparse.Namespace, more: list[str]) -> bool:
    """Run everything and print the table; whether all bars are met."""
    met = True
    for profile in args.profiles:
        for flushing in args.flushing:
            case = simulate(
                profile,
                flushing,
                args.runs,
                args.seed,
                more,
                reported=args.sensor != 1.0,
                is_other=args.removal != 1.0 or args.spread > SimSettings().spread,
            )
            row = case.row(args.runs)
            print(row, flush=True)
            for failure in case.failed:
                print("   ", failure)
            met = met and row.endswith("ok")
    return met


if __name__ == "__main__":
    main()
