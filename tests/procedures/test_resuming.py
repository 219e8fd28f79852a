"""A hole that is resumed on the same bench: what the journal keeps, and debris on the bottom meanwhile."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.cli.left_jobs import swap_work
from tests.tiers import tiers

from .conftest import Shop

BOTTOM_TOUCH = 3
"""Which touch-off of a run reads the bottom first: after two spots of the pad."""


@pytest.mark.parametrize("size_um", tiers(14.0, slow=(10.0,)))
def test_a_loose_chip_under_the_tool_is_washed_away_before_the_work_is_refused(size_um: float) -> None:
    first = Shop(("target.depth_um=25.0",), seed=3101)
    after = first.taken_up(first.left(lambda p: p.depth_um > 20.0))
    after.inject(f"LOOSE_CHIP_{size_um:g}@touch{BOTTOM_TOUCH}+0")
    (site,) = after.run_job().sites
    assert any("nearer than the journal expects" in note for note in after.told.notes)
    assert abs(site.depth_um - after.true_depth_um(site)) <= 1.0


def test_another_board_does_not_have_the_slope_that_was_touched_before() -> None:
    """Left after half a micrometre, hole and face look alike; what the face was like is no knowledge then."""
    first = Shop(("target.depth_um=8.0", "measure.site_dx_um=5000.0"), seed=3103)
    state = first.left(lambda p: p.depth_um > 0.3)
    assert state.face
    swap_work(first.bench)
    first.bench.plant._tilt_mrad[:] += 0.6
    first.bench.plant.arrive()
    after = first.taken_up(state)
    (site,) = after.run_job().sites
    assert after.holds(site)


def test_the_journal_of_a_stopped_job_has_time_and_estimate_of_its_end_and_an_estimated_z1_stays_one() -> (
    None
):
    for z1_u_um in (2.0, 0.0):
        first = Shop(seed=3102)
        state = first.left(lambda p: p.depth_um > 6.0)
        (site,) = first.tally.result().sites
        assert state.time_s == pytest.approx(first.tally.time_s, abs=0.1)
        assert (state.depth_um, state.wear_um) == pytest.approx((site.depth_um, site.wear_um), abs=1e-6)
        assert state.machining_time_s == pytest.approx(site.machining_time_s)
        assert first.seen.doubts == []
        assert (state.z1_u_um, state.z1_doubt_u_um) == (0.0, 0.0)
        state = replace(state, z1_u_um=z1_u_um, z1_doubt_u_um=z1_u_um)
        (site,) = first.taken_up(state).run_job().sites
        if z1_u_um:
            assert site.wear_basis == "estimated"
            assert site.wear_u95_um > 1.96 * math.hypot(2.0, 2.0)
        else:
            assert site.wear_u95_um < 2.0
