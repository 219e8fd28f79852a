"""Wear and depth by touches alone, against what the bench knows; approaches; series of jumps."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import pytest

from edmctl.errors import Interrupted, MachineFault, PreconditionError
from edmctl.labels import Basis
from edmctl.procedures.job import JobTally
from edmctl.procedures.jump_series import run_jumps
from edmctl.procedures.measure_wear import (
    MOST_DRIFT_UM,
    Bottom,
    Reference,
    drift_since,
    measure_wear,
    refuse_drift,
    touch_pad,
)
from edmctl.procedures.run import JobRun
from edmctl.procedures.session import running
from edmctl.procedures.touch.approach import find_contact, find_gap
from edmctl.process.touches import Displacement
from edmctl.profile.places import Place
from edmctl.quantity import Value
from edmctl.record.rows import RunEvent
from edmctl.results.measurements import WearResult
from edmctl.results.progress import Phase
from tests.procedures.conftest import Shop, refused
from tests.tiers import tiers

SPARKLESS = "flush.min_flow_lpm=90"
"""More than the pump gives: nothing that makes sparks can be armed."""
SITE = Place("beside", 500.0, 0.0)


def ready(shop: Shop, *, pulses: bool = False) -> AbstractContextManager[JobRun]:
    return running(shop.machine, shop.job, JobTally(), recorder=shop.seen, observer=shop.told, pulses=pulses)


class Touched(NamedTuple):
    """A hole that was machined and then measured again, on a bench that is looked at."""

    shop: Shop
    found: WearResult
    true_depth_um: float


@pytest.fixture(scope="module")
def touched() -> Touched:
    """Reference, job and measurement, each on a machine that was idle before."""
    shop = Shop()
    with ready(shop) as run:
        z1 = touch_pad(run, "Z1", shop.profile.approach.offset_um)
    (site,) = shop.run_job().sites
    reference = Reference(z1.z_um, z1.reading.sd_um, z1.reading.touches, z1.model_um, 300.0)
    with ready(shop) as run:
        bottom = Bottom(site.name, site.x_um, site.y_um, site.depth_um)
        found = measure_wear(run, reference, z1.z_um + site.wear_um, bottom)
        refuse_drift(run, found)
    (hole,) = shop.bench.truth()
    return Touched(shop, found, hole.depth_um)


def test_feed_is_depth_and_wear_and_the_intervals_hold_the_truth_and_the_budget(touched: Touched) -> None:
    found, bench = touched.found, touched.shop.bench
    assert found.feed_um == pytest.approx(found.depth_um + found.wear_um, abs=1e-9)
    assert found.feed_um == pytest.approx(found.z2_um - found.z1_um, abs=1e-9)
    assert found.z3_um == pytest.approx(0.5 * (found.z3_before_um + found.z3_after_um), abs=1e-9)
    assert found.drift_um == pytest.approx(found.z3_after_um - found.z3_before_um, abs=1e-9)
    assert abs(found.depth_um - touched.true_depth_um) <= found.depth_u95_um
    assert abs(found.wear_um - bench.tool_wear_um) <= found.wear_u95_um
    assert abs(found.wear_model_um - bench.tool_wear_um) <= 10.0
    assert bench.is_safe
    assert {row.kind for row in touched.shop.seen.touches} == {"Z1", "Z2", "Z3"}
    for name in ("wear", "depth", "feed"):
        combined_um = math.hypot(*(getattr(part, f"{name}_um") for part in found.budget))
        assert 1.95 <= getattr(found, f"{name}_u95_um") / combined_um <= 2.5, name


def test_an_older_reference_knows_the_wear_less_well(touched: Touched) -> None:
    shop = touched.shop
    with ready(shop) as run:
        old = Reference(touched.found.z1_um, 0.05, 3, math.nan, 10_000.0)
        found = measure_wear(run, old, touched.found.z3_um, None)
    assert found.wear_u95_um > 5.0 * touched.found.wear_u95_um
    assert math.isnan(found.depth_um)
    assert math.isnan(found.feed_um)
    assert all(math.isnan(part.depth_um) and math.isnan(part.feed_um) for part in found.budget)
    assert abs(found.wear_um - touched.found.wear_um) <= MOST_DRIFT_UM


DRIFT_UM_S = 0.0045


def test_a_measured_drift_is_taken_off_wear_and_feed() -> None:
    drifting = Shop()
    drifting.bench.plant.unit.sensor_drift_um_s = DRIFT_UM_S
    with ready(drifting) as run:
        z1 = touch_pad(run, "Z1", drifting.profile.approach.offset_um)
        age_s = 1500.0
        earlier_um = z1.z_um - DRIFT_UM_S * (age_s - run.machine.time_s)
    reference = Reference(earlier_um, 0.05, 3, math.nan, age_s, drift_um_per_s=Value(DRIFT_UM_S + 2e-4, 3e-4))
    with ready(drifting) as run:
        found = measure_wear(run, reference, z1.z_um, None)
    assert found.drift_correction_um == pytest.approx(DRIFT_UM_S * 1560.0, abs=1.0)
    assert abs(found.wear_um) <= found.wear_u95_um <= 1.5


def test_a_home_that_contradicts_the_measured_drift_rules_it_out() -> None:
    reference = Reference(50.0, 0.05, 3, math.nan, 0.0, home_um=5.0, drift_um_per_s=Value(DRIFT_UM_S, 3e-4))
    sensor_u = Displacement(drift_u_um_per_s=0.0017)
    assert drift_since(reference, 12.0, 1000.0, sensor_u) is not None
    assert drift_since(reference, 5.0, 10_000.0, sensor_u) is None


def test_touching_needs_no_dielectric() -> None:
    dry = Shop((SPARKLESS,))
    with ready(dry) as run:
        z1 = touch_pad(run, "Z1", 50.0)
    assert abs(z1.z_um - dry.bench.plant.state.surface_um) <= 2.0
    with pytest.raises(PreconditionError), ready(dry, pulses=True):
        pass


def test_a_pad_that_moves_is_told() -> None:
    drifting = Shop()
    drifting.bench.plant.unit.sensor_drift_um_s = 0.1
    reference = Reference(50.0, 0.05, 3, math.nan, 0.0)
    with refused("E7040"), ready(drifting) as run:
        refuse_drift(run, measure_wear(run, reference, 55.0, None))
    assert drifting.bench.is_safe


def test_a_lost_tool_is_a_fault_of_the_machine_and_a_stop_retracts() -> None:
    broken, stopped = Shop(), Shop()
    broken.bench.plant.tool_lost_um = 200.0
    with pytest.raises(MachineFault) as caught, ready(broken) as run:
        touch_pad(run, "Z1", 50.0)
    assert caught.value.fault == 2005
    assert caught.value.hint
    stopped.told.when[Phase.MEASURING] = lambda: stopped.stop.request(2)
    with pytest.raises(Interrupted), ready(stopped) as run:
        touch_pad(run, "Z1", 50.0)
    assert stopped.seen.events[-1][3].startswith("Stopped")
    assert broken.bench.is_safe
    assert stopped.bench.is_safe


def test_contact_is_the_surface_and_the_gap_is_before_it() -> None:
    finding = Shop()
    with ready(finding, pulses=True) as run:
        contact = find_contact(run, SITE)
        gap = find_gap(run, SITE)
        surface_um = float(finding.bench.plant.state.surface_um)
    assert (contact.kind, gap.kind) == ("contact", "spark gap")
    assert abs(contact.displacement_um - surface_um) <= 1.0
    assert 1.0 <= surface_um - gap.displacement_um <= 10.0
    assert gap.travel_s >= gap.displacement_um / finding.profile.approach.speed_um_s
    assert (contact.touches, gap.touches) == (finding.profile.measure.touches, 0)
    assert abs(contact.model_um - contact.displacement_um) <= 10.0


JUMPING = ('jump.mode="fixed"', "jump.period_s=3", "log.servo_hz=1000")


def test_jumps_are_as_high_as_asked_and_come_back() -> None:
    jumping = Shop(JUMPING)
    with ready(jumping) as run:
        series = run_jumps(run, 250.0, 3)
    jumps, summary = series.jumps, series.summary
    assert [jump.number for jump in jumps] == [1, 2, 3]
    assert abs(series.start_um - 250.0) <= 10.0
    for jump in jumps:
        assert abs(jump.height_um - jumping.profile.jump.height_um) <= 8.0
        assert abs(jump.residual_um) <= 10.0
        assert 0.0 <= jump.settling_s < 3.0
    assert [b.time_s - a.time_s for a, b in pairwise(jumps)] == pytest.approx([3.0, 3.0], abs=0.1)
    assert summary.height_min_um <= summary.height_mean_um <= summary.height_max_um
    assert summary.residual_max_um == max(abs(jump.residual_um) for jump in jumps)
    assert jumping.bench.truth() == ()
    with refused("E8047"), ready(jumping) as run:
        run_jumps(run, 30.0, 1)
    assert jumping.bench.is_safe


@pytest.fixture
def kept() -> tuple[Shop, Reference, Bottom, float]:
    """A bench with a hole, the tool's reference before it, and where its bottom is known to be."""
    shop = Shop(seed=3)
    with ready(shop) as run:
        z1 = touch_pad(run, "Z1", shop.profile.approach.offset_um)
    (site,) = shop.run_job().sites
    reference = Reference(z1.z_um, z1.reading.sd_um, z1.reading.touches, z1.model_um, 300.0)
    bottom = Bottom(site.name, site.x_um, site.y_um, site.depth_um, 0.5 * site.depth_u95_um)
    return shop, reference, bottom, z1.z_um + site.wear_um


@pytest.mark.parametrize("size_um", tiers(8.0, slow=(3.0, 15.0)))
@pytest.mark.parametrize("name", tiers("CHIP", slow=("LOOSE_CHIP",)))
def test_a_chip_on_the_bottom_is_told_and_covered(
    kept: tuple[Shop, Reference, Bottom, float], name: str, size_um: float
) -> None:
    shop, reference, bottom, pad_um = kept
    shop.inject(f"{name}_{size_um:g}@touch3+0")
    with ready(shop) as run:
        found = measure_wear(run, reference, pad_um, bottom)
    assert RunEvent.TOUCH_DOUBTED in shop.seen.codes
    (hole,) = shop.bench.truth()
    assert found.depth_basis is Basis.ESTIMATED
    assert abs(found.depth_um - hole.depth_um) <= found.depth_u95_um
    assert abs(found.feed_um - hole.depth_um - shop.bench.tool_wear_um) <= found.feed_u95_um


def test_a_doubted_reference_is_part_of_wear_and_feed_and_a_tool_that_has_grown_is_refused(
    kept: tuple[Shop, Reference, Bottom, float],
) -> None:
    shop, reference, bottom, pad_um = kept
    with ready(shop) as run:
        found = measure_wear(run, replace(reference, doubt_u_um=2.0), pad_um, bottom)
    assert found.wear_u95_um > 3.5
    assert found.feed_u95_um > 3.5
    assert found.depth_u95_um < 1.5
    with refused("E7023") as caught, ready(shop) as run:
        measure_wear(run, replace(reference, z_um=pad_um + 6.0), pad_um, None)
    assert caught.value.hint
