"""Whether a touch that is wrong is found: chips under the tool, touches that repeat, are scaled or absurd.

    python -m benchmarks.chips [--seeds 6] [--first-seed 2000] [--deep 2] [--clean 300] [--arrays 12]

Every chip is injected on a virtual machine under the first touch of a reading: Z1, Zr, or Z2 and Z3 of the first or
of the last measuring stop; of holes beside the pad, 5 mm and 15 mm from it, and of an array with a plane. The same
seed without a chip says how wide the interval is that the chip has to exceed. A chip is found where the stated 95 %
intervals of all depths and wears hold the plant's truth all the same, or the job is refused, or a decision tells of
the doubt. A wrong result that merely misses the target is not found: it has rows of its own. Bars: of those that
shift a result by more than the clean run's interval, 95 % found; at most 1 % of clean holes with an alarm.
`--missed` prints every chip that was not found.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from benchmarks.common import machine_on, machined, options
from edmctl.jobs.truth import TrueWear
from edmctl.planning.removal import of_tool
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import NoStateStore, job_of
from edmctl.profile.setup import Setup
from edmctl.record.rows import EventRow, NullRecorder, RunEvent, TouchRow
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.injection import parse_injection
from tests.machine.lying import LyingTouches

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from edmctl.record.rows import Row
    from edmctl.results.job import JobResult
    from edmctl.simulator.bench import HoleTruth

SIZES_UM = (1.0, 2.0, 4.0, 6.0, 9.0, 12.0, 16.0, 20.0)
DEPTHS_UM = (10.0, 20.0, 40.0)
DEEP_UM = 180.0
AWAY_UM = (5000.0, 15000.0)
AWAY_DEPTH_UM = 10.0
KINDS = ("Z1", "Zr", "Z2", "Z3")
SPOTS = 2
"""Touch-offs of a reading of the face."""
PLANE = (
    'sites=[{kind="grid",name="hole",x_um=1000,y_um=1000,columns=2,rows=2,dx_um=4000,dy_um=4000}]',
    'array={surface="plane"}',
)
"""Four holes, whose face is touched at three of them."""
FOUND_BAR, ALARM_BAR = 0.95, 0.01
DOUBTS = (RunEvent.TOUCH_DOUBTED, RunEvent.READING_REJECTED)
ARRAY = "profiles/array-3x3.toml"

JUDGED = ("E7010", "E7013")
"""Errors of a job that was done and is not what was wanted: they refuse no touch."""

LIES: Mapping[str, Callable[[float], float]] = {
    "0.5 µm more": lambda z_um: z_um + 0.5,
    "constant": lambda _: 50.0,
    "times 1.25": lambda z_um: 1.25 * z_um,
    "absurd": lambda _: 2_147_483.0,
}


@dataclass(slots=True)
class Ears(NullRecorder):
    """Keeps what kind each touch-off was of, and what was doubted."""

    kinds: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)

    def append(self, row: Row) -> None:
        """Keep the kind of a touch, and doubts."""
        if isinstance(row, TouchRow):
            self.kinds.append(row.kind)
        elif isinstance(row, EventRow) and row.code in DOUBTS:
            self.doubts.append(row.message)


@dataclass(frozen=True, slots=True)
class Outcome:
    """One job: its result or error, what was doubted, and whether its intervals hold the truth."""

    result: JobResult | None
    error: str
    doubts: list[str]
    kinds: list[str]
    covered: bool
    told: str
    time_s: float

    @property
    def alarmed(self) -> bool:
        """Whether something was told of a touch, or the job ended early."""
        return bool(self.doubts) or self.refused

    @property
    def refused(self) -> bool:
        """Whether the job ended early."""
        return bool(self.error) and not self.error.startswith(JUDGED)

    @property
    def found(self) -> bool:
        """Whether a wrong touch has done no harm that nobody was told of."""
        return self.covered or self.refused or bool(self.doubts)

    @property
    def only_judged(self) -> bool:
        """Whether a wrong result that nobody doubts is not called right either."""
        return not self.found and bool(self.error)


def perform(profile: str, seed: int, overrides: tuple[str, ...], inject: str = "", lie: str = "") -> Outcome:
    """Run a job on a fresh virtual machine."""
    loaded = load_profile(profile, overrides)
    config = BenchConfig(
        tool_diameter_um=loaded.profile.tool.diameter_um,
        tool_wear=of_tool(loaded.profile).factor,
        offset_um=loaded.profile.approach.offset_um,
    )
    bench = open_bench(config, seed)
    if inject:
        bench.inject(parse_injection(inject))
    line = LyingTouches(bench.transport, LIES[lie]) if lie else bench.transport
    machine, ears = machine_on(line, seed), Ears()
    job, wear = job_of(loaded.profile, Setup(), loaded.places), TrueWear(bench, NoStateStore())
    ledger, failed = machined(machine, job, wear, ears)
    error = f"{failed.code} {failed.message}" if failed else ""
    if not ledger.sites:
        return Outcome(None, error, ears.doubts, ears.kinds, error != "", error, ledger.time_s)
    result = ledger.result()
    covered, told = True, []
    for site in result.sites:
        hole = _hole_at(bench.truth(), site.x_um, site.y_um)
        worn_um = wear.of_site(site.name)
        covered = covered and abs(site.depth_um - hole.depth_um) <= site.depth_u95_um
        covered = covered and abs(site.wear_um - worn_um) <= site.wear_u95_um
        told.append(
            f"{site.depth_um:.2f} ± {site.depth_u95_um:.2f}, true {hole.depth_um:.2f}, "
            f"wear {site.wear_um:.2f} ± {site.wear_u95_um:.2f}, true {worn_um:.2f}"
        )
    return Outcome(result, error, ears.doubts, ears.kinds, covered, "; ".join(told), ledger.time_s)


def _hole_at(holes: Sequence[HoleTruth], x_um: float, y_um: float) -> HoleTruth:
    return min(holes, key=lambda hole: math.dist((hole.x_um, hole.y_um), (x_um, y_um)))


@dataclass(slots=True)
class Tally:
    """Counts of one class of wrong touches."""

    harmful: int = 0
    alarmed: int = 0
    covered: int = 0
    missed: int = 0
    only_judged: int = 0
    harmless: int = 0

    def take(self, outcome: Outcome, *, harmful: bool) -> None:
        """Count a job."""
        if not harmful:
            self.harmless += 1
            return
        self.harmful += 1
        self.alarmed += outcome.alarmed
        self.covered += outcome.covered
        self.missed += not outcome.found
        self.only_judged += outcome.only_judged

    def __str__(self) -> str:
        n = max(1, self.harmful)
        return (
            f"{self.harmful:4d} harmful: {100 * self.alarmed / n:5.1f} % told, "
            f"{100 * self.covered / n:5.1f} % covered or without a result, "
            f"{self.missed} not found ({self.harmless} harmless)"
        )


def target(depth_um: float) -> tuple[str, ...]:
    """Override the depth."""
    return (f"target.depth_um={depth_um:g}",)


def away(way_um: float) -> tuple[str, ...]:
    """A short hole so far from the pad."""
    return (*target(AWAY_DEPTH_UM), f"measure.site_dx_um={way_um:g}")


def places_of(kind: str, kinds: list[str]) -> set[int]:
    """Which touch-offs (from 1) begin a reading of that kind: of the first and of the last stop, of each Zr."""
    if kind == "Zr":
        return {i + 1 for i, one in enumerate(kinds) if one == kind and kinds[:i].count(kind) % SPOTS == 0}
    begins = [i + 1 for i, one in enumerate(kinds) if one == kind and (i == 0 or kinds[i - 1] != kind)]
    return {begins[0], begins[-1]}


def is_harmful(kind: str, size_um: float, clean: Outcome) -> bool:
    """Whether a chip shifts depth or wear by more than the clean run's interval."""
    assert clean.result is not None
    depth_u95_um = min(site.depth_u95_um for site in clean.result.sites)
    wear_u95_um = min(site.wear_u95_um for site in clean.result.sites)
    widths_um = {
        "Z1": [wear_u95_um],
        "Zr": [depth_u95_um],
        "Z2": [depth_u95_um],
        "Z3": [wear_u95_um, depth_u95_um],
    }
    return size_um > min(widths_um[kind])


def chips(seeds: range, jobs: Sequence[tuple[str, ...]], *, told: bool) -> dict[str, Tally]:
    """Chips of every size under every reading of jobs with these overrides, firm and loose."""
    tallies: dict[str, Tally] = {}
    for overrides in jobs:
        for seed in seeds:
            clean = perform("profiles/cu270.toml", seed, overrides)
            for kind in (kind for kind in KINDS if kind in clean.kinds):
                for number in places_of(kind, clean.kinds):
                    for size_um in SIZES_UM:
                        for name in ("CHIP", "LOOSE_CHIP"):
                            inject = f"{name}_{size_um:g}@touch{number}+0"
                            done = perform("profiles/cu270.toml", seed, overrides, inject)
                            harmful = is_harmful(kind, size_um, clean)
                            size = "up to 2 µm" if size_um <= 2.0 else "beyond"
                            tally = tallies.setdefault(f"{kind} {name:<10} {size:<10}", Tally())
                            tally.take(done, harmful=harmful)
                            if told and harmful and not done.found:
                                job = " ".join(overrides)
                                print(f"    missed: {job}, seed {seed}, {kind}, {inject}: {done.told}")
    return tallies


def lies(seeds: range) -> dict[str, Tally]:
    """Touches that are spoilt on their way."""
    tallies = {name: Tally() for name in LIES}
    for seed in seeds:
        for name, tally in tallies.items():
            tally.take(perform("profiles/cu270.toml", seed, target(10.0), lie=name), harmful=True)
    return tallies


def alarms(first_seed: int, singles: int, arrays: int) -> tuple[int, int, list[str]]:
    """Clean holes, holes with an alarm, and what was told of them."""
    holes, told = 0, []
    for index in range(singles):
        done = perform("profiles/cu270.toml", first_seed + index, target(DEPTHS_UM[index % len(DEPTHS_UM)]))
        holes += 1
        told += done.doubts[:1] or ([done.error] if done.alarmed else [])
    for index in range(arrays):
        done = perform(ARRAY, first_seed + index, ())
        holes += 0 if done.result is None else len(done.result.sites)
        told += done.doubts or ([done.error] if done.alarmed else [])
    return holes, len(told), told


def main() -> None:
    """Run everything, print the figures, and exit with 1 when a bar was missed."""
    args = options(__doc__, seeds=6, first_seed=2000, deep=2, clean=300, arrays=12, missed=False)
    met = True
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    deep = range(args.first_seed, args.first_seed + args.deep)
    groups = {
        "chips, short holes": chips(seeds, [target(d) for d in DEPTHS_UM], told=args.missed),
        "chips, 5 and 15 mm away": chips(seeds, [away(w) for w in AWAY_UM], told=args.missed),
        "chips, array with a plane": chips(deep, [(*target(AWAY_DEPTH_UM), *PLANE)], told=args.missed),
        "chips, 180 µm": chips(deep, [target(DEEP_UM)], told=args.missed),
        "lies": lies(seeds),
    }
    for title, tallies in groups.items():
        harmful = sum(tally.harmful for tally in tallies.values())
        missed = sum(tally.missed for tally in tallies.values())
        if not harmful:
            print(f"{title}: nothing was shifted, nothing judged", flush=True)
            continue
        share = 1.0 - missed / harmful
        met = met and share >= FOUND_BAR
        print(
            f"{title}: {100 * share:.1f} % of {harmful} found (bar {100 * FOUND_BAR:g} %)",
            flush=True,
        )
        for name, tally in tallies.items():
            print(f"    {name:<24} {tally}", flush=True)
        for name, tally in tallies.items():
            if tally.only_judged:
                print(f"    {name:<24} {tally.only_judged} of these not found but that the target is missed")
    holes, alarmed, told = alarms(args.first_seed, args.clean, args.arrays)
    met = met and alarmed <= ALARM_BAR * holes
    print(f"clean holes: {alarmed} of {holes} with an alarm (bar {100 * ALARM_BAR:g} %)")
    for text in told:
        print("   ", text)
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
