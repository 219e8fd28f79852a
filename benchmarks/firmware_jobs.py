"""Do jobs on virtual machines under the virtual controller and under the firmware's core, and compare the results.

    python benchmarks/firmware_jobs.py [--seeds 10] [--from 1] [--only machine array channel wear jump calibrate]

The results have to be equal in every figure. With --float the core in a board's arithmetic runs as well, and what it
made of depth and wear is told beside. Ends with 1 where two results differ.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from typing import TYPE_CHECKING, Any

import edmctl

if TYPE_CHECKING:
    from collections.abc import Callable

HURRIED = ("approach.speed_um_s=5", "measure.fast_um_s=50", "measure.settle_s=0.2", "measure.dwell_s=0.1")
SHALLOW = ("target.depth_um=8", *HURRIED)
OWN = ("run_file", "run_id", "journal", "path", "file", "calibration_file")
"""What no two runs have in common."""

JOBS: dict[str, Callable[[edmctl.Machine, str], Any]] = {
    "machine": lambda m, out: m.machine("cu270", overrides=SHALLOW, out=out),
    "array": lambda m, out: m.machine("array-3x3", overrides=SHALLOW, out=out),
    "channel": lambda m, out: m.machine("channel-circle", overrides=("target.depth_um=4", *HURRIED), out=out),
    "wear": lambda m, out: m.measure_wear("cu270", reference=True, overrides=HURRIED, out=out),
    "jump": lambda m, out: m.jump_flush("cu270", overrides=HURRIED, out=out),
    "calibrate": lambda m, out: m.calibrate(output=f"{out}/calibration.toml"),
}


def figures(value: object, path: str = "") -> dict[str, object]:
    """Return every value of a result by its path."""
    if isinstance(value, dict):
        return {
            k: v
            for key, part in value.items()
            if key not in OWN
            for k, v in figures(part, f"{path}/{key}").items()
        }
    if isinstance(value, list | tuple):
        return {k: v for at, part in enumerate(value) for k, v in figures(part, f"{path}/{at}").items()}
    return {path: value}


def result_of(job: str, seed: int, controller: str) -> dict[str, object]:
    """Do a job and return its figures."""
    with tempfile.TemporaryDirectory() as folder:
        machine = edmctl.connect("sim:", seed=seed, controller=controller, home=folder)
        return figures(JOBS[job](machine, folder).to_dict())


def main() -> int:
    """Do the jobs; 1 where two results differ."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--from", dest="first", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=JOBS, default=list(JOBS))
    parser.add_argument("--float", dest="with_float", action="store_true")
    options = parser.parse_args()
    apart = 0
    for job in options.only:
        for seed in range(options.first, options.first + options.seeds):
            exact, core = result_of(job, seed, "python"), result_of(job, seed, "firmware")
            others = [
                f"{key}: {exact.get(key)} {core.get(key)}"
                for key in {*exact, *core}
                if exact.get(key) != core.get(key)
            ]
            apart += bool(others)
            print(
                f"{job}, seed {seed}: {len(exact)} figures, {len(others)} differ {others[:5] or ''}",
                flush=True,
            )
            if options.with_float:
                board = result_of(job, seed, "firmware-float")
                told = [key for key in exact if key.endswith(("/depth_um", "/wear_um", "/depth_u95_um"))]
                print(
                    "  " + ", ".join(f"{key} {exact[key]} {board.get(key)}" for key in told[:6]), flush=True
                )
    return 1 if apart else 0


if __name__ == "__main__":
    sys.exit(main())
