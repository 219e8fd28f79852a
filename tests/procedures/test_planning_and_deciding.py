"""Where cuts end, and what follows them: arithmetic without a machine."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from edmctl.procedures.cut import CutEnd, CutResult
from edmctl.procedures.deciding import decide
from edmctl.procedures.planning import CutPlan, cut_budget, first_plan, following_plan, learned_gap_um
from edmctl.process.wear import DepthAndWear
from edmctl.profile.load import load_profile

from .conftest import CU270

if TYPE_CHECKING:
    from edmctl.profile.model import Profile

FOUND = DepthAndWear(
    depth_um=150.0,
    depth_u95_um=1.0,
    wear_um=60.0,
    wear_u95_um=2.0,
    feed_um=210.0,
    feed_u95_um=2.0,
    depth_noise_um=0.1,
)
PLAN = CutPlan(
    number=1,
    feed_um=210.0,
    bottom_um=50.0,
    gap_um=3.4,
    wear_ratio=0.4,
    depth_before_um=0.0,
    wear_before_um=0.0,
)
CUT = CutResult(
    end=CutEnd.REACHED,
    reason="feed reached",
    time_s=700.0,
    end_displacement_um=256.6,
    counts=(30, 67, 2, 1),
    gap_ratio_mean=0.8,
    energy_j=200.0,
)


def profile(*overrides: str) -> Profile:
    return load_profile(CU270, overrides).profile


def test_the_first_cut_of_a_depth_stays_short_of_it() -> None:
    plan = first_plan(profile(), surface_um=49.0)
    assert plan.feed_um == pytest.approx(0.85 * 180.0 * 1.389)
    assert plan.z_limit_um == pytest.approx(49.0 + plan.feed_um - 3.4)


def test_a_single_cut_goes_for_the_whole_depth() -> None:
    plan = first_plan(profile('wear.remeasure="never"'), surface_um=49.0)
    assert plan.feed_um == pytest.approx(180.0 * 1.389)


def test_a_feed_target_counts_from_contact_to_contact() -> None:
    plan = first_plan(profile('target={kind="feed",feed_um=250}'), surface_um=49.0)
    assert plan.z_limit_um == pytest.approx(49.0 + 250.0 - 3.4)


@pytest.mark.parametrize(("override", "cuts"), [('"never"', 1), ('"auto"', 5), ("1", 2), ("3", 4), ("9", 5)])
def test_the_recipe_sets_how_many_cuts_there_may_be(override: str, cuts: int) -> None:
    assert cut_budget(profile(f"wear.remeasure={override}")) == cuts


def test_estimates_split_the_feed_by_the_wear_ratio() -> None:
    assert PLAN.depth_at(50.0 - 3.4) == 0.0
    assert PLAN.depth_at(PLAN.z_limit_um) == pytest.approx(210.0 / 1.4)
    assert PLAN.wear_at(PLAN.z_limit_um) == pytest.approx(0.4 * 150.0)
    assert PLAN.depth_at(0.0) == 0.0


def test_the_working_gap_is_what_touching_adds_to_sparking() -> None:
    assert learned_gap_um(260.5, 257.0) == pytest.approx(3.5)
    assert learned_gap_um(250.0, 257.0) == 0.5


def test_what_is_left_is_cut_with_the_wear_ratio_measured() -> None:
    decision = decide(profile(), PLAN, CUT, FOUND, bottom_um=260.0, gap_um=3.5)
    assert decision.plan is not None
    assert decision.plan.feed_um == pytest.approx(0.9 * 30.0 * 1.4)
    assert decision.plan.z_limit_um == pytest.approx(260.0 + decision.plan.feed_um - 3.5)
    assert (decision.plan.depth_before_um, decision.plan.wear_before_um) == (150.0, 60.0)


def test_a_depth_in_tolerance_is_the_end() -> None:
    decision = decide(profile(), PLAN, CUT, replace(FOUND, depth_um=179.4), 260.0, 3.5)
    assert (decision.plan, decision.missed) == (None, "")


def test_a_depth_short_after_the_last_cut_is_missed() -> None:
    last = replace(PLAN, number=5)
    decision = decide(profile(), last, CUT, FOUND, 260.0, 3.5)
    assert decision.plan is None
    assert "-30.00 µm" in decision.missed
    assert "0.400" in decision.hint


def test_a_worn_out_tool_ends_the_job() -> None:
    recipe = profile("tool.max_wear_um=80.0")
    worn = replace(FOUND, wear_um=80.5)
    decision = decide(recipe, PLAN, CUT, worn, 260.0, 3.5)
    assert decision.plan is None
    assert "tool.max_wear_um" in decision.missed


@pytest.mark.parametrize(
    ("end", "fault", "code", "remedy"),
    [
        (CutEnd.TIME_UP, "TIMEOUT", "E7012", "max_time_s"),
        (CutEnd.GIVEN_UP, "STALL", "E7010", "jump.period_s"),
        (CutEnd.GIVEN_UP, "STROKE_END", "E7011", "approach.offset_um"),
        (CutEnd.GIVEN_UP, "", "E7010", "jump.period_s"),
    ],
)
def test_a_cut_that_ended_early_says_what_to_change(end: CutEnd, fault: str, code: str, remedy: str) -> None:
    cut = replace(CUT, end=end, fault=fault, told="4.2 µm are left")
    decision = decide(profile(), PLAN, cut, FOUND, 260.0, 3.5)
    assert (decision.plan, decision.code) == (None, code)
    assert "a depth of 150.00 of 180 µm" in decision.missed
    assert ("4.2 µm are left" in decision.missed) == bool(fault)
    assert remedy in decision.hint


def test_a_negative_wear_ratio_never_plans_a_shallower_cut() -> None:
    plan = following_plan(PLAN, 10.0, 260.0, 3.5, replace(FOUND, wear_um=-1.0))
    assert plan.wear_ratio == 0.0
    assert plan.number == 2
