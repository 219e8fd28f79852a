"""Several holes in one job, and a job that is taken up again."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from edmctl.errors import Interrupted
from edmctl.procedures.job import PERIOD_S, JobState, JobTally
from edmctl.procedures.run import JobStateKeeper
from edmctl.procedures.servo.limits import rise_um, stroke_left_um
from edmctl.procedures.stages import retract
from edmctl.record.rows import RunEvent
from edmctl.results.job import ObjectiveMissed
from edmctl.results.progress import Phase
from tests.record.samples import a_site_row
from tests.tiers import tiers

from .conftest import Kept, Shop, armed, refused

GRID = 'sites=[{kind="grid",x_um=500.0,columns=2,rows=2,dx_um=400.0,dy_um=400.0}]'
DEPTH_UM = 12.0


def test_the_result_of_a_finished_site_is_converted_once() -> None:
    states: list[JobState] = []

    class Store:
        def keep(self, state: JobState, *, urgent: bool = False) -> None:
            states.append(state)

    shop = Shop()
    keeper = JobStateKeeper(shop.job, JobTally({"A1": a_site_row()}), Store())
    keeper.keep("moving", None)
    keeper.tally.sites["A2"] = a_site_row()
    keeper.keep("moving", None)
    keeper.tally.sites["A1"] = replace(a_site_row(), wear_um=71.0)
    keeper.keep("moving", None)
    first, second, third = (state.done for state in states)
    assert second[0] is first[0]
    assert third[1] is second[1]
    assert (second[0]["wear_um"], third[0]["wear_um"]) == (70.0, 71.0)
    assert states[-1].as_mapping()["done"] is third


@pytest.fixture(scope="module")
def array() -> Shop:
    shop = Shop([GRID])
    shop.run_job()
    return shop


def test_every_hole_of_an_array_comes_out_as_deep_as_wanted_with_fewer_stops(array: Shop) -> None:
    sites = list(array.tally.sites.values())
    assert len(sites) == 4
    for site in sites:
        assert array.true_depth_um(site) == pytest.approx(DEPTH_UM, abs=2.0)
        assert abs(array.true_depth_um(site) - site.depth_um) <= 1.5 * site.depth_u95_um
        assert site.feed_um == pytest.approx(site.depth_um + site.wear_um)
        assert site.z2_um - site.z3_um - site.face_um == pytest.approx(site.depth_um)
        assert site.z3_um - site.z1_um == pytest.approx(site.wear_um)
    assert sites[0].measuring_stops >= 1
    assert sites[-1].measuring_stops >= 1
    assert sum(site.measuring_stops for site in sites) <= 3
    assert math.fsum(site.wear_um for site in sites) == pytest.approx(array.bench.tool_wear_um, abs=2.0)
    surfaces = [site.z1_um for site in sites]
    assert surfaces == sorted(surfaces)
    assert [row.kind for row in array.seen.touches].count("Zr") == 6  # three places, two spots each
    assert RunEvent.FACE_FITTED in array.seen.codes
    assert [(row.name, row.depth_um) for row in array.seen.sites] == [(s.name, s.depth_um) for s in sites]


def test_the_live_view_names_the_hole_where_the_tool_is(array: Shop) -> None:
    moves = [(row[0], str(row[3])) for row in array.seen.events if row[1] == RunEvent.STAGE_MOVED]
    for (begin_s, message), (end_s, _) in pairwise(moves):
        place = message.removeprefix("At ").rpartition(" (")[0]
        shown = {
            state.site
            for state in array.told.states
            if begin_s < state.time_s < end_s and state.phase is not Phase.MOVING
        }
        assert shown <= {place if place.startswith("grid-") else ""}
    assert "grid-1" in {state.site for state in array.told.states}


@pytest.mark.parametrize(("before_um", "limit_um", "most"), [(0.0, 12.0, 2), (98.0, 100.0, 0)])
def test_a_tool_that_may_wear_no_further_ends_the_job_and_says_what_is_left(
    before_um: float, limit_um: float, most: int
) -> None:
    s = Shop([GRID, f"tool.max_wear_um={limit_um}"])
    s.job = replace(s.job, tool_wear_before_um=before_um)
    with pytest.raises(ObjectiveMissed, match=r"tool\.max_wear_um is.*grid-") as missed:
        s.run_job()
    assert min(1, most) <= len(s.tally.sites) <= most
    assert f"has lost {before_um:.0f} µm" in str(missed.value) or most
    assert s.bench.is_safe


def test_a_hole_that_the_worn_tool_cannot_reach_is_not_begun() -> None:
    """Its bottom would lie 140 µm down, and 33 V give about 103 µm."""
    sites = ",".join(f'{{name="{name}",x_um={x_um}}}' for name, x_um in (("a", 500), ("b", 900), ("d", 1700)))
    s = Shop(
        [
            f'sites=[{sites},{{name="c",x_um=1300,depth_um=60.0}}]',
            "limits.stroke_v_max=33.0",
            'array.order="nearest"',
        ]
    )
    with refused("E7011") as missed:
        s.run_job()
    assert "job of their own" in missed.value.hint
    assert list(s.tally.sites) == ["a", "b"]
    assert s.tally.result().not_begun == ("c", "d")
    assert s.bench.is_safe


def test_a_job_that_ends_early_names_the_holes_that_it_did_not_come_to() -> None:
    s = Shop([GRID, "limits.max_time_s=130.0"])
    with pytest.raises(ObjectiveMissed) as missed:
        s.run_job()
    assert missed.value.result.not_begun == ("grid-2", "grid-4", "grid-3")
    assert "Not begun: grid-2, grid-4, grid-3." in str(missed.value)
    assert RunEvent.SITES_LEFT in s.seen.codes


@pytest.mark.parametrize("time_s", tiers(30.0, slow=(900.0,)))
def test_a_slow_rise_goes_further_than_a_step_by_its_creep(time_s: float) -> None:
    """The plant rises as slowly as a hole is fed; the estimate made before that is its end."""
    s = Shop()
    run = armed(s, conditioned=True)
    retract(run)
    estimator = run.watch.estimator()
    assert estimator is not None
    before_um, rise = run.watch.displacement_um, rise_um(estimator, 110.0, time_s)
    assert rise > stroke_left_um(estimator, 110.0) + 5.0
    s.machine.ramp(110.0, 110.0 / time_s)
    assert run.watch.displacement_um == pytest.approx(before_um + rise, abs=5.0)


def interrupted(shop: Shop, when: Callable[[JobState], bool]) -> JobState:
    """Stop the shop's job at the first state that `when` picks; the last state that was kept."""

    class Watching(Kept):
        def keep(self, state: JobState, *, urgent: bool = False) -> None:
            super().keep(state, urgent=urgent)
            if when(self.states[-1]):
                shop.stop.request(2)

    kept = Watching()
    with pytest.raises(Interrupted):
        shop.run_job(journal=kept)
    return kept.states[-1]


def in_a_cut(least_um: float = 0.0, done: int = 0) -> Callable[[JobState], bool]:
    return lambda s: len(s.done) == done and s.phase == "machining" and s.depth_um >= least_um


SLOWER = "pulse.current_a=0.2"
DEEPER_UM = 30.0
DEEPER = f'target={{kind="depth",depth_um={DEEPER_UM},tolerance_um=2.0}}'


@pytest.mark.parametrize(
    ("overrides", "depth_um", "when"),
    tiers(
        ((SLOWER,), DEPTH_UM, in_a_cut(3.0)),
        ((), DEPTH_UM, lambda s: s.site != "" and not s.begun),
        slow=(
            *(((SLOWER,), DEPTH_UM, in_a_cut(least_um)) for least_um in (0.0, 8.0)),
            ((GRID,), DEPTH_UM, in_a_cut(done=2)),
            ((GRID,), DEPTH_UM, in_a_cut(4.0)),
            ((GRID, DEEPER), DEEPER_UM, lambda s: len(s.done) == 3 and not s.begun),
        ),
    ),
)
def test_a_job_left_anywhere_is_finished_from_what_is_there(
    overrides: tuple[str, ...], depth_um: float, when: Callable[[JobState], bool]
) -> None:
    first = Shop(overrides)
    state = interrupted(first, when)
    after = first.taken_up(state, 60.0)
    sites = after.run_job().sites
    assert len(sites) == len(first.job.sites)
    assert [site.name for site in sites[: len(state.done)]] == [str(done["name"]) for done in state.done]
    assert [row.name for row in after.seen.sites] == list(after.tally.sites)
    for site in sites:
        assert after.true_depth_um(site) == pytest.approx(depth_um, abs=2.0 if len(sites) > 1 else 1.5)
        assert abs(after.true_depth_um(site) - site.depth_um) <= 1.5 * site.depth_u95_um
    if state.begun:
        assert RunEvent.RESUMED in after.seen.codes
        assert sum(site.pulses for site in sites) >= sum(state.counts)
    if len(sites) == 1:
        assert sites[0].wear_um == pytest.approx(after.bench.tool_wear_um, abs=1.5)


def test_a_job_that_is_stopped_again_while_it_measures_is_taken_up_again() -> None:
    first = Shop(["pulse.current_a=0.2"])
    state = interrupted(first, lambda s: s.phase == "machining" and s.depth_um >= 8.0)
    second = first.taken_up(state, 60.0)
    again = interrupted(second, lambda s: s.begun and s.phase == "measuring")
    assert again.depth_um == pytest.approx(state.depth_um)
    assert again.wear_um == pytest.approx(state.wear_um)
    assert again.counts == state.counts
    third = second.taken_up(again, 60.0)
    (site,) = third.run_job().sites
    assert third.true_depth_um(site) == pytest.approx(DEPTH_UM, abs=1.5)


def test_a_tool_that_is_up_for_a_jump_is_not_taken_for_a_shallow_hole() -> None:
    jumping = ['jump.mode="fixed"', "jump.period_s=1.5", "jump.height_um=40.0", "jump.speed_um_s=200.0"]
    s, kept = Shop([*jumping, "pulse.current_a=0.2"]), Kept()
    s.run_job(journal=kept)
    cutting = [state for state in kept.states if state.phase == "machining"]
    assert len(cutting) > 2
    depths = [state.depth_um for state in cutting]
    assert depths == sorted(depths)
    for state in cutting:
        assert state.wear_um == pytest.approx(0.389 * state.depth_um, abs=0.15 * state.depth_um + 0.5)


def test_the_journal_is_kept_at_every_step_and_every_few_seconds() -> None:
    s, kept = Shop(), Kept()
    s.run_job(journal=kept)
    phases = [state.phase for state in kept.states]
    assert phases[0] == "measuring"
    assert phases[-1] == "moving"
    quiet = [state.time_s for state, urgent in zip(kept.states, kept.urgent, strict=True) if not urgent]
    assert all(b - a >= 0.9 * PERIOD_S for a, b in pairwise(quiet))
    last = kept.states[-1]
    assert len(last.done) == 1
    assert last.site == ""
    assert any(p.phase is Phase.MACHINING for p in s.told.states)
