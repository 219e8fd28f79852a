"""What a cut does against burns, shorts, stalls and lost sparks before it gives up; and how it ends a sheet."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest

from edmctl.errors import MachineFault
from edmctl.procedures.hole import cut as cutting
from edmctl.procedures.hole.cut import AGAIN_S, ARC_BURN, MOST_BURNS, Cut
from edmctl.procedures.hole.cut_planning import CutStart, first_plan
from edmctl.procedures.job import JobState
from edmctl.procedures.servo.adaptive import MOST_JUMPS, ShortRecovery
from edmctl.procedures.servo.limits import (
    JUMP_AFTER_S,
    STALL_S,
    Breakthrough,
    SparkLoss,
    StallDetection,
    TimeLeft,
)
from edmctl.procedures.settings import OPEN_LOST_S, controller_settings
from edmctl.procedures.touch.approach import ABOVE_BOTTOM_UM, BEYOND_BOTTOM_UM, UNKNOWN_SDS
from edmctl.quantity import Value
from edmctl.record.rows import RunEvent
from tests.tiers import tiers

from .conftest import Shop, eroding, refused

SLICE_S = 0.1
SHEET = ('target={kind="through",completion_um=20.0}', 'work.kind="through"', "work.thickness_um=40.0")


def injected(
    fault: str, *, until: tuple[RunEvent, int] | None = None, overrides: tuple[str, ...] = ()
) -> Shop:
    """A shop in which something goes wrong, and is right again after so many answers to it."""
    s = Shop(overrides)
    s.inject(fault)
    read = s.bench.transport.read

    def read_and_repair(timeout_s: float) -> bytes:
        if until is not None and s.seen.codes.count(until[0]) == until[1]:
            s.bench.clear_injections()
        return read(timeout_s)

    s.bench.transport.read = read_and_repair  # type: ignore[method-assign]
    return s


@pytest.mark.parametrize("burns", [1, 2])
def test_a_burn_costs_the_way_back_and_the_second_a_wider_gap_and_longer_pauses(burns: int) -> None:
    s = injected("CARBON@sparks+5", until=(RunEvent.ARC_BURN_RECOVERY, burns))
    (site,) = s.run_job().sites
    assert site.depth_um == pytest.approx(12.0, abs=2.0)
    assert s.seen.codes.count(RunEvent.ARC_BURN_RECOVERY) == burns
    second = burns > 1
    changes = s.seen.args(RunEvent.REFERENCE_CHANGED), s.seen.args(RunEvent.DUTY_CHANGED)
    assert [change["to"] for kind in changes for change in kind] == pytest.approx([0.85, 0.24] * second)
    # The next approach and the next cut start with the recipe's own pulses.
    assert s.bench.controller.seen.duty_v == pytest.approx(s.profile.pulse.duty_voltage_v)
    assert s.bench.controller.fault == 0


BURN = MachineFault("", code=ARC_BURN, fault=3002)


def burning(
    monkeypatch: pytest.MonkeyPatch, seen_um: float, ways_um: list[float]
) -> tuple[Cut, SimpleNamespace]:
    """A cut and its supervisor that last saw the tool at `seen_um`; approaches go to `ways_um`."""
    s = Shop()
    machine = SimpleNamespace(
        time_s=100.0,
        clear_fault=lambda _: None,
        arm=lambda: None,
        rest=lambda _: None,
        approach=lambda _, way_um, __: ways_um.append(way_um),
    )
    watch = SimpleNamespace(displacement_um=0.0)
    run = replace(s.run(), machine=machine, watch=watch)  # type: ignore[arg-type]
    start = CutStart(50.0, 3.0, 2.0, drift_u_um_per_s=0.04, gap_u_um=0.0)
    adaptive = SimpleNamespace(soften=lambda *_: None, changes=[], duty=0.3, reference=0.8)
    supervisor = SimpleNamespace(displacement_um=seen_um, sparking_s=1.0, seen_s=95.0, adaptive=adaptive)
    cut = Cut(run, first_plan(s.profile, start), TimeLeft(100.0, ""))
    for name, value in (("_supervisor", supervisor), ("_start", lambda: None), ("_duty", 0.3)):
        monkeypatch.setattr(cut, name, value)
    return cut, supervisor


def test_burns_far_apart_are_answered_and_soon_after_each_other_only_two(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cutting, "lower_to", lambda *_: None)

    def answered(apart_s: float) -> int:
        ways_um: list[float] = []
        cut, supervisor = burning(monkeypatch, 48.0, ways_um)
        for _ in range(MOST_BURNS):
            try:
                cut.recover(BURN)
            except MachineFault:
                break
            supervisor.sparking_s += apart_s
        return len(ways_um)

    assert answered(AGAIN_S + 1.0) == MOST_BURNS - 1
    assert answered(AGAIN_S - 1.0) == 2


@pytest.mark.parametrize(("seen_um", "unknown_um"), [(math.nan, 5.0), (48.0, 0.2)])
def test_the_ramp_back_from_a_burn_ends_above_where_the_bottom_can_be(
    monkeypatch: pytest.MonkeyPatch, seen_um: float, unknown_um: float
) -> None:
    """Where telemetry told no sparks the bottom is what was planned, as far as that is known 100 s later."""
    ramps_um: list[float] = []
    ways_um: list[float] = []
    monkeypatch.setattr(cutting, "lower_to", lambda _, target_um: ramps_um.append(target_um))
    cut, _ = burning(monkeypatch, seen_um, ways_um)
    cut.recover(BURN)
    spark_um = 48.0
    assert ramps_um == [pytest.approx(spark_um - ABOVE_BOTTOM_UM - UNKNOWN_SDS * unknown_um)]
    assert ways_um == [pytest.approx(spark_um + BEYOND_BOTTOM_UM + UNKNOWN_SDS * unknown_um)]


DEEP = 'target={kind="depth",depth_um=60.0,tolerance_um=5.0}'


@pytest.mark.parametrize(
    ("fault", "overrides", "code", "recovery", "times"),
    [
        ("CARBON", (), "E63002", RunEvent.ARC_BURN_RECOVERY, 2),
        ("GENERATOR_LEAK", (), "E63004", RunEvent.ARC_BURN_RECOVERY, 0),
        # While shorted the tool retreats as well; from a greater height there is way left for every jump.
        ("WIRE_SHORT", ("approach.offset_um=80.0",), "E63001", RunEvent.SHORT_RECOVERY, MOST_JUMPS),
        ("STALL", (), "E7010", RunEvent.STALL_JUMP, 1),
        ("TOOL_LOST", (DEEP,), "E63005", RunEvent.ARC_BURN_RECOVERY, 0),
    ],
)
def test_what_stays_wrong_ends_the_cut_after_the_recoveries_that_it_has(
    fault: str, overrides: tuple[str, ...], code: str, recovery: RunEvent, times: int
) -> None:
    s = injected(f"{fault}@sparks+5", overrides=overrides)
    with refused(code) as caught:
        s.run_job()
    assert s.seen.codes.count(recovery) == times
    if fault == "CARBON":
        assert (s.bench.controller.fault, s.bench.controller.loop.command_v) == (3002, 0.0)
    if fault == "STALL":
        assert s.seen.codes.index(recovery) < s.seen.codes.index(RunEvent.CUT_GIVEN_UP)
    if fault == "TOOL_LOST":
        assert "`edmctl reset --ack 3005`" in caught.value.hint
        assert "`edmctl approach --contact`" in caught.value.hint


def test_a_short_that_lasts_is_jumped_away_from() -> None:
    s = injected("WIRE_SHORT@sparks+5", until=(RunEvent.SHORT_RECOVERY, 1))
    assert s.run_job().sites[0].depth_um == pytest.approx(12.0, abs=2.0)
    assert 1 <= s.seen.codes.count(RunEvent.SHORT_RECOVERY) <= MOST_JUMPS


def test_after_a_healthy_while_a_short_is_a_new_one() -> None:
    shorts = ShortRecovery()
    for _ in range(50):  # a few pulses among the shorts are no lasting short
        shorts.update(SLICE_S, 230, 225, sparking=True)
    assert shorts.due() == ""
    for _ in range(MOST_JUMPS + 1):
        for _ in range(4):
            shorts.update(SLICE_S, 230, 230, sparking=True)
        if shorts.due():
            shorts.jumped()
    assert (shorts.jumps, shorts.due()) == (MOST_JUMPS, "")
    for _ in range(110):
        shorts.update(SLICE_S, 230, 3, sparking=True)
    for _ in range(4):
        shorts.update(SLICE_S, 230, 230, sparking=True)
    assert shorts.due()


def test_a_jump_that_frees_the_tool_starts_the_clock_of_a_stall_anew() -> None:
    stall = StallDetection(0.3)
    i = 0
    while not stall.jump_wanted:
        assert not stall.update(SLICE_S * i, 50.0)
        i += 1
    assert i * SLICE_S == pytest.approx(JUMP_AFTER_S, abs=0.5)
    stall.jump_wanted = False
    for j in range(i, i + round(STALL_S / SLICE_S)):
        assert not stall.update(SLICE_S * j, 50.0 + 0.02 * (j - i))


@pytest.mark.parametrize(
    ("fault", "overrides", "code"),
    tiers(
        ("TOOL_LOST@sparks+20", (), "E62005"),  # the feed comes to its end, and no touch finds anything
        ("TOOL_LOST@sparks+20", (DEEP,), "E63005"),  # the controller misses the sparks
        ("ESTOP@sparks+0.3", (), "E64001"),
        slow=(
            *((f"TOOL_LOST@sparks+{sparks_s}", (), "E62005") for sparks_s in (10, 30)),
            *((f"TOOL_LOST@sparks+{sparks_s}", (DEEP,), "E63005") for sparks_s in (10, 30)),
            *((f"ESTOP@sparks+{sparks_s}", (), "E64001") for sparks_s in (0.05, 1.0)),
        ),
    ),
)
def test_a_hole_that_a_fault_ends_is_as_deep_as_it_was_then(
    fault: str, overrides: tuple[str, ...], code: str
) -> None:
    """Nothing is known exactly of one that has hardly begun."""
    s = injected(fault, overrides=overrides)
    with refused(code):
        s.run_job()
    (left,), (hole,) = s.tally.sites.values(), s.bench.truth()
    assert left.depth_um == pytest.approx(hole.depth_um, abs=left.depth_u95_um)
    assert left.wear_um == pytest.approx(s.bench.tool_wear_um, abs=left.wear_u95_um)
    assert left.wear_u95_um > 0.1


class Sheet:
    """A cut through a sheet of 40 µm as the detector sees it: 0.3 µm/s, 30 % open pulses."""

    def __init__(self, u_um: float = 0.0) -> None:
        self.seen = Breakthrough(40.0)
        self.u_um = u_um
        self.z_um = self.depth_um = 0.0

    def cut(self, seconds: float, *, feed_um_s: float = 0.3, opens: float = 0.3) -> float | None:
        """Cut on; how long it took to see the breakthrough, None where it was not seen."""
        for i in range(round(seconds / SLICE_S)):
            self.z_um += feed_um_s * SLICE_S
            self.depth_um += feed_um_s * SLICE_S / 1.39
            wiggle_um = 0.1 * (-1) ** i
            depth = Value(self.depth_um, self.u_um)
            if self.seen.update(SLICE_S, self.z_um + wiggle_um, depth, opens, sparking=True):
                return (i + 1) * SLICE_S
        return None


def test_more_feed_and_more_open_pulses_at_the_right_depth_are_a_breakthrough() -> None:
    sheet = Sheet()
    assert sheet.cut(180.0) is None
    assert (sheet.cut(10.0, feed_um_s=1.0, opens=0.55) or math.inf) < 5.0
    assert sheet.seen.at_um == pytest.approx(sheet.z_um, abs=0.5)
    assert "open pulses from 3" in sheet.seen.message


@pytest.mark.parametrize(
    ("u_um", "before_s", "feed_um_s", "opens", "found"),
    [
        pytest.param(0.0, 60.0, 1.0, 0.55, False, id="too early"),
        pytest.param(0.0, 180.0, 0.3, 0.55, False, id="no faster"),
        pytest.param(0.0, 180.0, 1.0, 0.3, False, id="not more open"),
        pytest.param(4.0, 130.0, 1.0, 0.55, True, id="early, of an uncertain depth"),
        pytest.param(10.0, 300.0, 1.0, 0.55, True, id="late, of an uncertain depth"),
    ],
)
def test_all_three_signs_are_needed_as_well_as_the_depth_is_known(
    u_um: float, before_s: float, feed_um_s: float, opens: float, *, found: bool
) -> None:
    sheet = Sheet(u_um)
    assert sheet.cut(before_s) is None
    assert (sheet.cut(5.0, feed_um_s=feed_um_s, opens=opens) is not None) is found


def test_where_the_feed_has_no_room_to_rise_the_end_of_all_sparks_tells() -> None:
    """The work erodes half as fast as the servo feeds: at the back the feed cannot rise to 1.6 times itself."""
    sheet, far = Sheet(2.0), Sheet(2.0)
    assert sheet.cut(20.0, feed_um_s=2.4) is None
    assert sheet.cut(1.0, feed_um_s=3.5, opens=1.0) is None
    depth = Value(sheet.depth_um, 2.0)
    assert sheet.seen.on_spark_loss(48.0, depth, "3.0 s and 12 µm without a discharge")
    assert sheet.seen.at_um == 48.0
    assert "without a discharge" in sheet.seen.message
    far.cut(60.0)
    assert not far.seen.on_spark_loss(18.0, Value(far.depth_um, 2.0), "")
    assert math.isnan(far.seen.at_um)


@dataclass(slots=True)
class Tip:
    """A journal that looks how far below the face the tip is when a cut has ended, the tool held."""

    shop: Shop
    below_um: float = math.nan
    face_um: float = math.nan

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        if state.phase == "machining" and math.isnan(self.face_um):
            self.face_um = self.shop.bench.plant.state.surface_um
        elif state.phase == "measuring" and state.begun and math.isnan(self.below_um):
            self.below_um = (
                self.shop.bench.plant.state.true_z_um - self.face_um - self.shop.bench.plant.state.wear_um
            )


@pytest.mark.parametrize(("wear", "removal"), tiers((2.0, 1.0), (1.0, 4.0), slow=((1.0, 1.0), (0.3, 1.0))))
def test_a_way_through_ends_behind_the_sheet_whatever_was_believed_of_wear_and_removal(
    wear: float, removal: float
) -> None:
    s = Shop(SHEET, seed=7, changed=lambda c: replace(eroding(c, wear, removal), thickness_um=40.0))
    tip = Tip(s)
    (site,) = s.run_job(journal=tip).sites
    assert site.through
    assert s.bench.truth()[0].through
    assert math.isnan(site.depth_um)
    assert abs(site.beyond_exit_um - (tip.below_um - 40.0)) <= site.beyond_exit_u95_um
    assert s.holds_wear(site)


def test_coming_back_from_a_jump_is_no_breakthrough() -> None:
    sheet = Sheet()
    sheet.cut(180.0)
    for _ in range(10):
        sheet.seen.update(SLICE_S, sheet.z_um - 60.0, Value(sheet.depth_um, 0.0), 1.0, sparking=False)
        assert sheet.cut(0.5, feed_um_s=4.0, opens=0.9) is None
        assert sheet.cut(3.0) is None


def test_open_pulses_behind_the_sheet_are_borne_as_long_as_the_completion_takes() -> None:
    plain, sheet = Shop(), Shop(SHEET)
    usual = controller_settings(plain.profile, plain.job.setup)
    borne = controller_settings(sheet.profile, sheet.job.setup)
    assert (usual.open_lost_um, usual.open_lost_s) == (plain.profile.limits.open_lost_um, OPEN_LOST_S)
    # The host takes up to one such way to see the breakthrough, and feeds on from there, with jumps.
    assert borne.open_lost_um >= 20.0 + 2.0 * usual.open_lost_um
    assert borne.open_lost_s >= 1.5 * borne.open_lost_um / sheet.profile.servo.forward_um_s + OPEN_LOST_S


def test_before_the_breakthrough_the_host_looks_for_lost_sparks() -> None:
    loss = SparkLoss(15.0, 3.0)
    assert loss.update(SLICE_S, 50.0, 230, 100) == ""
    for i in range(1, 30):
        assert loss.update(SLICE_S, 50.0 + 0.4 * i, 230, 230) == ""
    assert "without a discharge" in loss.update(1.0, 66.0, 230, 230)
    assert loss.update(SLICE_S, 66.0, 230, 229) == ""
