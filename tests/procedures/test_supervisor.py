"""The judgement of a cut over made-up samples."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from edmctl.actuator.correction import SlowCorrection
from edmctl.machine.interface import MachineState, TelemetryBlock
from edmctl.procedures.displacement_estimate import Tracker, at_rest
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart, energy_of, first_plan
from edmctl.procedures.servo.supervisor import StopReason, Supervisor
from edmctl.record.rows import RunEvent

from .conftest import Shop, calibrated, samples


def a_slice(
    index: int, z_um: float, *, arc: int = 0, short: int = 0, state: MachineState = MachineState.MACHINING
) -> TelemetryBlock:
    """Ten samples at 100 Hz; each has 23 pulses, of which `arc` and `short` are not normal."""
    return samples(0.1 * index, z_um, counts=(0, 23 - arc - short, arc, short), state=state)


def planned(s: Shop) -> CutPlan:
    return first_plan(s.profile, CutStart(50.0, 0.5, s.profile.measure.expected_gap_um, 0.8))


DEEP = ('target={kind="depth",depth_um=150.0,tolerance_um=2.0}',)
"""A hole so deep that no sample here passes its end."""


def watched(overrides: tuple[str, ...] = ()) -> tuple[Shop, Supervisor]:
    s = Shop(overrides)
    return s, Supervisor(s.run(), planned(s), 0.0)


def test_feed_and_time_left_follow_the_tool() -> None:
    s, supervisor = watched()
    for i in range(200):
        supervisor.on_telemetry(a_slice(i, 46.6 + 0.03 * i))
    assert np.isnan(s.seen.slow[90].feed_um_s)
    assert s.seen.slow[-1].feed_um_s == pytest.approx(0.3)
    energy = energy_of(s.profile.pulse, supervisor)
    there = planned(s).at(46.6 + 0.03 * 199, energy)
    assert there.depth_um > 0.03 * 199 / 1.389
    assert s.seen.slow[-1].depth_um == pytest.approx(there.depth_um, rel=1e-6)
    assert s.seen.slow[-1].wear_um == pytest.approx(there.wear_um, rel=1e-6)
    ratio = planned(s).estimate.wear_ratio
    assert s.told.states[-1].time_left_s == pytest.approx((12.0 - there.depth_um) * (1.0 + ratio) / 0.3)


def test_the_wear_told_while_cutting_is_as_uncertain_as_at_the_stop_before() -> None:
    s = Shop()
    measured = CutStart(50.0, 0.5, s.profile.measure.expected_gap_um, 0.8, 6.0, 2.0, wear_u_um=1.4)
    supervisor = Supervisor(s.run(), replace(planned(s), number=2, start=measured), 0.0)
    for i in range(50):
        supervisor.on_telemetry(a_slice(i, 46.6 + 0.03 * i))
    assert s.told.states[-1].wear_u95_um >= 2.8 * 0.98
    assert s.seen.slow[-1].wear_u95_um == s.told.states[-1].wear_u95_um


def test_a_late_block_tells_the_last_spark_by_its_last_samples() -> None:
    """A host that was held up for a second finds a fast feed and the end of the cut in one block."""
    _, supervisor = watched()
    late = [a_slice(i, 46.6 + 0.5 * i) for i in range(9)]
    late.append(a_slice(9, 40.0, state=MachineState.ARMED))
    names = [f.name for f in fields(TelemetryBlock) if f.name != "missing_frames"]
    joined = {name: np.concatenate([getattr(block, name) for block in late]) for name in names}
    supervisor.on_telemetry(replace(late[0], **joined))  # type: ignore[arg-type]
    assert supervisor.sparked_at_um == pytest.approx(46.6 + 0.5 * 8)


def test_ratios_cover_the_last_two_seconds() -> None:
    s, supervisor = watched()
    for i in range(30):
        supervisor.on_telemetry(a_slice(i, 50.0, short=23))
    for i in range(30, 50):
        supervisor.on_telemetry(a_slice(i, 50.0))
    assert s.seen.slow[29].ratio_short == 1.0
    assert s.seen.slow[-1].ratio_short == 0.0
    assert supervisor.counts == (0, 20 * 230, 0, 30 * 230)


def test_a_tool_that_stands_is_answered_by_one_jump_and_is_stalled_after_a_minute() -> None:
    (_, supervisor), (_, slow) = watched(), watched(DEEP)
    asked_s = []
    for i in range(620):
        assert (supervisor.stop_reason is None) or i > 600
        supervisor.on_telemetry(a_slice(i, 60.0))
        due = supervisor.jump_due(0.1 * i)
        if due is not None and due[0] is RunEvent.STALL_JUMP:
            asked_s.append(0.1 * i)
            supervisor.jumped(RunEvent.STALL_JUMP, 0.1 * i)
    assert asked_s == [pytest.approx(30.0, abs=0.3)]
    assert supervisor.stop_reason is StopReason.STALLED
    for i in range(1500):
        slow.on_telemetry(a_slice(i, 60.0 + 0.02 * i))
    assert slow.stop_reason is None


@pytest.mark.parametrize("arcs_s", [10.0, 34.0])
def test_arcs_over_the_limit_are_reported_once_and_end_the_cut_if_they_stay(arcs_s: float) -> None:
    s, supervisor = watched(DEEP)
    for i in range(600):
        assert supervisor.stop_reason is None or i > 300
        supervisor.on_telemetry(a_slice(i, 50.0 + 0.05 * i, arc=5 if 0.1 * i < arcs_s else 0))
    assert supervisor.stop_reason is (StopReason.UNSTABLE if arcs_s > 30.0 else None)
    (warning,) = s.seen.messages(RunEvent.ARCING)
    assert "limit is 15 %" in warning


def test_a_cut_that_goes_on_beyond_its_target_is_ended() -> None:
    s, supervisor = watched()

    def depth_um(z_um: float) -> float:
        return planned(s).at(z_um, energy_of(s.profile.pulse, supervisor)).depth_um

    for i in range(200):
        z_um = 50.0 + 0.2 * i
        supervisor.on_telemetry(a_slice(i, z_um))
        # 3 µm more than the 12 µm wanted.
        assert (supervisor.stop_reason is StopReason.ENDED) == (depth_um(z_um) > 15.0)
        if supervisor.stop_reason is not None:
            break
    assert "of 12.0 µm" in supervisor.message


def test_a_cut_whose_stroke_is_used_up_is_ended_with_the_way_that_is_left() -> None:
    s = Shop(('target={kind="depth",depth_um=150.0,tolerance_um=2.0}',), calibration=calibrated())
    run = s.run()
    run.watch.estimate_with(Tracker(at_rest(calibrated().model, 0.0), SlowCorrection(), 0.5))
    supervisor = Supervisor(run, planned(s), 0.0)
    limit_v = s.profile.limits.stroke_v_max
    for i, actuator_v in enumerate((limit_v - 5.0, limit_v - 2.5, limit_v - 0.5)):
        assert supervisor.stop_reason is None
        block = replace(a_slice(i, 60.0), actuator_v=np.full(10, actuator_v))
        run.watch.telemetry(block)
        supervisor.on_telemetry(block)
    assert supervisor.stop_reason is StopReason.ENDED
    assert f"of {limit_v:.0f} V" in supervisor.message


def test_frames_missing_on_the_line_are_counted() -> None:
    s, _ = watched()
    run = s.run()
    supervisor = Supervisor(run, planned(s), 0.0)
    for i, missing in enumerate((0, 2, 0, 3)):
        block = replace(a_slice(i, 50.0), missing_frames=missing)
        run.watch.telemetry(block)
        supervisor.on_telemetry(block)
    assert [row.link_errors for row in s.seen.slow] == [0, 2, 2, 5]


def test_jumps_do_not_count_as_feed_or_gap() -> None:
    s, supervisor = watched()
    for i in range(200):
        jumping = 140 <= i < 143
        state = MachineState.JUMP if jumping else MachineState.MACHINING
        supervisor.on_telemetry(a_slice(i, 20.0 if jumping else 60.0 + 0.03 * i, state=state))
    assert s.seen.slow[141].feed_um_s == pytest.approx(0.3)
    assert supervisor.gap_ratio_mean == pytest.approx(0.8)
