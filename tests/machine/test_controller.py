"""The machine over a link: settings go down, motions end, refusals and faults come up as errors."""

from __future__ import annotations

import signal
from dataclasses import fields, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.errors import Interrupted, LinkLost, MachineFault, PreconditionError
from edmctl.link.link_errors import CommandRefused
from edmctl.link.messages import PARAMS, PROTO_MAJOR, PROTO_MINOR, GetParam
from edmctl.machine.interface import (
    Axis,
    ControllerSettings,
    EventCode,
    JumpRequest,
    MachineState,
    PulseLog,
    TelemetryBlock,
    TelemetryFlag,
    TouchRequest,
)

from .conftest import PULSES, SETTINGS, TELEMETRY, Heard

if TYPE_CHECKING:
    from .conftest import MakeRig


MONITORS = {
    "monitor_min_v",
    "monitor_max_v",
    "track_error",
    "track_s",
    "misread_pulses",
    "over_current",
    "bad_frames",
    "test_error",
}


def test_the_settings_name_every_parameter_but_those_of_the_monitors() -> None:
    """No recipe and no setup changes what the controller's monitors judge by."""
    assert {field.name for field in fields(ControllerSettings)} == set(PARAMS) - MONITORS


def test_configure_uploads_every_value(rig: MakeRig) -> None:
    r = rig()
    r.machine.configure(replace(SETTINGS, forward_um_s=7.25, piezo_max_v=111.0), PULSES)
    for name, value in (
        ("forward_um_s", 7.25),
        ("piezo_max_v", 111.0),
        ("dielectric_required", 1.0),
        ("track_s", PARAMS["track_s"].default),
    ):
        reply = r.session.request(GetParam(PARAMS[name].id))
        assert PARAMS[name].from_wire(reply.value) == value


def test_a_ramp_ends_at_its_voltage_and_its_samples_are_in_order(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.ramp(12.5, 50.0)
    r.machine.rest(0.3)
    assert r.machine.status().actuator_v == pytest.approx(12.5, abs=0.0025)
    times = np.concatenate([block.time_s for block in r.heard.blocks])
    assert np.allclose(np.diff(times), 0.01, atol=1e-9)
    assert r.heard.blocks[-1].actuator_v[-1] == pytest.approx(12.5, abs=0.0025)
    assert sum(block.missing_frames for block in r.heard.blocks) == 0


def test_a_stage_move_with_the_tool_down_is_refused(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.ramp(40.0, 100.0)
    with pytest.raises(PreconditionError):
        r.machine.move_stage(Axis.X, -4000.0, 1000.0)
    assert r.machine.status().x_um == -5000.0


def test_arming_without_dielectric_is_a_precondition(rig: MakeRig) -> None:
    r = rig()
    r.machine.configure(SETTINGS, PULSES)
    r.bench.plant.dielectric_level_ok = False
    with pytest.raises(PreconditionError):
        r.machine.arm()


def test_touches_find_the_surface_and_leave_the_tool_above_it(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.move_stage(Axis.X, 0.0, 5000.0)
    touches = r.machine.touch(TouchRequest(20.0, 40.0, 2.0, 80.0, 5.0, 0.1, 3))
    assert len(touches) == 3
    assert np.ptp([touch.displacement_um for touch in touches]) < 1.0
    assert touches[0].displacement_um == pytest.approx(50.0, abs=4.0)
    assert r.machine.status().displacement_um < touches[0].displacement_um - 2.0


def test_no_contact_where_it_was_expected_is_a_fault_with_its_remedy(rig: MakeRig) -> None:
    r = rig().ready()
    with pytest.raises(MachineFault) as caught:
        r.machine.touch(TouchRequest(20.0, 10.0, 5.0, 15.0, 5.0, 0.1, 1))
    assert caught.value.fault == 2005
    assert caught.value.code == "E62005"
    assert "µm" in caught.value.message
    assert "continuity wire" in caught.value.hint


def test_a_cut_ends_at_its_limit(rig: MakeRig) -> None:
    r = rig().ready().sparking(z_limit_um=50.0)
    ended = None
    while ended is None:
        ended = r.machine.watch_cut(0.1)
    assert ended.code is EventCode.CUT_DONE
    assert ended.displacement_um == pytest.approx(50.0, abs=0.8)
    assert r.machine.status().state is MachineState.ARMED


def test_a_cut_without_time_reports_time_up(rig: MakeRig) -> None:
    r = rig().ready().sparking(max_time_s=1.0)
    ended = None
    while ended is None:
        ended = r.machine.watch_cut(0.1)
    assert ended.code is EventCode.TIME_UP


def test_a_cut_can_be_stopped(rig: MakeRig) -> None:
    r = rig().ready().sparking()
    assert r.machine.watch_cut(0.5) is None
    assert r.machine.stop_cut().code is EventCode.STOPPED
    assert r.machine.status().state is MachineState.ARMED


def test_a_jump_lifts_the_tool_and_the_cut_goes_on(rig: MakeRig) -> None:
    r = rig().ready().sparking()
    for _ in range(10):
        assert r.machine.watch_cut(0.1) is None
    before_um = r.machine.status().displacement_um
    r.machine.jump(JumpRequest(height_um=30.0, speed_um_s=2000.0, dwell_s=0.05, clearance_um=5.0))
    assert r.machine.watch_cut(0.5) is None
    z = np.concatenate([block.displacement_um for block in r.heard.blocks[-15:]])
    assert z.min() < before_um - 12.0
    assert r.machine.status().state is MachineState.MACHINING


def test_pulse_sums_arrive_with_every_pulse_counted_once(rig: MakeRig) -> None:
    r = rig().ready().sparking(max_time_s=2.0)
    while r.machine.watch_cut(0.1) is None:
        pass
    r.machine.disarm()
    r.machine.stop_telemetry()
    sums = sum(
        int(batch.n_open.sum())
        + int(batch.n_normal.sum())
        + int(batch.n_arc.sum())
        + int(batch.n_short.sum())
        for batch in r.heard.sums
    )
    samples = sum(
        int(block.n_open.sum())
        + int(block.n_normal.sum())
        + int(block.n_arc.sum())
        + int(block.n_short.sum())
        for block in r.heard.blocks
    )
    assert sums == samples > 2.0 * 2300


def test_full_pulses_arrive_as_trains_without_a_gap(rig: MakeRig) -> None:
    r = rig().ready(PulseLog.FULL).sparking(max_time_s=1.0)
    while r.machine.watch_cut(0.1) is None:
        pass
    r.machine.stop_telemetry()
    number = r.heard.trains[0].first_pulse
    for train in r.heard.trains:
        assert train.first_pulse == number
        number += len(train.pulse_class)
    assert r.heard.trains[0].period_s == pytest.approx(1 / 2300, rel=1e-3)
    assert max(float(train.plateau_v.max()) for train in r.heard.trains) == pytest.approx(40.0)


def test_a_stop_request_ends_a_wait_within_one_slice(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.rest(0.1)
    before_s = r.bench.transport.now_s()
    r.stop.request(signal.SIGTERM)
    with pytest.raises(Interrupted) as caught:
        r.machine.rest(60.0)
    assert r.bench.transport.now_s() - before_s <= r.machine.slice_s + 0.01
    assert caught.value.signal_number == signal.SIGTERM


def test_a_safe_stop_from_a_cut_puts_pulses_off_and_the_tool_up(rig: MakeRig) -> None:
    r = rig().ready().sparking()
    r.machine.watch_cut(1.0)
    r.stop.request(signal.SIGINT)
    r.machine.safe_stop()
    status = r.machine.status()
    assert (status.state, status.actuator_v) == (MachineState.IDLE, 0.0)
    assert not r.heard.blocks[-1].flags[-1] & TelemetryFlag.PULSES_ON


def test_a_safe_stop_after_a_fault_waits_until_the_tool_is_up(rig: MakeRig) -> None:
    r = rig().ready().sparking()
    r.machine.watch_cut(1.0)
    r.bench.plant.estop = True
    with pytest.raises(MachineFault) as caught:
        r.machine.rest(1.0)
    assert caught.value.fault == 4001
    r.machine.safe_stop()
    assert r.machine.status().actuator_v == 0.0


def test_a_safe_stop_on_a_dead_line_raises_nothing(rig: MakeRig) -> None:
    r = rig().ready()
    r.bench.transport.close()
    with pytest.raises(LinkLost):
        r.machine.rest(1.0)
    r.machine.safe_stop()


def test_a_latched_fault_must_be_cleared_before_a_new_job(rig: MakeRig) -> None:
    r = rig().ready()
    r.session.abort()
    with pytest.raises(MachineFault):
        r.machine.rest(1.0)
    with pytest.raises(PreconditionError) as caught:
        r.machine.configure(SETTINGS, PULSES)
    assert "1002" in caught.value.message
    assert "Nothing is wrong with the machine" in caught.value.hint
    assert "`edmctl reset --ack 1002`" in caught.value.hint


def test_an_error_of_a_listener_surfaces_in_the_wait(rig: MakeRig) -> None:
    class FullDisk(Exception):
        pass

    r = rig()
    r.machine.configure(SETTINGS, PULSES)

    class Broken(Heard):
        def telemetry(self, block: TelemetryBlock) -> None:
            raise FullDisk

    r.machine.start_telemetry(TELEMETRY, Broken())
    with pytest.raises(FullDisk):
        r.machine.rest(0.5)
    assert r.machine.status().state is MachineState.IDLE


def test_the_identity_says_that_the_machine_is_virtual(rig: MakeRig) -> None:
    identity = rig().machine.identity
    assert identity.simulated
    assert identity.transport == "sim:"
    assert identity.protocol == f"{PROTO_MAJOR}.{PROTO_MINOR}"


def test_stages_move_by_the_zero_of_a_sensor_that_has_drifted(rig: MakeRig) -> None:
    r = rig().ready()
    r.bench.plant.state.walk_um += 40.0
    r.machine.rest(1.0)
    with pytest.raises(CommandRefused, match="INTERLOCK"):
        r.machine.move_stage(Axis.X, -4000.0, 5000.0)
    with pytest.raises(CommandRefused, match="SET_ZERO: OUT_OF_RANGE"):
        r.machine.set_zero(0.0)
    r.machine.set_zero(r.machine.status().displacement_um)
    r.machine.move_stage(Axis.X, -4000.0, 5000.0)
    assert r.machine.status().x_um == pytest.approx(-4000.0)
