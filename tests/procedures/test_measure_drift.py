"""Rests and touches on a bench whose drifts are known; jobs that are corrected by what they tell."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from edmctl.jobs.truth import TrueWear
from edmctl.labels import Seen
from edmctl.procedures.job import JobTally, NoStateStore
from edmctl.procedures.measure_drift import (
    DriftPlan,
    DriftRecord,
    drift_result,
    drift_time_s,
    measure_drift,
    plan_drift,
)
from edmctl.procedures.run import JobRun
from edmctl.procedures.session import running
from edmctl.process.rest_drift import TIME_CONSTANTS_S, DriftFit, DriftModel, model_of
from edmctl.profile.setup import Sensor, Setup
from edmctl.record.rows import RunEvent
from edmctl.results.measurements import DriftResult
from tests.procedures.conftest import Shop, refused
from tests.tiers import tiers

SHORT = DriftPlan(duration_s=180.0, interval_s=20.0, hold_um=200.0, hold_s=30.0)
"""Long enough for a drift that is five times what the setup believes."""
FAST_UM_S = 0.008
FASTER_UM_S = 0.02
"""So that a job of two minutes drifts by more than its touches scatter."""
CREEP = 0.012
"""Of every lag, as of the virtual actuator."""
KNOWN = DriftModel(
    creep=np.full(len(TIME_CONSTANTS_S), CREEP),
    creep_covariance=np.diag(np.full(len(TIME_CONSTANTS_S), 0.0015**2)),
    share=1.0,
    share_u=0.1,
    apart_u_um_per_s=2e-4,
    walk_um_per_sqrt_s=0.01,
)


class Measured(NamedTuple):
    shop: Shop
    run: JobRun
    record: DriftRecord
    fit: DriftFit
    found: DriftResult


@cache
def measured(sensor_um_s: float, machine_um_s: float, plan: DriftPlan = SHORT) -> Measured:
    shop = Shop()
    shop.bench.plant.unit.sensor_drift_um_s = sensor_um_s
    shop.bench.plant.unit.machine_drift_um_s = machine_um_s
    with running(
        shop.machine, shop.job, JobTally(), recorder=shop.seen, observer=shop.told, pulses=False
    ) as run:
        record = measure_drift(run, plan, shop.profile.approach.offset_um)
        return Measured(shop, run, record, *drift_result(run, plan, record))


@pytest.mark.parametrize(
    ("sensor_um_s", "machine_um_s"),
    tiers((FAST_UM_S, FAST_UM_S), slow=((FAST_UM_S, 0.0), (0.0, FAST_UM_S), (-FAST_UM_S, FAST_UM_S))),
)
def test_what_drifts_is_told_apart(sensor_um_s: float, machine_um_s: float) -> None:
    *_, fit, found = measured(sensor_um_s, machine_um_s)
    assert abs(found.rest_um_per_s - sensor_um_s) < 3.0 * found.rest_u_um_per_s
    assert abs(found.touch_um_per_s - sensor_um_s - machine_um_s) < 3.0 * found.touch_u_um_per_s
    assert abs(found.apart_um_per_s - machine_um_s) < 3.0 * found.apart_u_um_per_s
    if sensor_um_s:
        assert abs(found.share - 1.0 - machine_um_s / sensor_um_s) < 3.0 * found.share_u
    else:
        assert math.isnan(found.share)
    assert model_of(fit).share == found.share_used


def test_no_spark_is_made_the_hold_creeps_and_a_contradicted_setup_is_named() -> None:
    shop, *_, found = measured(FAST_UM_S, FAST_UM_S)
    assert not shop.bench.truth() or max(hole.depth_um for hole in shop.bench.truth()) == 0.0
    assert found.creep_um > 0.3
    assert found.rests > found.touches >= 6
    assert shop.seen.codes.count(RunEvent.DRIFT_MEASURED) == 1
    seen = {belief.name: belief.seen for belief in found.beliefs}
    assert seen["sensor.drift_um_per_s"] is Seen.CONTRADICTED
    assert seen["sensor.gain_u_rel"] is Seen.NEVER


def test_the_setup_decides_and_too_little_time_is_refused() -> None:
    profile = Shop().profile
    setup = Setup()
    plan = plan_drift(profile, setup)
    assert (plan.duration_s, plan.interval_s, plan.hold_s) == (900.0, 60.0, 300.0)
    assert plan.touches == 11
    assert 900.0 < drift_time_s(plan, profile, setup) < 1100.0
    with refused("E2064"):
        plan_drift(profile, setup, 500.0)
    with refused("E8034"):
        plan_drift(profile, Setup(sensor=Sensor(fitted=False)))


def test_what_is_no_drift_is_not_kept() -> None:
    """Work that jumps about under the tool explains neither rests nor touches."""
    found = measured(FAST_UM_S, FAST_UM_S)
    jumping = [
        replace(one, reading=replace(one.reading, mean_um=one.reading.mean_um + 3.0 * (i % 2)))
        for i, one in enumerate(found.record.touches)
    ]
    with refused("E7041"):
        drift_result(found.run, SHORT, replace(found.record, touches=jumping))


@cache
def corrected(*, known: bool) -> tuple[Shop, TrueWear]:
    """A job on a sensor that drifts, with and without what measure-drift tells."""
    shop = Shop(('target={kind="depth",depth_um=8.0,tolerance_um=2.0}',))
    shop.bench.plant.unit.sensor_drift_um_s = FASTER_UM_S
    shop.job = replace(shop.job, drift=KNOWN if known else None)
    wear = TrueWear(shop.bench, NoStateStore())
    shop.run_job(journal=wear)
    return shop, wear


def test_a_job_corrects_its_wear_and_states_what_is_left() -> None:
    shop, wear = corrected(known=True)
    (site,) = shop.tally.sites.values()
    worn_um = wear.of_site(site.name)
    assert site.drift_correction_um > 1.0
    assert abs(site.wear_um - worn_um) < site.wear_u95_um
    assert abs(site.wear_um + site.drift_correction_um - worn_um) > abs(site.wear_um - worn_um)
    assert site.z3_um - site.z1_um == pytest.approx(site.wear_um, abs=1e-9)
    assert site.z2_um - site.z3_um == pytest.approx(site.depth_um + site.face_um, abs=1e-9)
    assert site.feed_um == pytest.approx(site.depth_um + site.wear_um, abs=1e-9)
    assert 0.0 < site.drift_left_u_um < site.wear_u95_um
    (hole,) = (one for one in shop.bench.truth() if one.depth_um > 1.0)
    assert abs(site.feed_um - hole.depth_um - worn_um) < site.feed_u95_um


def test_without_a_file_a_job_corrects_nothing_and_says_what_drift_costs() -> None:
    shop, wear = corrected(known=False)
    (site,) = shop.tally.sites.values()
    assert site.drift_correction_um == 0.0
    assert not site.drift_by_rests
    assert site.wear_um - wear.of_site(site.name) > 1.0
    assert [belief.name for belief in shop.tally.result().contradicted] == ["sensor.drift_um_per_s"]
    assert site.drift_left_u_um > 0.0
