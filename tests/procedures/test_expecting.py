"""What a journal expects of touches, and for how long a pause counts."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from edmctl.planning.measuring import estimate_of
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.hole.cut_planning import (
    CutPlan,
    CutStart,
    ExpectedHole,
    energy_of,
    estimate_in_cut,
    expected_of_left,
    is_untouched,
    lengths,
    with_unseen,
)
from edmctl.procedures.job import CutTotals, JobState, job_of, job_state
from edmctl.procedures.monitoring.drift import counted_pause_s, pause_drift_u_um
from edmctl.procedures.run import total_pause_s
from edmctl.process.touches import DepthAndWear
from edmctl.profile.setup import Sensor, Setup
from edmctl.quantity import Value

PROFILE = load_profile("cu270").profile
LEFT = JobState(
    "machining",
    500.0,
    "Cu 270 µm",
    site="a",
    begun=True,
    depth_um=113.7,
    depth_u_um=3.0,
    wear_um=40.0,
    wear_u_um=3.0,
    feed_u_um=0.8,
    machining_time_s=512.0,
)


def found(depth_um: float, wear_um: float, u_um: float = 0.3) -> DepthAndWear:
    return DepthAndWear(Value(depth_um, u_um), Value(wear_um, u_um), Value(depth_um + wear_um, u_um), 0.1)


@pytest.mark.parametrize(
    ("depth_um", "wear_um", "work", "tool"),
    [
        pytest.param(113.7, 40.0, True, True, id="as left"),
        pytest.param(
            107.0, 47.0, True, True, id="another wear ratio than was believed, and the feed as left"
        ),
        pytest.param(116.5, 41.0, True, True, id="cut in the seconds that no journal saw"),
        pytest.param(-0.2, 40.0, False, False, id="untouched work"),
        pytest.param(104.0, 50.0, False, True, id="too shallow for any belief"),
        pytest.param(131.0, 40.0, False, False, id="too deep for any seconds"),
        pytest.param(113.7, 52.0, True, False, id="another tool"),
        pytest.param(107.0, 42.0, True, False, id="depth and wear as left, but not the feed"),
    ],
)
def test_depth_wear_and_feed_each_have_to_agree(
    depth_um: float, wear_um: float, work: bool, tool: bool
) -> None:
    expected = expected_of_left(LEFT, PROFILE)
    touched = found(depth_um, wear_um)
    assert (expected.depth_fits(touched), expected.tool_fits(touched)) == (work, tool)


def test_what_no_journal_saw_is_twice_the_mean_feed_or_in_the_first_seconds_five_times_the_recipe() -> None:
    assert expected_of_left(LEFT, PROFILE).unseen_um == pytest.approx(5.0 * 2.0 * 0.3, rel=0.25)
    first = replace(LEFT, depth_um=0.0, wear_um=0.0, machining_time_s=0.0)
    assert expected_of_left(first, PROFILE).unseen_um == pytest.approx(5.0 * 5.0 * 0.3, rel=0.25)
    fast = replace(LEFT, machining_time_s=100.0)
    assert expected_of_left(fast, PROFILE).unseen_um == pytest.approx(5.0 * 2.0 * 1.537, rel=1e-3)


def test_an_unconfirmed_ratio_is_a_belief_and_the_touched_part_is_not() -> None:
    plan = CutPlan(
        2,
        60.0,
        CutStart(200.0, 0.15, 3.0, 0.8, depth_um=100.0, depth_u_um=0.5, wear_um=39.0, wear_u_um=0.4),
        estimate_of(PROFILE).fitted(None, 100.0, 0.3, 39.0, 0.3),
    )
    known = estimate_in_cut(plan, 237.0, energy_of(PROFILE.pulse, CutTotals()), 0.0)
    worn_um = known.wear_um - 39.0
    assert worn_um == pytest.approx(40.0 * 0.389 / 1.389, rel=0.05)
    assert 0.25 * worn_um < known.wear.u < 0.35 * worn_um
    assert 0.25 * worn_um < known.depth.u < 0.35 * worn_um
    assert known.feed.u < 1.0


@pytest.mark.parametrize(("unseen_um", "ratio"), [(9.0, 0.5), (3.0, 0.4)])
def test_what_was_fed_unseen_is_depth_and_wear_even_of_a_hole_that_has_just_begun(
    unseen_um: float, ratio: float
) -> None:
    touched, untouched = (
        with_unseen(lengths(), unseen_um, ratio, is_confirmed=known) for known in (True, False)
    )
    u_um = unseen_um / math.sqrt(3.0)
    assert touched.depth.u == pytest.approx(u_um)
    assert touched.wear.u == pytest.approx(u_um * ratio / (1.0 + ratio))
    assert untouched.wear.u > 1.5 * touched.wear.u


def test_a_drift_over_the_pause_hides_no_other_work() -> None:
    expected = expected_of_left(LEFT, PROFILE)
    drifted = DepthAndWear(Value(-0.2, 0.3), Value(90.0, 150.0), Value(89.8, 150.0), 0.1)
    assert not expected.depth_fits(drifted)
    assert expected.tool_fits(drifted)


def test_a_face_is_untouched_and_a_finished_hole_the_same_within_the_uncertainty() -> None:
    assert [is_untouched(found(depth_um, 0.0)) for depth_um in (-0.2, 0.8, 1.0)] == [True, True, False]
    expected = ExpectedHole(lengths(Value(24.0, 0.3)))
    assert [expected.depth_fits(found(depth_um, 0.0)) for depth_um in (24.9, 25.5)] == [True, False]


@pytest.mark.parametrize("pause_s", [86_400.0 * 40.0, math.inf])
def test_a_pause_counts_until_a_zero_could_not_be_touched(pause_s: float) -> None:
    setup = Setup()
    stroke_um = setup.actuator.gain_um_per_v * setup.actuator.stroke_v
    job = replace(job_of(PROFILE, setup), pause_s=pause_s, resumed=replace(LEFT, pause_s=7.0))
    assert 3.0 * pause_drift_u_um(job) == pytest.approx(stroke_um)
    assert counted_pause_s(replace(job, pause_s=600.0)) == 600.0
    assert pause_drift_u_um(replace(job, pause_s=600.0)) == pytest.approx(1.02)
    assert total_pause_s(replace(job, pause_s=600.0)) == 607.0
    assert math.isnan(total_pause_s(job)) == math.isinf(pause_s)
    still = Setup(sensor=Sensor(drift_um_per_s=0.0))
    assert pause_drift_u_um(replace(job, setup=still)) == 0.0


def test_a_state_of_an_older_version_is_told_from_one_that_knows_its_uncertainty() -> None:
    older = {
        name: value for name, value in LEFT.as_mapping().items() if name not in ("depth_u_um", "pause_s")
    }
    with pytest.raises(ValueError, match="it has no depth_u_um, pause_s"):
        job_state(older)
    assert job_state(LEFT.as_mapping()) == LEFT
    nulls = job_state({**LEFT.as_mapping(), "home_um": None, "channel": {"depth_um": None}})
    assert math.isnan(nulls.home_um)
    assert math.isnan(nulls.channel["depth_um"])


def test_a_bottom_that_is_doubted_makes_the_wear_uncertain_as_well() -> None:
    sure, doubted = (
        CutPlan(1, 20.0, CutStart(50.0, u_um, 3.0, 0.8), estimate_of(PROFILE)) for u_um in (0.3, 6.0)
    )
    energy = energy_of(PROFILE.pulse, CutTotals())
    wear_u_um = [estimate_in_cut(plan, 47.0, energy, 0.0).wear.u for plan in (sure, doubted)]
    assert wear_u_um[1] > 1.0 + wear_u_um[0]
