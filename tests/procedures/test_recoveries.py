"""What a cut does against burns, shorts, stalls and lost sparks before it gives up; and how it ends a sheet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.errors import MachineFault
from edmctl.procedures.breakthrough import Breakthrough
from edmctl.procedures.burning import MOST_BURNS
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.results import ObjectiveMissed
from edmctl.procedures.settings import OPEN_LOST_S, controller_settings
from edmctl.procedures.short_recovery import MOST_JUMPS, ShortRecovery
from edmctl.procedures.spark_loss import SparkLoss
from edmctl.procedures.stalls import JUMP_AFTER_S, STALL_S, Stall
from edmctl.simulator import kernel as k
from edmctl.simulator.injection import parse_injection

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Shop

    OpenShop = Callable[..., Shop]

SLICE_S = 0.1
SHEET = ('target={kind="through",completion_um=20.0}', 'work.kind="through"', "work.thickness_um=40.0")


def codes(s: Shop) -> list[int]:
    return [code for _, code, _, _, _ in s.seen.events]


def injected(
    shop: OpenShop, fault: str, *, until: tuple[RunEvent, int] | None = None, overrides: tuple[str, ...] = ()
) -> Shop:
    """A shop in which something goes wrong, and is right again after so many answers to it."""
    s = shop(overrides)
    s.bench.inject(parse_injection(fault))
    read = s.bench.transport.read

    def read_and_repair(timeout_s: float) -> bytes:
        if until is not None and codes(s).count(until[0]) == until[1]:
            s.bench.clear_injections()
        return read(timeout_s)

    s.bench.transport.read = read_and_repair  # type: ignore[method-assign]
    return s


def test_a_single_burn_costs_the_way_back_and_no_more(shop: OpenShop) -> None:
    s = injected(shop, "CARBON@sparks+5", until=(RunEvent.ARC_BURN_RECOVERY, 1))
    result = s.run_job()
    assert result.sites[0].depth_um == pytest.approx(12.0, abs=2.0)
    assert codes(s).count(RunEvent.ARC_BURN_RECOVERY) == 1
    assert RunEvent.REFERENCE_CHANGED not in codes(s)
    assert s.bench.controller.fault == 0


def test_after_the_second_burn_the_gap_is_kept_wider_and_the_pauses_longer(shop: OpenShop) -> None:
    s = injected(shop, "CARBON@sparks+5", until=(RunEvent.ARC_BURN_RECOVERY, 2))
    result = s.run_job()
    assert result.sites[0].depth_um == pytest.approx(12.0, abs=2.0)
    found = codes(s)
    assert found.count(RunEvent.ARC_BURN_RECOVERY) == 2
    changes = [args for _, code, _, _, args in s.seen.events if code == RunEvent.REFERENCE_CHANGED]
    assert [change["to"] for change in changes] == pytest.approx([0.85])
    duties = [args for _, code, _, _, args in s.seen.events if code == RunEvent.DUTY_CHANGED]
    assert [duty["to"] for duty in duties] == pytest.approx([0.24])
    # The next approach and the next cut start with the recipe's own pulses.
    assert s.bench.plant.par[k.DUTY_V] == pytest.approx(s.profile.pulse.duty_voltage_v)


def test_a_spot_that_burns_at_once_again_is_given_up_with_the_fault(shop: OpenShop) -> None:
    s = injected(shop, "CARBON@sparks+5")
    with pytest.raises(MachineFault) as caught:
        s.run_job()
    assert caught.value.code == "E63002"
    assert codes(s).count(RunEvent.ARC_BURN_RECOVERY) == 2 < MOST_BURNS
    controller = s.bench.controller
    assert (controller.fault, controller.st.item(k.COMMAND_V)) == (3002, 0.0)


def test_any_other_fault_ends_the_cut_at_once(shop: OpenShop) -> None:
    s = injected(shop, "GENERATOR_LEAK@sparks+5")
    with pytest.raises(MachineFault):
        s.run_job()
    assert RunEvent.ARC_BURN_RECOVERY not in codes(s)


def test_a_short_that_lasts_is_jumped_away_from(shop: OpenShop) -> None:
    s = injected(shop, "WIRE_SHORT@sparks+5", until=(RunEvent.SHORT_RECOVERY, 1))
    assert s.run_job().sites[0].depth_um == pytest.approx(12.0, abs=2.0)
    assert 1 <= codes(s).count(RunEvent.SHORT_RECOVERY) <= MOST_JUMPS


def test_a_short_that_stays_is_left_to_the_controller(shop: OpenShop) -> None:
    # While shorted the tool retreats as well; from a greater height there is way left for every jump.
    s = injected(shop, "WIRE_SHORT@sparks+5", overrides=("approach.offset_um=80.0",))
    with pytest.raises(MachineFault) as caught:
        s.run_job()
    assert caught.value.code == "E63001"
    assert codes(s).count(RunEvent.SHORT_RECOVERY) == MOST_JUMPS


def test_after_a_healthy_while_a_short_is_a_new_one() -> None:
    shorts = ShortRecovery()
    for _ in range(MOST_JUMPS + 1):
        for _ in range(4):
            shorts.take(SLICE_S, 230, 230, sparking=True)
        if shorts.due():
            shorts.jumped()
    assert (shorts.jumps, shorts.due()) == (MOST_JUMPS, "")
    for _ in range(110):
        shorts.take(SLICE_S, 230, 3, sparking=True)
    for _ in range(4):
        shorts.take(SLICE_S, 230, 230, sparking=True)
    assert shorts.due()


def test_a_few_pulses_among_the_shorts_are_no_lasting_short() -> None:
    shorts = ShortRecovery()
    for _ in range(50):
        shorts.take(SLICE_S, 230, 225, sparking=True)
    assert shorts.due() == ""


def test_a_stall_is_answered_by_a_jump_before_the_verdict(shop: OpenShop) -> None:
    s = injected(shop, "STALL@sparks+5")
    with pytest.raises(ObjectiveMissed) as caught:
        s.run_job()
    assert caught.value.code == "E7010"
    times_s = {code: time_s for time_s, code, _, _, _ in s.seen.events}
    assert times_s[RunEvent.STALL_JUMP] < times_s[RunEvent.CUT_GIVEN_UP]


def test_a_jump_that_frees_the_tool_starts_the_clock_of_a_stall_anew() -> None:
    stall = Stall(0.3)
    i = 0
    while not stall.jump_wanted:
        assert not stall.take(SLICE_S * i, 50.0)
        i += 1
    assert i * SLICE_S == pytest.approx(JUMP_AFTER_S, abs=0.5)
    stall.jump_wanted = False
    for j in range(i, i + round(STALL_S / SLICE_S)):
        assert not stall.take(SLICE_S * j, 50.0 + 0.02 * (j - i))


def test_lost_sparks_come_with_a_way_to_tell_a_lost_tool_from_missing_pulses(shop: OpenShop) -> None:
    s = injected(
        shop, "TOOL_LOST@sparks+5", overrides=('target={kind="depth",depth_um=60.0,tolerance_um=5.0}',)
    )
    with pytest.raises(MachineFault) as caught:
        s.run_job()
    assert caught.value.code == "E63005"
    assert "`edmctl reset --ack 3005`" in caught.value.hint
    assert "`edmctl approach --contact`" in caught.value.hint


class Sheet:
    """A cut through a sheet of 40 µm as the detector sees it: 0.3 µm/s, 30 % open pulses."""

    def __init__(self) -> None:
        self.seen = Breakthrough(40.0)
        self.z_um = self.depth_um = 0.0

    def cut(self, seconds: float, *, feed_um_s: float = 0.3, opens: float = 0.3) -> float | None:
        """Cut on; how long it took to see the breakthrough, None where it was not seen."""
        for i in range(round(seconds / SLICE_S)):
            self.z_um += feed_um_s * SLICE_S
            self.depth_um += feed_um_s * SLICE_S / 1.39
            wiggle_um = 0.1 * (-1) ** i
            if self.seen.take(SLICE_S, self.z_um + wiggle_um, self.depth_um, opens, sparking=True):
                return (i + 1) * SLICE_S
        return None


def test_more_feed_and_more_open_pulses_at_the_right_depth_are_a_breakthrough() -> None:
    sheet = Sheet()
    assert sheet.cut(180.0) is None
    seen_s = sheet.cut(10.0, feed_um_s=1.0, opens=0.55)
    assert seen_s is not None
    assert seen_s < 5.0
    assert sheet.seen.at_um == pytest.approx(sheet.z_um, abs=0.5)
    assert "open pulses from 3" in sheet.seen.told


@pytest.mark.parametrize(
    ("before_s", "feed_um_s", "opens"),
    [(60.0, 1.0, 0.55), (180.0, 0.3, 0.55), (180.0, 1.0, 0.3)],
    ids=["too early", "no faster", "not more open"],
)
def test_two_of_the_three_signs_are_not_enough(before_s: float, feed_um_s: float, opens: float) -> None:
    sheet = Sheet()
    sheet.cut(before_s)
    assert sheet.cut(5.0, feed_um_s=feed_um_s, opens=opens) is None


def test_coming_back_from_a_jump_is_no_breakthrough() -> None:
    sheet = Sheet()
    sheet.cut(180.0)
    for _ in range(10):
        sheet.seen.take(SLICE_S, sheet.z_um - 60.0, sheet.depth_um, 1.0, sparking=False)
        assert sheet.cut(0.5, feed_um_s=4.0, opens=0.9) is None
        assert sheet.cut(3.0) is None


def test_open_pulses_behind_the_sheet_are_borne_as_long_as_the_completion_takes(shop: OpenShop) -> None:
    plain, sheet = shop(), shop(SHEET)
    usual = controller_settings(plain.profile, plain.job.setup)
    borne = controller_settings(sheet.profile, sheet.job.setup)
    assert (usual.open_lost_um, usual.open_lost_s) == (plain.profile.limits.open_lost_um, OPEN_LOST_S)
    assert borne.open_lost_um >= 20.0 + usual.open_lost_um
    assert borne.open_lost_s >= 20.0 / sheet.profile.servo.forward_um_s + OPEN_LOST_S


def test_before_the_breakthrough_the_host_looks_for_lost_sparks() -> None:
    loss = SparkLoss(15.0, 3.0)
    assert loss.take(SLICE_S, 50.0, 230, 100) == ""
    for i in range(1, 30):
        assert loss.take(SLICE_S, 50.0 + 0.4 * i, 230, 230) == ""
    assert "without a discharge" in loss.take(1.0, 66.0, 230, 230)
    assert loss.take(SLICE_S, 66.0, 230, 229) == ""
