"""A hole that is taken up again on the same bench: what the journal keeps, and what lies on the bottom meanwhile."""

from __future__ import annotations

import math
import signal
from dataclasses import dataclass, field, replace

import pytest

from edmctl.errors import Interrupted
from edmctl.machine.controller import LinkMachine
from edmctl.machine.stop import StopRequest
from edmctl.procedures.job import JobState, JobTally, job_state
from edmctl.record.rows import RunEvent
from edmctl.results.job import SiteResult
from edmctl.results.progress import Phase
from edmctl.simulator.injection import parse_injection
from tests.cli.left_jobs import swap_work

from .conftest import Shop

BOTTOM_TOUCH = 3
"""Which touch-off of a run reads the bottom first: after two spots of the pad."""


@dataclass(slots=True)
class Kept:
    """A journal that keeps every state."""

    states: list[JobState] = field(default_factory=list)

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        self.states.append(job_state(state.as_mapping()))


def left(shop: Shop, depth_um: float) -> JobState:
    """Stop a job at that depth; what its journal keeps."""

    def look() -> None:
        if shop.told.states[-1].depth_um > depth_um:
            shop.stop.request(signal.SIGINT)
        else:
            shop.told.when[Phase.MACHINING] = look

    shop.told.when[Phase.MACHINING] = look
    kept = Kept()
    with pytest.raises(Interrupted):
        shop.run_job(journal=kept)
    return kept.states[-1]


def taken_up(shop: Shop, state: JobState) -> SiteResult:
    """Go on with it on the same bench."""
    shop.job = replace(shop.job, resumed=state)
    shop.tally, shop.machine = JobTally(), LinkMachine(shop.session, StopRequest())
    (site,) = shop.run_job().sites
    return site


@pytest.mark.parametrize("size_um", [10.0, 14.0])
def test_a_loose_chip_under_the_tool_is_washed_away_before_the_work_is_refused(size_um: float) -> None:
    shop = Shop(("target.depth_um=25.0",), seed=3101)
    state = left(shop, 20.0)
    shop.bench.inject(parse_injection(f"LOOSE_CHIP_{size_um:g}@touch{BOTTOM_TOUCH}+0"))
    site = taken_up(shop, state)
    assert any("nearer than the journal expects" in note for note in shop.told.notes)
    assert abs(site.depth_um - shop.bench.truth()[0].depth_um) <= 1.0


def test_another_board_does_not_have_the_slope_that_was_touched_before() -> None:
    """Left after half a micrometre, hole and face look alike; what the face was like is no knowledge then."""
    shop = Shop(("target.depth_um=8.0", "measure.site_dx_um=5000.0"), seed=3103)
    state = left(shop, 0.3)
    assert state.face
    swap_work(shop.bench)
    shop.bench.plant._tilt_mrad[:] += 0.6
    shop.bench.plant.arrive()
    site = taken_up(shop, state)
    (hole,) = shop.bench.truth()
    assert abs(site.depth_um - hole.depth_um) <= site.depth_u95_um


def test_an_estimated_z1_stays_an_estimate() -> None:
    shop = Shop(seed=3102)
    state = left(shop, 6.0)
    exact, doubted = (replace(state, z1_u_um=u_um, z1_doubt_u_um=u_um) for u_um in (0.0, 2.0))
    assert (state.z1_u_um, state.z1_doubt_u_um) == (0.0, 0.0)
    site = taken_up(shop, doubted)
    assert site.wear_basis == "estimated"
    assert site.wear_u95_um > 1.96 * math.hypot(2.0, 2.0)
    other = Shop(seed=3102)
    left(other, 6.0)
    assert taken_up(other, exact).wear_u95_um < 2.0


def test_the_journal_of_a_stopped_job_has_the_time_and_the_estimate_of_its_end() -> None:
    shop = Shop(seed=3103)
    state = left(shop, 6.0)
    (site,) = shop.tally.result().sites
    assert state.time_s == pytest.approx(shop.tally.time_s, abs=0.1)
    assert (state.depth_um, state.wear_um) == pytest.approx((site.depth_um, site.wear_um), abs=1e-6)
    assert state.machining_time_s == pytest.approx(site.machining_time_s)
    assert RunEvent.TOUCH_DOUBTED not in shop.seen.codes
