"""What a result rests on, and whether the holes of a job are what was wanted, by value and by interval."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import pytest

from edmctl.labels import Basis, Verdict
from edmctl.procedures.hole.decision import Decision, judge_holes, judged, record_results
from edmctl.procedures.hole.decision import remedy as remedy_of
from edmctl.procedures.job import HoleTarget, verdict_of
from edmctl.profile.setup import Sensor
from edmctl.record.json_rows import site_result_of
from edmctl.record.rows import RunEvent
from edmctl.results.job import ObjectiveMissed

from .conftest import Done, Shop, eroding

ROW = 'sites=[{kind="grid",x_um=500.0,columns=8,rows=1,dx_um=400.0,dy_um=400.0}]'
THROUGH = (
    'target={kind="through",completion_um=20.0}',
    'work={material="Cu",thickness_um=12.0,kind="through"}',
)
COARSE = Sensor(gain_u_rel=0.2)
"""A sensor whose scale is known so badly that 12 µm are 12 ± 5 µm."""


@pytest.fixture(scope="module")
def row_of_holes() -> Shop:
    shop = Shop([ROW])
    shop.run_job()
    return shop


def test_a_depth_is_judged_by_its_value_and_then_by_its_interval() -> None:
    goal = HoleTarget("depth", 20.0, math.nan, 2.0)
    for depth_um, u95_um, verdict in (
        (20.0, 0.5, Verdict.SHOWN),
        (22.0, 2.0, Verdict.SHOWN),
        (22.88, 0.96, Verdict.MISSED),
        (17.9, 8.0, Verdict.MISSED),
        (19.28, 8.82, Verdict.NOT_SHOWN),
        (20.0, 2.001, Verdict.NOT_SHOWN),
        (20.0, math.nan, Verdict.NOT_SHOWN),
        (math.nan, 0.5, Verdict.MISSED),
    ):
        assert verdict_of(goal, depth_um, u95_um, through=False) is verdict
    # A feed is not judged, and a way through by being one.
    sheet = HoleTarget("through", 50.0, math.nan, 5.0)
    assert verdict_of(HoleTarget("feed", math.nan, 20.0, math.nan), 3.0, 9.0, through=False) is None
    assert verdict_of(sheet, 80.0, 9.0, through=True) is Verdict.SHOWN
    assert verdict_of(sheet, 50.0, 0.1, through=False) is Verdict.MISSED


def test_a_depth_that_nobody_knows_well_enough_ends_the_job_short_of_its_objective() -> None:
    s = Shop(["wear.max_cuts=1"])
    s.job = replace(s.job, setup=s.job.setup.model_copy(update={"sensor": COARSE}))
    with pytest.raises(ObjectiveMissed, match=r"not shown to be right: 1\d\.\d\d ± [45]") as caught:
        s.run_job()
    assert (caught.value.code, caught.value.exit_code) == ("E7013", 7)
    assert caught.value.hint
    (site,) = caught.value.result.sites
    assert abs(site.depth_um - 12.0) <= 2.0
    assert site.verdict is Verdict.NOT_SHOWN
    assert [row.verdict for row in s.seen.sites] == ["not shown"]
    assert RunEvent.VERDICT in s.seen.codes
    assert s.bench.is_safe


def after_corrections(shop: Shop, depths: dict[str, tuple[float, float]]) -> Decision | None:
    """Judge the shop's finished job with other depths of some holes, as later touches may give them."""
    again = Shop([ROW])
    again.tally.sites = dict(shop.tally.sites)
    for name, (depth_um, u95_um) in depths.items():
        again.tally.sites[name] = replace(
            shop.tally.sites[name], depth_um=depth_um, depth_u95_um=u95_um, verdict=None
        )
    again.tally.unwritten = list(again.tally.sites)
    run = again.run()
    record_results(run)
    for row in again.seen.sites:
        assert row.verdict == again.tally.sites[row.name].verdict
    return judge_holes(run, None)


@pytest.mark.parametrize(
    ("depths", "code", "texts", "hint"),
    [
        ({}, "", (), ""),
        ({1: (15.88, 0.96)}, "E7010", ("outside the tolerance: 15.88 ± 0.96 µm for 12 ± 2 µm",), ""),
        ({2: (12.4, 3.1)}, "E7013", ("1 of 8", "right: 12.40 ± 3.10 µm for 12 ± 2 µm"), "wear.remeasure"),
        (
            {0: (20.0, 1.0), 1: (12.0, 4.0), **{i: (20.0, 1.0) for i in range(2, 8)}},
            "E7010",
            ("8 of 8 holes are not right", "and 3 more"),
            "",
        ),
    ],
)
def test_holes_that_later_touches_find_wrong_end_the_job_short_of_its_objective_the_missed_ones_first(
    row_of_holes: Shop, depths: dict[int, tuple[float, float]], code: str, texts: tuple[str, ...], hint: str
) -> None:
    names = list(row_of_holes.tally.sites)
    decision = after_corrections(row_of_holes, {names[i]: depth for i, depth in depths.items()})
    assert (decision.code if decision else "") == code
    if decision:
        assert [text for text in (*texts, names[min(depths)]) if text not in decision.missed] == []
        assert decision.missed.count("20.00 ± 1.00") in (0, 5)
        assert hint in decision.hint


def test_what_ended_the_job_stays_its_reason_and_the_others_are_told_behind_it(row_of_holes: Shop) -> None:
    s = Shop([ROW, "tool.max_wear_um=12.0"])
    with pytest.raises(ObjectiveMissed) as caught:
        s.run_job()
    assert "tool.max_wear_um" in caught.value.message
    run, first = s.run(), next(iter(s.tally.sites))
    worn_out = after_corrections(row_of_holes, {first: (15.88, 0.96)})
    assert worn_out is not None
    run.tally.sites[first] = replace(run.tally.sites[first], depth_um=15.88, verdict=Verdict.MISSED)
    both = judge_holes(run, replace(worn_out, missed="The tool is short.", code="E7099"))
    assert both is not None
    assert both.missed.startswith("The tool is short. 1 of 8 holes are not right")
    assert both.code == "E7099"


def test_a_sparing_recipe_leaves_a_small_last_cut_estimated_and_says_so() -> None:
    """A tool that wears 2.5 times as much as the recipe says leaves a small rest to the third cut."""
    overrides = ['wear.remeasure="sparing"', 'target={kind="depth",depth_um=10.0,tolerance_um=0.8}']
    (site,) = Shop(overrides, changed=lambda config: eroding(config, 2.5)).run_job().sites
    assert site.estimated_um > 0.0
    assert (site.depth_basis, site.wear_basis) == (Basis.ESTIMATED, Basis.ESTIMATED)


def test_holes_without_a_touch_stay_estimated_after_the_touch_that_corrects_them(row_of_holes: Shop) -> None:
    sites = list(row_of_holes.tally.sites.values())
    untouched = [site for site in sites if not site.measuring_stops]
    assert untouched
    assert (
        {site.depth_basis for site in untouched} == {site.wear_basis for site in untouched} == {"estimated"}
    )
    assert sites[-1].measuring_stops > 0
    for site in untouched:
        assert site.feed_um == pytest.approx(site.depth_um + site.wear_um, abs=1e-9)
        assert site.feed_u95_um <= math.hypot(site.depth_u95_um, site.wear_u95_um)
    for site in sites:
        assert site.feed_u95_um <= site.depth_u95_um + site.wear_u95_um
    assert [row.depth_basis for row in row_of_holes.seen.sites] == [site.depth_basis for site in sites]


def test_a_hole_through_the_sheet_has_a_touched_wear_and_an_estimated_tip() -> None:
    """There is no sheet on this bench: the wear is touched all the same, and the way through is missed."""
    with pytest.raises(ObjectiveMissed) as caught:
        Shop(THROUGH).run_job()
    (site,) = caught.value.result.sites
    assert (site.depth_basis, site.wear_basis) == (Basis.ESTIMATED, Basis.TOUCHED)
    assert site.verdict is Verdict.MISSED


def test_a_result_travels_through_a_journal_and_an_older_one_claims_no_touch(done: Done) -> None:
    (site,) = done.result.sites
    kept = {**asdict(site), "verdict": None}
    assert judged(done.shop.job, site_result_of(kept)) == site
    older = {key: value for key, value in kept.items() if key not in ("depth_basis", "wear_basis", "verdict")}
    assert site_result_of(older).depth_basis is Basis.ESTIMATED


@pytest.mark.parametrize(
    ("changed", "remedy"),
    [
        ({"depth_um": 9.0, "depth_u95_um": 0.5}, "wear.max_cuts"),
        ({"depth_um": 15.0, "depth_u95_um": 0.5}, "Set wear.expected_ratio to "),
        # A doubted bottom makes it estimated, a doubted face does not; a touch of the same kind would show no more.
        *(
            (
                {"depth_u95_um": 3.1, "depth_basis": basis, "in_doubt": True},
                "Clean tool and work, and measure",
            )
            for basis in (Basis.TOUCHED, Basis.ESTIMATED)
        ),
    ],
)
def test_the_remedy_of_a_hole_depends_on_what_is_wrong_with_it(
    done: Done, changed: dict[str, object], remedy: str
) -> None:
    shop, (result,) = Shop(), done.result.sites
    assert not result.in_doubt
    result = replace(result, **changed)  # type: ignore[arg-type]
    shop.tally.sites[result.name] = judged(shop.job, result)
    decision = judge_holes(shop.run(), None)
    assert decision is not None
    assert remedy in decision.hint


def test_a_remedy_names_the_key_that_helps_and_no_value_that_no_recipe_takes(done: Done) -> None:
    once, often = (Shop([f"wear.remeasure={cuts}", "wear.max_cuts=3"]).profile for cuts in (1, 9))
    assert "(wear.remeasure)" in remedy_of(once, -2.0)
    assert "(wear.max_cuts)" in remedy_of(often, -2.0)
    assert "wear.expected_ratio to 0.337" in remedy_of(done.shop.profile, 2.0, 0.337)
    for unknown in (math.nan, -0.01):
        assert "wear.first_fraction" in remedy_of(done.shop.profile, 2.0, unknown)
