"""Do jobs on virtual machines under the core in double and in a board's arithmetic, and compare the results.

    python benchmarks/firmware_jobs.py [--seeds 10] [--first 1] [--only machine array channel wear jump calibrate]

Sparks come out otherwise in float, so its figures are held against the 95 % intervals that the results state: the
difference to the result in double against both intervals together, after the difference of the true values where the
plant knows them (the holes are not the same), and the true value against its own interval. A table says how often
each was within. Ends with 1 where a figure of a job was outside more often than its confidence allows.
"""

from __future__ import annotations

import math
import statistics
import sys
import tempfile
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import edmctl
from benchmarks.common import options

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

HURRIED = ("approach.speed_um_s=5", "measure.fast_um_s=50", "measure.settle_s=0.2", "measure.dwell_s=0.1")
SHALLOW = ("target.depth_um=8", *HURRIED)
OWN = ("run_file", "run_id", "journal", "path", "file", "calibration_file")
"""What no two runs have in common."""


def worn(machine: edmctl.Machine, out: str) -> Any:
    """Machine a hole between two measurements of the tool, and return the second."""
    machine.measure_wear("cu270", reference=True, overrides=HURRIED, out=out)
    machine.machine("cu270", overrides=SHALLOW, out=out)
    return machine.measure_wear("cu270", overrides=HURRIED, out=out)


JOBS: dict[str, Callable[[edmctl.Machine, str], Any]] = {
    "machine": lambda m, out: m.machine("cu270", overrides=SHALLOW, out=out),
    "array": lambda m, out: m.machine("array-3x3", overrides=SHALLOW, out=out),
    "channel": lambda m, out: m.machine("channel-circle", overrides=("target.depth_um=4", *HURRIED), out=out),
    "wear": worn,
    "jump": lambda m, out: m.jump_flush("cu270", overrides=HURRIED, out=out),
    "calibrate": lambda m, out: m.calibrate(output=f"{out}/calibration.toml"),
}

NORMAL_95 = 1.96
STATED = {
    "depth_um": ("depth_u95_um", 1.0),
    "wear_um": ("wear_u95_um", 1.0),
    "feed_um": ("feed_u95_um", 1.0),
    "found": ("found_u", NORMAL_95),
    "gain_um_per_v": ("gain_sd_um_per_v", NORMAL_95),
    "loop_width": ("loop_width_sd", NORMAL_95),
    "gamma_per_decade": ("gamma_sd_per_decade", NORMAL_95),
}
"""Figures with an interval: what states it beside them, and how many of that are half of a 95 % one."""
STUDENT_95 = 2.262
"""Of the scatter of ten heights: `jump_flush` states no interval, but shows how its jumps repeat."""
CONFIDENCE = 0.95
SELDOM = 0.02
"""A figure that is outside more often than chance alone brings it about in one benchmark of fifty is refused."""


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
        port = f"sim:{folder}/bench" if job == "wear" else "sim:"
        machine = edmctl.connect(port, seed=seed, controller=controller, home=folder)
        return figures(JOBS[job](machine, folder).to_dict())


def intervals(result: Mapping[str, object]) -> dict[str, tuple[float, float]]:
    """Return the figures of a result that have an interval by their path: value and half of the 95 % interval."""
    heights = [value for path, value in result.items() if path.endswith("/height_um")]
    repeated = STUDENT_95 * statistics.stdev(map(_number, heights)) if len(heights) > 1 else math.nan
    found = {}
    for path, value in result.items():
        group, _, name = path.rpartition("/")
        beside, factor = STATED.get(name, ("", math.nan))
        half = repeated if name == "height_um" else factor * _number(result.get(f"{group}/{beside}"))
        if math.isfinite(_number(value)) and math.isfinite(half):
            found[path] = _number(value), half
    return found


def true_value(result: Mapping[str, object], path: str) -> float:
    """Return what the plant knows of a figure; NaN where it knows nothing."""
    group, _, name = path.rpartition("/")
    return _number(result.get(f"{group}/truth/{name}"))


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


class Tally:
    """How often the intervals of jobs held, by job, figure and what they had to hold."""

    def __init__(self) -> None:
        self._held: defaultdict[tuple[str, str, str], list[bool]] = defaultdict(list)

    def add(self, job: str, exact: Mapping[str, object], board: Mapping[str, object]) -> None:
        """Take the results of a job under the core in double and in float.

        A figure that only the former has is not held.
        """
        told = intervals(board)
        for path, (value, half) in intervals(exact).items():
            name = "/".join(part for part in path.split("/") if part and not part.isdigit())
            other, other_half = told.get(path, (math.inf, 0.0))
            true, other_true = true_value(exact, path), true_value(board, path)
            apart, both = other - value, math.hypot(half, other_half)
            self._held[job, name, "difference as told"].append(abs(apart) <= both)
            if math.isfinite(true):
                self._held[job, name, "difference"].append(abs(apart - (other_true - true)) <= both)
                self._held[job, name, "truth"].append(abs(other - other_true) <= other_half)
                self._held[job, name, "truth, double"].append(abs(value - true) <= half)

    def judge(self) -> bool:
        """Print the table and return whether every figure was within often enough."""
        print(f"{'job':<10} {'figure':<22} {'held':<19} {'within':>9}  share  bar")
        well = True
        for (job, name, what), held in self._held.items():
            known = (job, name, "truth") in self._held
            judged = what in ("difference", "truth") or not known
            least = len(held) - most_outside(len(held))
            bad = judged and sum(held) < least
            well = well and not bad
            print(
                f"{job:<10} {name:<22} {what:<19} {f'{sum(held)}/{len(held)}':>9}  {sum(held) / len(held):5.2f}  "
                f"{least if judged else '-'}{'  OUTSIDE TOO OFTEN' if bad else ''}"
            )
        return well


def most_outside(count: int) -> int:
    """Return how many of so many 95 % intervals may miss: more would be chance in less than `SELDOM` cases."""
    for most in range(count):
        more = sum(
            math.comb(count, k) * (1 - CONFIDENCE) ** k * CONFIDENCE ** (count - k)
            for k in range(most + 1, count + 1)
        )
        if more < SELDOM:
            return most
    return count


def main() -> int:
    """Do the jobs; 1 where float is outside of its intervals."""
    given = options(__doc__, {"only": JOBS}, seeds=10, first=1, only=list(JOBS))
    tally = Tally()
    for job in given.only:
        for seed in range(given.first, given.first + given.seeds):
            exact = result_of(job, seed, "firmware")
            tally.add(job, exact, result_of(job, seed, "firmware-float"))
            print(f"{job}, seed {seed}: {len(exact)} figures", flush=True)
    return 0 if tally.judge() else 1


if __name__ == "__main__":
    sys.exit(main())
