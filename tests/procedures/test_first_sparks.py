"""A working gap that is not as it was believed, in whole quick jobs: it costs a warning and no accuracy."""

from __future__ import annotations

import pytest

import edmctl
from edmctl.errors import EdmWarning
from edmctl.record.rows import RunEvent
from tests.tiers import tiers

from .conftest import Kept, Shop, refused
from .test_face import SPOTS, move_the_far_face

STRONG = (
    "pulse.current_a=1",
    "servo.forward_um_s=10",
    "servo.back_um_s=10",
    "target.depth_um=20",
    "jump.height_um=60",
    'log.pulses="off"',
)
TWO_HOLES = 'sites=[{kind="grid",name="hole",x_um=1000,y_um=0,columns=2,rows=1,dx_um=600,dy_um=600}]'


def withdrawn(shop: Shop) -> list[str]:
    """The reports of withdrawn doubts."""
    return shop.seen.messages(RunEvent.DOUBT_WITHDRAWN)


@pytest.mark.parametrize("voltage_v", tiers(120.0, slow=(60.0, 80.0, 100.0)))
def test_a_higher_open_voltage_alone_puts_nothing_in_doubt(voltage_v: float) -> None:
    shop = Shop((f"pulse.open_voltage_v={voltage_v:g}",), seed=3201)
    (site,) = shop.run_job().sites
    assert shop.seen.doubts == []
    assert shop.holds(site, 1.0)


@pytest.mark.parametrize("gap_um", tiers(20.0, slow=(10.0, 14.0)))
def test_a_wrong_belief_of_the_gap_is_doubted_until_a_stop_has_measured_it(gap_um: float) -> None:
    shop, kept = Shop((f"measure.expected_gap_um={gap_um:g}",), seed=3202), Kept()
    (site,) = shop.run_job(journal=kept).sites
    (doubt,) = shop.seen.doubts
    assert f"or the working gap is not the {gap_um:.1f} µm believed" in doubt
    assert len(withdrawn(shop)) == 1
    assert shop.holds(site, 1.0)
    assert max(state.face_doubt_u_um for state in kept.states) > 3.0
    assert kept.states[-1].face_doubt_u_um == 0.0


@pytest.mark.parametrize(
    ("voltage_v", "gap_um"),
    tiers((100.0, 20.0), slow=((40.0, 0.5), (40.0, 6.0), (40.0, 8.0), (100.0, 3.4), (100.0, 6.0))),
)
def test_a_belief_somewhat_wrong_leaves_nothing_in_doubt_at_the_end(voltage_v: float, gap_um: float) -> None:
    overrides = (f"pulse.open_voltage_v={voltage_v:g}", f"measure.expected_gap_um={gap_um:g}")
    shop = Shop(overrides, seed=3203)
    (site,) = shop.run_job().sites
    assert shop.holds(site, 1.0)


def test_a_wrong_belief_of_the_gap_costs_no_hole_of_an_array() -> None:
    shop = Shop((TWO_HOLES, "measure.expected_gap_um=20"), seed=3204)
    sites = shop.run_job().sites
    assert len(withdrawn(shop)) == 1
    assert len(sites) == 2
    assert all(shop.holds(site, 2.0) for site in sites)


def test_a_doubt_of_a_face_that_nobody_touched_outlives_the_run() -> None:
    shop = Shop(seed=3206)
    move_the_far_face(shop, 9.0, beyond_um=250.0)
    state = shop.left(lambda p: p.depth_um > 6.0)
    assert any(told.startswith("Sparks began") for told in shop.seen.doubts)
    assert state.face == ()
    assert state.face_doubt_u_um > 3.0
    after = shop.taken_up(state)
    with refused("E7013"):
        after.run_job()
    (site,) = after.tally.sites.values()
    assert after.holds(site)


@pytest.mark.parametrize("gap_um", tiers(10.0, slow=(3.4,)))
def test_a_gap_that_does_not_explain_the_first_sparks_withdraws_nothing(gap_um: float) -> None:
    overrides = ("measure.site_dx_um=5000", f"measure.expected_gap_um={gap_um:g}")
    shop = Shop(overrides, seed=3205)
    move_the_far_face(shop, 9.0, after_touches=SPOTS)
    with refused("E7013") as caught:
        shop.run_job()
    assert "Clean tool and work" in caught.value.hint
    assert withdrawn(shop) == []
    (site,) = shop.tally.sites.values()
    assert shop.holds(site)


@pytest.mark.parametrize("seed", tiers(4, slow=(5, 6, 7)))
def test_sparks_that_erode_faster_than_the_approach_are_caught_up_with(seed: int) -> None:
    with pytest.warns(EdmWarning, match="W3108"):
        report = edmctl.connect(seed=seed).machine("cu150", overrides=STRONG)
    assert report.sites, report.error
    site, true = report.sites[0], report.truths[0]
    assert abs(site.depth_um - true.depth_um) <= site.depth_u95_um
    assert report.error is None or report.error.code in {"E7010", "E7013"}, report.error
