"""How well wear is known with `measure-drift` on file, and whether what that says of a machine is right.

    python benchmarks/drift.py [--seeds 40] [--first 1001] [--profiles cu270 w252] [--jobs 2] [--classes sensor ...]
        [--misses] [--drift-only]

Every seed is a machine. It is measured as `edmctl measure-drift` does; then it makes the hole of a shipped profile,
with the model of that measurement and corrected by its own rests: on odd seeds another day, with other noise and an
actuator that has rested, on even ones at once, while the actuator still creeps back. Both are judged by the plant's
truth. Classes: the sensor drifts, the machine does (the work against the tool), both do; and `twice`, where gain and
drift of the sensor and tilt are drawn twice as wide as the setup believes. Bars, but for `twice`: intervals of wear
and feed, and those of depth, wear and feed together, hold 90 %; where the sensor drifts half the interval of the
wear is at most 1.0 µm at the median; the share and the drift between tool and work hold in 90 % of the measurements
that tell them.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from multiprocessing import Pool
from pathlib import Path

import numpy as np

from benchmarks.common import machine_on, machined, options
from edmctl.errors import EdmError
from edmctl.jobs.connect import bench_config
from edmctl.jobs.corrections import assumed_drift
from edmctl.jobs.surroundings import Unobserved
from edmctl.jobs.truth import TrueWear
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import JobTally, NoStateStore, job_of
from edmctl.procedures.measure_drift import drift_result, measure_drift, plan_drift
from edmctl.procedures.session import running
from edmctl.process.rest_drift import model_of
from edmctl.profile.setup import Setup
from edmctl.quantity import half_width
from edmctl.record.rows import NullRecorder
from edmctl.simulator import open_bench
from edmctl.simulator.plant import RandomBlocks

PROFILES = Path(__file__).parents[1] / "profiles"
SD_UM_S = 1.0 / 600.0
CLASSES = {
    "sensor": (),
    "machine": ("sim.sensor_drift_sd_um_s=0.0", f"sim.machine_drift_sd_um_s={SD_UM_S}"),
    "both": (f"sim.machine_drift_sd_um_s={SD_UM_S}",),
    "twice": (
        "sim.sensor_gain_sd=0.006",
        f"sim.sensor_drift_sd_um_s={2.0 * SD_UM_S}",
        "sim.tilt_sd_mrad=0.6",
    ),
}
LEAST_HELD, MOST_WEAR_U95_UM = 0.90, 1.0


@dataclass(frozen=True)
class Case:
    """One machine and its hole."""

    name: str
    profile: str
    seed: int
    drift_only: bool = False


@dataclass(frozen=True)
class Outcome:
    """What held of one machine; NaN and None where there was nothing to hold. Half-widths in µm."""

    case: Case
    end: str
    depth_held: bool = False
    wear_held: bool = False
    feed_held: bool = False
    wear_u95_um: float = math.nan
    depth_u95_um: float = math.nan
    feed_u95_um: float = math.nan
    wear_off_um: float = math.nan
    raw_off_um: float = math.nan
    left_u_um: float = math.nan
    share_held: bool | None = None
    apart_held: bool | None = None
    rest_held: bool | None = None
    touch_held: bool | None = None
    contradicted: tuple[str, ...] = ()


def perform(case: Case) -> Outcome:
    """Measure the machine, then let it make its hole."""
    loaded = load_profile(str(PROFILES / f"{case.profile}.toml"), CLASSES[case.name])
    setup = Setup()
    config = bench_config(loaded, setup)
    bench = open_bench(config, case.seed)
    machine = machine_on(bench.transport)
    job = job_of(loaded.profile, setup)
    plan, measured = plan_drift(loaded.profile, setup), JobTally()
    try:
        with running(
            machine, job, measured, recorder=NullRecorder(), observer=Unobserved(), pulses=False
        ) as run:
            record = measure_drift(run, plan, loaded.profile.approach.offset_um)
            fit, found = drift_result(run, plan, record)
    except EdmError as error:
        return Outcome(case, f"measure-drift: {error.code}")
    truth = bench.true_drifts_um_per_s
    sensor, work = truth["sensor_um_per_s"], truth["machine_um_per_s"]
    share_held = None
    if not math.isnan(found.share):
        share_held = sensor != 0.0 and abs(found.share - 1.0 - work / sensor) <= half_width(found.share_u)
    apart_held = abs(found.apart_um_per_s - work) <= half_width(found.apart_u_um_per_s)
    rest_held = abs(found.rest_um_per_s - sensor) <= half_width(found.rest_u_um_per_s)
    touch_held = abs(found.touch_um_per_s - sensor - work) <= half_width(found.touch_u_um_per_s)
    if case.drift_only:
        return Outcome(case, "ok", rest_held=rest_held, touch_held=touch_held, apart_held=apart_held)
    job = replace(job_of(loaded.profile, setup), drift=assumed_drift(model_of(fit), setup))
    later = bench
    if case.seed % 2:
        later = open_bench(config, case.seed)
        machine = machine_on(later.transport)
        later.plant.random = RandomBlocks(np.random.SeedSequence([case.seed, 1]), config.discharge.scatter)
    else:
        job = replace(job, creep_left=measured.creep_left)
    wear = TrueWear(later, NoStateStore())
    tally, failed = machined(machine, job, wear)
    end = failed.code if failed else "ok"
    if not tally.sites:
        return Outcome(case, end, share_held=share_held, apart_held=apart_held)
    (site,) = tally.sites.values()
    depth_um = min(later.truth(), key=lambda hole: math.hypot(hole.x_um - site.x_um, hole.y_um)).depth_um
    worn_um = wear.of_site(site.name)
    off_um = site.wear_um - worn_um
    return Outcome(
        case,
        end,
        depth_held=abs(site.depth_um - depth_um) <= site.depth_u95_um,
        wear_held=abs(off_um) <= site.wear_u95_um,
        feed_held=abs(site.feed_um - depth_um - worn_um) <= site.feed_u95_um,
        wear_u95_um=site.wear_u95_um,
        depth_u95_um=site.depth_u95_um,
        feed_u95_um=site.feed_u95_um,
        wear_off_um=off_um,
        raw_off_um=off_um + site.drift_correction_um,
        left_u_um=site.drift_left_u_um,
        share_held=share_held,
        apart_held=apart_held,
        rest_held=rest_held,
        touch_held=touch_held,
        contradicted=tuple(belief.name for belief in tally.result().contradicted),
    )


def main() -> int:
    """Measure, print, and say whether the bars hold."""
    given = options(
        __doc__,
        {"classes": CLASSES},
        seeds=40,
        first=1001,
        profiles=["cu270", "w252"],
        classes=list(CLASSES),
        jobs=2,
        misses=False,
        drift_only=False,
    )
    cases = [
        Case(name, profile, given.first + i, given.drift_only)
        for name in given.classes
        for profile in given.profiles
        for i in range(given.seeds)
    ]
    begin_s, found = time.monotonic(), defaultdict[tuple[str, str], list[Outcome]](list)
    failures = []
    with Pool(given.jobs) as pool:
        for outcome in pool.imap(perform, cases):
            name, profile = outcome.case.name, outcome.case.profile
            found[name, profile].append(outcome)
            if len(found[name, profile]) == given.seeds:
                failures += _report(name, profile, found[name, profile], misses=given.misses)
    print(f"\n{len(cases)} machines in {time.monotonic() - begin_s:.0f} s")
    for failure in failures:
        print(f"MISSED: {failure}")
    return 1 if failures else 0


def _report(name: str, profile: str, outcomes: list[Outcome], *, misses: bool) -> list[str]:
    n = len(outcomes)
    if outcomes[0].case.drift_only:
        drifts = {
            "rests": [one.rest_held for one in outcomes],
            "touches": [one.touch_held for one in outcomes],
            "touches less rests": [one.apart_held for one in outcomes],
        }
        counts = {what: sum(bool(one) for one in contained) for what, contained in drifts.items()}
        words = ", ".join(f"{what} {count} of {n}" for what, count in counts.items())
        print(f"\n{name}, {profile}: intervals of steady drifts that contain the truth: {words}")
        return [
            f"{name}, {profile}: drift of {what}" for what, count in counts.items() if count < LEAST_HELD * n
        ]
    held = {
        "depth": sum(one.depth_held for one in outcomes) / n,
        "wear": sum(one.wear_held for one in outcomes) / n,
        "feed": sum(one.feed_held for one in outcomes) / n,
        "all three": sum(one.depth_held and one.wear_held and one.feed_held for one in outcomes) / n,
    }
    shares = [one.share_held for one in outcomes if one.share_held is not None]
    aparts = [one.apart_held for one in outcomes if one.apart_held is not None]
    median_um = {
        what: statistics.median(getattr(one, f"{what}_u95_um") for one in outcomes)
        for what in ("depth", "wear", "feed")
    }
    off_um = statistics.pstdev(
        [one.wear_off_um for one in outcomes if math.isfinite(one.wear_off_um)] or [0.0]
    )
    raw_um = statistics.pstdev([one.raw_off_um for one in outcomes if math.isfinite(one.raw_off_um)] or [0.0])
    print(f"\n{name}, {profile}: {n} machines")
    print("  held      " + ", ".join(f"{what} {100 * share:.1f} %" for what, share in held.items()))
    print("  median ±  " + ", ".join(f"{what} {um:.2f} µm" for what, um in median_um.items()))
    print(f"  wear off by {off_um:.2f} µm rms about its mean, {raw_um:.2f} µm before the correction")
    print(
        f"  share told by {len(shares)} measurements, held by {sum(shares)}; drift apart held by {sum(aparts)}"
    )
    ends = Counter(one.end for one in outcomes if one.end != "ok")
    if ends:
        print("  ended     " + ", ".join(f"{end} × {count}" for end, count in ends.items()))
    beliefs = Counter(belief for one in outcomes for belief in one.contradicted)
    print("  beliefs contradicted: " + (", ".join(f"{b} × {k}" for b, k in beliefs.items()) or "none"))
    if misses:
        for one in outcomes:
            if not (one.wear_held and one.depth_held and one.feed_held):
                print(f"  seed {one.case.seed}: {one}")
    if name == "twice":
        return []
    failed = [
        f"{name}, {profile}: {what} held {100 * held[what]:.1f} %"
        for what in ("wear", "feed", "all three")
        if held[what] < LEAST_HELD
    ]
    if name == "sensor" and not median_um["wear"] <= MOST_WEAR_U95_UM:
        failed.append(f"{name}, {profile}: wear known within {median_um['wear']:.2f} µm")
    for what, told in (("share", shares), ("drift apart", aparts)):
        if told and sum(told) < LEAST_HELD * len(told):
            failed.append(f"{name}, {profile}: {what} held by {sum(told)} of {len(told)}")
    if name == "sensor" and not shares:
        failed.append(f"{name}, {profile}: no measurement told a share")
    return failed


if __name__ == "__main__":
    sys.exit(main())
