"""Where cuts end, and what follows them: arithmetic without a machine."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from edmctl.planning.measuring import cut_budget, estimate_of
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.hole.cut import CutEnd, CutResult
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart, discharge_energy_j, energy_of, first_plan
from edmctl.procedures.hole.decision import Decision, decide
from edmctl.procedures.job import CutTotals, HoleTarget, target_of
from edmctl.process.erosion import hole_area_um2
from edmctl.process.live_erosion import Energy, ErosionEstimate
from edmctl.process.touches import DepthAndWear
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.quantity import Value

from .conftest import CU270

FOUND = DepthAndWear(
    depth=Value(150.0, 0.5), wear=Value(60.0, 1.0), feed=Value(210.0, 1.0), depth_noise_um=0.1
)
SURFACE = CutStart(bottom_um=50.0, bottom_u_um=0.2, gap_um=3.4, gap_u_um=0.8)
CUT = CutResult(
    end=CutEnd.REACHED,
    reason="feed reached",
    time_s=700.0,
    end_displacement_um=256.6,
    counts=(30, 67, 2, 1),
    gap_ratio_mean=0.8,
    energy_j=200.0,
    is_at_limit=True,
)
SITE = Place("hole", 500.0, 0.0)


def profile(*overrides: str) -> Profile:
    return load_profile(CU270, overrides).profile


def goal(recipe: Profile, site: Place = SITE) -> HoleTarget:
    return target_of(recipe, site)


def plan(recipe: Profile | None = None, number: int = 1, feed_um: float = 210.0) -> CutPlan:
    return CutPlan(number, feed_um, SURFACE, estimate_of(recipe or profile()), 180.0)


def learned(found: DepthAndWear = FOUND) -> ErosionEstimate:
    energy = Energy(found.depth_um * hole_area_um2(270.0, 8.0) / 0.0424, 0.0)
    return estimate_of(profile()).fitted(energy, found.depth_um, 0.3, found.wear_um, 0.5)


def start_of(found: DepthAndWear = FOUND) -> CutStart:
    return CutStart(260.0, 0.15, 3.5, 0.8, depth_um=found.depth_um, depth_u_um=0.5, wear_um=found.wear_um)


def decision(
    recipe: Profile, last: CutPlan, cut: CutResult | None = CUT, found: DepthAndWear = FOUND
) -> Decision:
    return decide(recipe, goal(recipe), last.number, cut, found, start_of(found), learned(found))


def test_what_a_touch_has_contradicted_is_not_relied_on_in_the_next_hole() -> None:
    believed = estimate_of(profile())
    energy = Energy(100.0 * hole_area_um2(270.0, 8.0) / 0.0424, 0.0)
    as_believed = believed.fitted(energy, 100.0, 0.3, 38.9, 0.5).next_hole(100.0)
    contradicted = believed.fitted(energy, 100.0, 0.3, 12.0, 0.5).next_hole(100.0)
    shallow = goal(profile(), replace(SITE, depth_um=20.0))
    assert first_plan(profile(), SURFACE, shallow, as_believed).measured is False
    again = first_plan(profile(), SURFACE, shallow, contradicted)
    assert again.measured
    assert again.feed_um <= 20.0


def test_drift_until_the_end_of_a_cut_counts_before_it() -> None:
    shallow = goal(profile(), replace(SITE, depth_um=20.0))
    estimate = learned().next_hole(100.0)
    drifting = replace(SURFACE, drift_u_um_per_s=0.02)
    assert first_plan(profile(), SURFACE, shallow, estimate).measured is False
    assert first_plan(profile(), drifting, shallow, estimate).measured
    cut = CutPlan(1, 27.0, drifting, estimate, 20.0)
    still, later = cut.at(cut.z_limit_um, now_s=0.0), cut.at(cut.z_limit_um, now_s=100.0)
    assert later.depth_u_um == pytest.approx(math.hypot(still.depth_u_um, 2.0))


@pytest.mark.parametrize(
    ("override", "feed_um"),
    [
        ("target.depth_um=180", 180.0),  # not too deep even of a tool that does not wear
        ('wear.remeasure="never"', 180.0 * 1.389),  # a single cut goes for the whole depth
        ('target={kind="feed",feed_um=250}', 250.0),  # from contact to contact
        ("wear.first_fraction=0.5", 90.0 * 1.389),
    ],
)
def test_the_recipe_sets_the_feed_of_the_first_cut(override: str, feed_um: float) -> None:
    first = first_plan(profile(override), SURFACE)
    assert first.feed_um == pytest.approx(feed_um)
    assert first.z_limit_um == pytest.approx(50.0 + feed_um - 3.4)
    assert first.measured


def test_places_sheets_and_the_recipe_set_depths_and_the_number_of_cuts() -> None:
    recipe = profile()
    own = goal(recipe, replace(SITE, depth_um=40.0))
    assert own.depth_um == 40.0
    assert first_plan(recipe, SURFACE, own).feed_um < 40.0 * 1.389
    sheet = profile(
        'target={kind="through",completion_um=20}', 'work={material="Cu",thickness_um=50,kind="through"}'
    )
    assert goal(sheet).completion_um == 20.0
    assert first_plan(sheet, SURFACE).feed_um > 50.0 * 1.389 + 20.0
    for override, cuts in (('"never"', 1), ('"auto"', 5), ("1", 2), ("3", 4), ("9", 5)):
        assert cut_budget(profile(f"wear.remeasure={override}")) == cuts


def test_estimates_split_the_feed_by_the_wear_ratio() -> None:
    cut = plan()
    assert cut.at(50.0 - 3.4).depth_um == 0.0
    assert cut.at(cut.z_limit_um).depth_um == pytest.approx(210.0 / 1.389)
    assert cut.at(cut.z_limit_um).wear_um == pytest.approx(0.389 * 210.0 / 1.389)
    assert cut.at(0.0).depth_um == 0.0
    live = cut.at(cut.z_limit_um)
    assert live.depth_um + live.wear_um == pytest.approx(210.0)
    assert live.depth_u_um > 3.0


def test_the_wear_of_a_later_cut_is_no_better_known_than_what_was_measured_before() -> None:
    start = replace(start_of(), wear_u_um=FOUND.wear.u)
    later = CutPlan(2, 40.0, start, learned(), 180.0)
    live = later.at(290.0)
    assert live.wear_u_um < FOUND.wear.u
    assert later.stated(live)[1].u == pytest.approx(math.hypot(FOUND.wear.u, live.wear_u_um))
    assert live.depth_u_um >= start.u_at(0.0)


def test_what_is_left_is_cut_with_the_wear_ratio_measured() -> None:
    then = decision(profile(), plan()).plan
    assert then is not None
    assert then.feed_um == pytest.approx(30.0 * 1.4, rel=0.01)
    assert then.z_limit_um == pytest.approx(260.0 + then.feed_um - 3.5)
    assert (then.start.depth_um, then.start.wear_um, then.number) == (150.0, 60.0, 2)
    assert then.measured


@pytest.mark.parametrize(("override", "measured"), [('"auto"', False), ("3", True)])
def test_a_small_rest_is_finished_without_a_touch_unless_the_recipe_counts_them(
    override: str, *, measured: bool
) -> None:
    near = replace(FOUND, depth=Value(172.0, 0.5), wear=Value(68.8, 1.0))
    then = decision(profile(f"wear.remeasure={override}"), plan(), found=near).plan
    assert then is not None
    assert then.measured is measured


@pytest.mark.parametrize(
    ("number", "depth_um", "missed", "hint"),
    [(1, 179.4, "", ""), (5, 150.0, "−30.00 µm", "Allow more cuts (wear.max_cuts).")],
)
def test_a_depth_in_tolerance_and_the_last_cut_are_the_end(
    number: int, depth_um: float, missed: str, hint: str
) -> None:
    end = decision(profile(), plan(number=number), found=replace(FOUND, depth=Value(depth_um, 0.5)))
    assert (end.plan, end.hint, bool(end.missed)) == (None, hint, bool(missed))
    assert missed in end.missed


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
    cut = replace(CUT, end=end, fault=fault, message="4.2 µm are left")
    missed = decision(profile(), plan(), cut)
    assert (missed.plan, missed.code) == (None, code)
    assert "a depth of 150.00 of 180 µm" in missed.missed
    assert ("4.2 µm are left" in missed.missed) == bool(fault)
    assert remedy in missed.hint


def test_energy_is_that_of_discharges_however_many_arcs_and_shorts_there_are() -> None:
    pulse = profile().pulse
    siemens, on_us = pulse.current_a / 18.0, pulse.on_time_us

    def charge_c(plateau_v: float) -> float:
        return 1e-6 * siemens * (40.0 - plateau_v) * on_us

    counts = (0, 1000, 50, 100)
    energy_j = discharge_energy_j(
        pulse, counts, 1000 * charge_c(22.0) + 50 * charge_c(16.94) + 100 * charge_c(0.0)
    )
    assert energy_j == pytest.approx(1000 * 22.0 * charge_c(22.0) + 50 * 16.94 * charge_c(16.94))
    divided = energy_of(pulse, CutTotals(1, counts, energy_j))
    assert divided.normal_uj == pytest.approx(1e9 * 22.0 * charge_c(22.0))
    assert divided.arc_uj == pytest.approx(5e7 * 16.94 * charge_c(16.94))
