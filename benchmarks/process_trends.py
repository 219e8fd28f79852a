"""What the virtual machine makes of a recipe: removal, wear, gap and surface against what users vary.

    python benchmarks/process_trends.py [--seeds 4] [--first 1] [--only reference on-time ...] [--spread 0.03]
        [--json]

Every figure is of whole virtual jobs through the Python API, judged by the plant's truth: removal rate is the true
volume of the hole over the machining time. The ranges are those that the laws have to keep; each seed is a machine
that differs from the book by `--spread`, 0.03 as everywhere. The exit code is 1 where a range is missed.
"""

from __future__ import annotations

import json
import math
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Any

import edmctl
from benchmarks.common import options
from edmctl.errors import EdmWarning, ObjectiveNotReached

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

ON_US, OFF_US = 1e6 * 0.30 / 2300.0, 1e6 * 0.70 / 2300.0
TRIED = (
    'jump.mode="off"',
    'wear.remeasure="never"',
    'log.pulses="off"',
    "approach.speed_um_s=3",
    "approach.max_travel_um=150",
    "target.tolerance_um=50",
    "limits.arc_ratio=0.99",
    "limits.short_ratio=0.99",
    "limits.max_time_s=100000",
)
FEED_250 = ('target={kind="feed",feed_um=250}', 'jump.mode="fixed"', 'log.pulses="off"')


@dataclass(frozen=True, slots=True)
class Made:
    """One hole on average over the seeds; rates in µm³/s, shares of the pulses."""

    depth_um: float
    wear_um: float
    time_s: float
    mrr_um3_s: float
    theta: float
    gap_um: float
    arcs: float
    shorts: float
    side_gap_um: float
    ra_um: float
    crater_um3: float
    """Work removed per normal discharge."""


def one_hole(case: tuple[str, tuple[str, ...], int]) -> Made:
    """Make one hole on a machine of its own."""
    profile, overrides, seed = case
    report = edmctl.connect("sim:", seed=seed).machine(profile, overrides=overrides)
    measured = report.error is None or isinstance(report.error, ObjectiveNotReached)
    if not report.sites or not measured:  # a hole that misses its recipe's belief is measured all the same
        raise RuntimeError(f"{profile} {overrides}, seed {seed}: {report.error}")
    site, true = report.sites[0], report.truths[0]
    diameter_um = edmctl.load_profile(profile, overrides=overrides).profile.tool.diameter_um
    hole_um3 = true.depth_um * math.pi / 4.0 * (diameter_um + 2.0 * true.side_gap_um) ** 2
    return Made(
        depth_um=true.depth_um,
        wear_um=true.wear_um,
        time_s=site.machining_time_s,
        mrr_um3_s=hole_um3 / site.machining_time_s,
        theta=true.wear_um * math.pi / 4.0 * diameter_um**2 / hole_um3,
        gap_um=site.working_gap_um,
        arcs=site.ratios.arc,
        shorts=site.ratios.short,
        side_gap_um=true.side_gap_um,
        ra_um=true.ra_um,
        crater_um3=hole_um3 / (site.pulses * site.ratios.normal),
    )


class Trials:
    """Makes holes side by side and keeps each."""

    def __init__(self, pool: ProcessPoolExecutor, seeds: Sequence[int], spread: float) -> None:
        self._pool, self._seeds, self._spread = pool, seeds, f"sim.spread={spread:g}"

    def of(self, cases: Sequence[tuple[str, tuple[str, ...]]]) -> list[Made]:
        """Return the mean hole of each case."""
        asked = [(name, (*over, self._spread), seed) for name, over in cases for seed in self._seeds]
        made = list(self._pool.map(one_hole, asked))
        n = len(self._seeds)
        groups = [made[i : i + n] for i in range(0, len(made), n)]
        return [
            Made(*(fmean(getattr(one, name) for one in group) for name in Made.__slots__)) for group in groups
        ]

    def tried(self, depth_um: float, *overrides: tuple[str, ...]) -> list[Made]:
        """Return holes of the 270 µm copper tool, without jumps."""
        depth = f"target.depth_um={depth_um:g}"
        return self.of([("cu270", (*TRIED, depth, *over)) for over in overrides])


def pulses(on_us: float, off_us: float) -> tuple[str, ...]:
    """Overrides for these times."""
    period_us = on_us + off_us
    return f"pulse.frequency_hz={1e6 / period_us:.6f}", f"pulse.duty={on_us / period_us:.6f}"


def peak(x: Sequence[float], y: Sequence[float]) -> float:
    """Where a parabola through the highest value and its neighbours has its top; NaN where an end is the highest."""
    i = max(range(len(y)), key=y.__getitem__)
    if i in (0, len(y) - 1):
        return math.nan
    (a, b, c), (p, q, r) = x[i - 1 : i + 2], y[i - 1 : i + 2]
    left, right = (q - p) / (b - a), (r - q) / (c - b)
    return b if left == right else 0.5 * (a + b) - left * 0.5 * (c - a) / (right - left)


Row = tuple[str, float, float, float]
"""What is measured, the figure, the least and the most that it may be."""


def paper(trials: Trials) -> Iterator[Row]:
    """The points of Muralidhara et al. 2009."""
    twice = ("pulse.current_a=0.24",)
    cases = [("cu270", FEED_250), ("w252", FEED_250), ("cu150", FEED_250), ("cu150", (*FEED_250, *twice))]
    cu270, w252, cu150, doubled = trials.of(cases)
    yield "Cu 270: depth of 250 µm feed, µm", cu270.depth_um, 177.0, 183.0
    yield "Cu 270: wear, µm", cu270.wear_um, 67.0, 73.0
    yield "Cu 270: machining time, s", cu270.time_s, 840.0, 920.0
    yield "Cu 270: working gap, µm", cu270.gap_um, 3.2, 3.5
    yield "Cu 270: arcs, %", 100.0 * cu270.arcs, 1.0, 4.0
    yield "Cu 270: shorts, %", 100.0 * cu270.shorts, 0.0, 0.5
    yield "W 252: depth, µm", w252.depth_um, 237.0, 243.0
    yield "W 252: wear, µm", w252.wear_um, 8.5, 11.5
    yield "time of Ø270 over Ø150", cu270.time_s / cu150.time_s, 2.75, 3.05
    yield "twice the current saves, %", 100.0 * (1.0 - doubled.time_s / cu150.time_s), 35.0, 50.0
    yield "side gap, µm", cu270.side_gap_um, 7.8, 8.2
    yield "Ra of the floor, µm", cu270.ra_um, 0.15, 0.35


def reference(trials: Trials) -> Iterator[Row]:
    """Removal against the servo's reference, in two flushings; the lowest two are below what a recipe may ask."""
    levels = [0.60, 0.64, 0.68, 0.72, 0.76, 0.80, 0.84, 0.88]
    found = {}
    for flush_s in (0.5, 2.0):
        flush = f"sim.flush_time_s={flush_s}"
        made = trials.tried(90.0, *((f"servo.reference={level}", flush) for level in levels))
        rates = [one.mrr_um3_s for one in made]
        best = peak(levels, rates)
        near = min(made, key=lambda one: abs(levels[made.index(one)] - best))
        found[flush_s] = best, max(rates), near.gap_um, rates
    (clean, rate, gap_um, rates), (dirty, dirty_rate, dirty_gap_um, _) = found[0.5], found[2.0]
    yield "best reference, clearance 0.5 s", clean, 0.67, 0.75
    yield "removal at 0.60 over the best", rates[0] / rate, 0.75, 0.95
    yield "removal at 0.80 over the best", rates[5] / rate, 0.83, 0.96
    yield "clearance 2 s: reference moves by", dirty - clean, 0.01, 0.08
    yield "clearance 2 s: gap moves by, µm", dirty_gap_um - gap_um, 0.3, 0.8
    yield "clearance 2 s: removal, %", 100.0 * (dirty_rate / rate - 1.0), -45.0, -25.0


def on_time(trials: Trials) -> Iterator[Row]:
    """Removal against the on-time at a duty of 0.30."""
    times_us = [12.0, 30.0, 50.0, 75.0, 100.0, 130.0, 180.0, 300.0]
    made = trials.tried(40.0, *(pulses(on_us, on_us * 7.0 / 3.0) for on_us in times_us))
    rates = [one.mrr_um3_s for one in made]
    yield "best on-time at duty 0.30, µs", peak(times_us, rates), 60.0, 140.0
    yield "removal at 12 µs over the best", rates[0] / max(rates), 0.25, 0.5
    yield "removal at 300 µs over the best", rates[-1] / max(rates), 0.5, 0.8


def off_time(trials: Trials) -> Iterator[Row]:
    """Removal against the off-time at three on-times."""
    times_us = [20.0, 25.0, 30.0, 40.0, 50.0, 65.0, 85.0, 120.0]
    for on_us, low, high in ((30.0, 15.0, 35.0), (60.0, 20.0, 50.0), (130.0, 35.0, 90.0)):
        offs_us = [off_us for off_us in times_us if on_us / (on_us + off_us) <= 0.85]
        made = trials.tried(40.0, *(pulses(on_us, off_us) for off_us in offs_us))
        yield f"best off-time at {on_us:g} µs, µs", peak(offs_us, [m.mrr_um3_s for m in made]), low, high
        if 20.0 in offs_us:
            yield f"arcs at {on_us:g} µs on, 20 off, %", 100.0 * made[offs_us.index(20.0)].arcs, 12.0, 100.0
        yield f"arcs at {on_us:g} µs on, 120 off, %", 100.0 * made[-1].arcs, 0.0, 10.0


def wear(trials: Trials) -> Iterator[Row]:
    """Wear against the on-time for both polarities, at 100 µs of off-time."""
    times_us = [30.0, 75.0, 130.0, 180.0, 240.0, 300.0]
    theta = {}
    for polarity in ("tool-negative", "tool-positive"):
        way = f'pulse.polarity="{polarity}"'
        short = 4.5 if polarity == "tool-positive" else 0.5
        ratios = [max(0.1, short * (30.0 / t) ** (1.6 if short > 1.0 else 0.0)) for t in times_us]
        expected = [f"wear.expected_ratio={ratio:.2g}" for ratio in ratios]
        made = trials.tried(
            20.0, *((*pulses(t, 100.0), way, e) for t, e in zip(times_us, expected, strict=True))
        )
        theta[polarity] = [one.theta for one in made]
    negative, positive = theta["tool-negative"], theta["tool-positive"]
    logs = [math.log(p / n) for p, n in zip(positive, negative, strict=True)]
    crossing = [i for i in range(1, len(logs)) if logs[i] < 0.0 <= logs[i - 1]]
    i = crossing[0] if crossing else 1
    share = logs[i - 1] / (logs[i - 1] - logs[i]) if crossing else math.nan
    yield "wear at 300 over 30 µs, tool negative", negative[-1] / negative[0], 1.5, 2.5
    yield "wear at 300 over 30 µs, tool positive", positive[-1] / positive[0], 0.0, 0.1
    yield (
        "polarities wear alike at, µs",
        times_us[i - 1] + share * (times_us[i] - times_us[i - 1]),
        130.0,
        260.0,
    )


def current(trials: Trials) -> Iterator[Row]:
    """Removal against the current at 60 V, and a recipe of 1 A."""
    volts = ("pulse.open_voltage_v=60", "servo.reference=0.6")
    once, twice = trials.tried(40.0, *((*volts, f"pulse.current_a={a}") for a in (0.12, 0.24)))
    yield "exponent of removal in current", math.log2(twice.mrr_um3_s / once.mrr_um3_s), 0.65, 0.95
    strong = ("pulse.open_voltage_v=100", "servo.reference=0.5", "pulse.current_a=1", "servo.forward_um_s=20")
    ramps = ("servo.back_um_s=20", *pulses(300.0, 700.0))
    (one_amp,) = trials.tried(40.0, (*strong, *ramps))
    yield "side gap at 100 V, 1 A, 300 µs, µm", one_amp.side_gap_um, 15.0, 25.0
    yield "Ra there over that of 0.12 A", one_amp.ra_um / once.ra_um, 1.5, 4.0
    grown = math.log(one_amp.ra_um / once.ra_um) / math.log(one_amp.crater_um3 / once.crater_um3)
    yield "exponent of Ra in the crater's volume", grown, 0.28, 0.38
    (kept,) = trials.tried(40.0, ("pulse.current_a=1", "approach.speed_um_s=3"))
    yield "1 A at 40 V: depth reached, µm", kept.depth_um, 32.0, 48.0


TRENDS = {
    "paper": paper,
    "reference": reference,
    "on-time": on_time,
    "off-time": off_time,
    "wear": wear,
    "current": current,
}


def main() -> int:
    """Measure and print; the exit code is 1 where a figure lies outside its range."""
    arguments = options(
        __doc__, {"only": TRENDS}, seeds=4, first=1, only=list(TRENDS), spread=0.03, json=False
    )
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    rows: list[dict[str, Any]] = []
    warnings.simplefilter("ignore", EdmWarning)  # of tolerances that let a trial end with one cut
    with ProcessPoolExecutor() as pool:
        trials = Trials(pool, seeds, arguments.spread)
        for name in arguments.only:
            for what, figure, least, most in TRENDS[name](trials):
                holds = least <= figure <= most
                rows.append({"what": what, "figure": figure, "least": least, "most": most, "holds": holds})
                if not arguments.json:
                    sign = "  " if holds else " !"
                    print(f"{sign} {what:44} {figure:9.3f}   {least:g} to {most:g}", flush=True)
    if arguments.json:
        print(json.dumps(rows))
    missed = sum(not row["holds"] for row in rows)
    print(f"{len(rows) - missed} of {len(rows)} within their ranges", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
