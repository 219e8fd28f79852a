"""The law of adaptive machining over made-up shares of pulses, and cuts of the virtual machine that follow it."""

from __future__ import annotations

import json

import pytest

import edmctl
from edmctl.planning.removal import REFERENCE_MARGIN
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.servo.adaptive import CLEAN_S, LONGEST_SHARE, PATIENCE, AdaptiveControl
from edmctl.profile.model import Profile
from edmctl.record.rows import RunEvent

from .conftest import CU270, Shop

ADAPTIVE = 'jump.mode="adaptive"'
SLICE_S = 0.1
PULSES = 230


@pytest.fixture
def profile() -> Profile:
    """Return cu270 with adaptive jumps: every 10 s down to every 1.5 s."""
    return load_profile(CU270, (ADAPTIVE, "jump.period_s=10", "jump.period_min_s=1.5")).profile


class Cut:
    """A cut without a machine: what the gap looks like is made up, jumps are counted."""

    def __init__(self, profile: Profile) -> None:
        self.law = AdaptiveControl(profile, 0.0)
        self.now_s = 0.0
        self.jumps_s: list[float] = []

    def spark(self, seconds: float, *, arcs: float = 0.0, shorts: float = 0.0) -> None:
        for _ in range(round(seconds / SLICE_S)):
            self.now_s += SLICE_S
            arc, short = round(PULSES * arcs), round(PULSES * shorts)
            self.law.update(SLICE_S, PULSES, arc, short, sparking=True)
            if self.law.due(self.now_s):
                self.jumps_s.append(self.now_s)
                self.law.update(SLICE_S, 0, 0, 0, sparking=False)
                self.law.jumped(self.now_s)

    def changes(self, code: RunEvent) -> int:
        return sum(change.code is code for change in self.law.changes)


def test_without_evidence_the_period_stays_and_decides_and_keeps_between_its_ends(profile: Profile) -> None:
    cut = Cut(profile)
    cut.spark(3.0 * CLEAN_S, arcs=0.035)
    assert cut.jumps_s[0] == pytest.approx(10.0, abs=0.15)
    assert cut.law.period_s == profile.jump.period_s
    burst = Cut(profile)  # shorter than the window
    for seconds, arcs in ((3.0, 0.0), (0.2, 0.2), (2.0, 0.0)):
        burst.spark(seconds, arcs=arcs)
    assert burst.jumps_s == []
    cut = Cut(profile)
    cut.spark(30.0, arcs=0.055)
    assert cut.law.period_s == profile.jump.period_min_s
    cut.spark(400.0)
    assert cut.law.period_s == LONGEST_SHARE * profile.jump.period_s


@pytest.mark.parametrize("share", ["arcs", "shorts"])
def test_a_second_over_a_threshold_halves_the_period_and_jumps_at_once(profile: Profile, share: str) -> None:
    cut = Cut(profile)
    cut.spark(3.0)
    cut.spark(0.8, **{share: 0.2})
    assert len(cut.jumps_s) == 1
    assert cut.law.period_s == 5.0
    (change,) = cut.law.changes
    assert change.code is RunEvent.JUMP_PERIOD
    assert (change.args["from_s"], change.args["to_s"]) == (10.0, 5.0)
    assert "arcs and" in change.message


def test_nothing_is_judged_during_a_jump_and_shortly_after(profile: Profile) -> None:
    law = AdaptiveControl(profile, 0.0)
    for _ in range(20):
        law.update(SLICE_S, PULSES, PULSES, 0, sparking=False)
    for _ in range(5):
        law.update(SLICE_S, PULSES, PULSES, 0, sparking=True)
    assert law.due(5.0) == ""
    assert law.changes == []


def test_only_where_jumps_do_not_help_the_gap_is_widened_and_then_the_pauses_grow(profile: Profile) -> None:
    cut = Cut(profile)
    cut.spark(6.0, arcs=0.2)
    assert cut.changes(RunEvent.REFERENCE_CHANGED) == 0
    cut.spark(200.0, arcs=0.2)
    codes = [change.code for change in cut.law.changes]
    raised = codes.index(RunEvent.REFERENCE_CHANGED)
    assert RunEvent.JUMP_PERIOD not in codes[raised:]
    assert sorted(codes[raised:]) == codes[raised:]
    assert cut.law.reference == profile.adaptive.reference_max
    assert cut.law.duty == pytest.approx(profile.adaptive.duty_min)


def test_in_a_clean_gap_the_remedies_are_taken_back_the_last_one_first(profile: Profile) -> None:
    cut = Cut(profile)
    cut.spark(60.0, arcs=0.2)
    assert 0 < cut.changes(RunEvent.REFERENCE_CHANGED) <= len(cut.jumps_s) / PATIENCE
    cut.spark(140.0, arcs=0.2)
    cut.law.changes.clear()
    cut.spark(1000.0)
    codes = list(dict.fromkeys(change.code for change in cut.law.changes))
    assert codes == [RunEvent.DUTY_CHANGED, RunEvent.REFERENCE_CHANGED, RunEvent.JUMP_PERIOD]
    assert (cut.law.reference, cut.law.duty) == (profile.servo.reference, profile.pulse.duty)


@pytest.mark.parametrize(
    ("overrides", "jumps_s"),
    [(('jump.mode="fixed"', "jump.period_s=10"), [10.0, 20.0]), (('jump.mode="off"',), [])],
)
def test_jumps_that_are_not_adaptive_do_not_heed_the_gap(
    overrides: tuple[str, ...], jumps_s: list[float]
) -> None:
    cut = Cut(load_profile(CU270, overrides).profile)
    cut.spark(20.5, arcs=0.5, shorts=0.3)
    assert cut.jumps_s == pytest.approx(jumps_s, abs=0.25)
    assert cut.law.changes == []


FEED_30 = ('target={kind="feed",feed_um=30.0}', ADAPTIVE, "pulse.current_a=0.12", "jump.height_um=30")


def test_a_badly_flushed_cut_jumps_more_often_and_says_why() -> None:
    clean, dirty = Shop(FEED_30), Shop(FEED_30)
    dirty.bench.plant.unit.flush_time_s *= 100.0
    clean.run_job()
    dirty.run_job()

    jumps = dirty.seen.args(RunEvent.JUMPED)
    assert len(jumps) > 3 * clean.seen.codes.count(RunEvent.JUMPED)
    limits = dirty.profile.adaptive
    asked = [args for args in jumps if args["asked"]]
    assert asked
    for args in asked:
        names = str(args["asked"]).split(" and ")
        assert all(
            float(args[f"asking_{name}"]) > {"arcs": limits.arc_high, "shorts": limits.short_high}[name]
            for name in names
        )
        assert "shorts" in args
        assert len(json.dumps(args, separators=(",", ":"))) <= 200
    shortest_s, clean_s = (min(row.jump_period_s for row in s.seen.slow) for s in (dirty, clean))
    assert shortest_s == dirty.profile.jump.period_min_s
    assert clean_s >= 2.0 * shortest_s
    told = dirty.seen.messages(RunEvent.JUMP_PERIOD)
    assert told[0].startswith("Jump period 10 → 5 s")
    assert "% arcs" in told[0]


def test_a_wider_gap_and_longer_pauses_reach_the_machine_in_the_middle_of_a_cut() -> None:
    # By these thresholds every gap is bad, and nothing helps.
    s = Shop((*FEED_30, "adaptive.arc_high=0.0011", "adaptive.arc_low=0.001", "adaptive.duty_min=0.2"))
    pulse_period = s.bench.controller.seen.pulse_period_ns
    result = s.run_job()
    codes = s.seen.codes
    assert RunEvent.REFERENCE_CHANGED in codes
    assert RunEvent.DUTY_CHANGED in codes
    assert codes.count(RunEvent.CUT_ENDED) == 1
    last = [
        row for row in s.seen.slow if row.gap_ratio_ref == pytest.approx(s.profile.adaptive.reference_max)
    ]
    assert sum(row.gap_ratio for row in last) / len(last) == pytest.approx(0.9, abs=0.03)
    site = result.sites[0]
    assert site.pulses < 0.9 * site.machining_time_s * s.profile.pulse.frequency_hz
    assert s.bench.controller.seen.pulse_period_ns == pulse_period


SEEKING = ("adaptive.seek_reference=true",)


@pytest.fixture
def seeking() -> Profile:
    """Return cu270 with an adaptive reference and no jumps."""
    return load_profile(CU270, ('jump.mode="off"', *SEEKING)).profile


@pytest.mark.parametrize(
    ("arcs", "shorts", "sign", "changes"), [(0.5, 0.0, -1.0, 5), (2.0, 0.0, 1.0, 5), (0.75, 0.25, 0.0, 0)]
)
def test_the_reference_follows_arcs_and_shorts_to_its_target(
    seeking: Profile, arcs: float, shorts: float, sign: float, changes: int
) -> None:
    cut, target = Cut(seeking), seeking.adaptive.arc_target
    assert target is not None
    cut.spark(20.0, arcs=arcs * target, shorts=shorts * target)
    assert sign * (cut.law.reference - seeking.servo.reference) >= 0.05 * abs(sign)
    assert cut.changes(RunEvent.REFERENCE_CHANGED) == changes
    assert all("% arcs and shorts" in change.message for change in cut.law.changes)


@pytest.mark.parametrize("arcs", [0.0, 1.0])
def test_the_reference_stays_between_all_sparking_and_all_open(seeking: Profile, arcs: float) -> None:
    cut = Cut(seeking)
    cut.spark(400.0, arcs=arcs)
    lowest = seeking.pulse.rho + REFERENCE_MARGIN
    assert cut.law.reference == pytest.approx(seeking.adaptive.reference_max if arcs else lowest, abs=1e-3)


def test_an_adaptive_reference_asks_for_jumps_well_above_its_target() -> None:
    cut = Cut(load_profile(CU270, (ADAPTIVE, *SEEKING)).profile)
    cut.spark(9.0, arcs=0.09)
    assert not cut.jumps_s
    cut.spark(1.2, arcs=0.25)
    assert len(cut.jumps_s) == 1


@pytest.mark.slow
@pytest.mark.parametrize("flush_s", [2.0, 0.5])
def test_a_hole_is_made_faster_with_an_adaptive_reference_whatever_the_flushing(flush_s: float) -> None:
    same = {
        **{"target.depth_um": 25, "sim.flush_time_s": flush_s, "jump.mode": "off", "log.pulses": "off"},
        **{"pulse.open_voltage_v": 60, "approach.max_travel_um": 150, "approach.speed_um_s": 3},
    }
    fixed, sought = (
        edmctl.connect("sim:", seed=4).machine("cu270", overrides={**same, **more})
        for more in ({"servo.reference": 0.88}, {"adaptive.seek_reference": True})
    )
    fixed.raise_for_error()
    sought.raise_for_error()
    assert sought.sites[0].machining_time_s < 0.8 * fixed.sites[0].machining_time_s
    assert sought.sites[0].ratios.arc + sought.sites[0].ratios.short == pytest.approx(0.085, abs=0.03)
