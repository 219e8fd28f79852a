"""A working gap that is not as it was believed, in whole quick jobs: it costs a warning and no accuracy."""

from __future__ import annotations

import pytest

from edmctl.record.rows import RunEvent
from tests.tiers import tiers

from .conftest import Kept, Shop, refused
from .test_face import SPOTS, move_the_far_face


def withdrawn(shop: Shop) -> list[str]:
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
    assert f"or the working gap is not the expected {gap_um:.1f} µm" in doubt
    assert len(withdrawn(shop)) == 1
    assert shop.holds(site, 1.0)
    assert max(state.face_doubt_u_um for state in kept.states) > 3.0
    assert kept.states[-1].face_doubt_u_um == 0.0


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
