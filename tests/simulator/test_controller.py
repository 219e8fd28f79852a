"""The virtual controller as a board would behave: states, touches, limits, watchdog, faults, safe state."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.session import CommandRefused
from edmctl.simulator import BenchConfig

if TYPE_CHECKING:
    from edmctl.link.wire import Param
    from tests.simulator.conftest import Rig

RigMaker = Callable[..., "Rig"]
TOUCH = m.TouchOff(20.0, 40.0, 1.0, 90.0, 5.0, 0.3, 3)


def assert_safe(r: Rig) -> None:
    """Pulses off now, and the tool back at 0 V within a second."""
    assert r.bench.plant.drive.pulses_on == 0
    r.session.pump(1.0)
    assert r.bench.plant.drive.actuator_v == 0.0
    assert r.bench.controller.state is m.State.FAULT


def test_touches_find_the_surface_within_their_spread(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.to_pad()
    r.session.request(TOUCH)
    r.wait(m.EventCode.TOUCH_DONE, 120.0)
    touches = [e for e in r.events if e.code == m.EventCode.TOUCH]
    assert [e.arg for e in touches] == [1, 2, 3]
    found = np.mean([e.displacement_um for e in touches])
    plant = r.bench.plant
    expected = plant.state.surface_um * plant.unit.sensor_gain
    assert found == pytest.approx(expected, abs=0.6)
    assert np.std([e.displacement_um for e in touches]) < 0.5


def test_command_sinks_while_hunting_and_the_sensor_stays(rig: RigMaker) -> None:
    """Creep would push the tool into the work; hunting takes the voltage back (Muralidhara et al. 2009, Fig. 9a)."""
    r = rig()
    r.arm()
    r.to_pad()
    r.session.request(m.TlmStart(10_000, 10, m.PulseLog.OFF))
    r.session.request(m.TouchOff(20.0, 0.0, 20.0, 90.0, 5.0, 20.0, 1))
    r.wait(m.EventCode.TOUCH_DONE, 120.0)
    contact_v = next(e.actuator_v for e in r.events if e.code == m.EventCode.TOUCH)
    v, z = r.column("actuator_v"), r.column("displacement_um")
    first = int(np.argmax(v > contact_v - 0.2))
    hunting = slice(first + 100, first + 1900)
    assert contact_v - v[hunting][-200:].mean() > 0.2
    assert np.ptp(z[hunting].reshape(-1, 100).mean(axis=1)) < 0.3


def test_no_contact_where_expected_is_a_fault(rig: RigMaker) -> None:
    r = rig()
    r.arm()  # still at the parking place, beyond the edge of the work
    r.session.request(m.TouchOff(20.0, 40.0, 5.0, 60.0, 5.0, 0.3, 1))
    assert r.wait_fault(60.0).code == FaultCode.NO_CONTACT
    assert_safe(r)


def test_no_ramp_is_faster_than_the_slew_limit_either_way(rig: RigMaker) -> None:
    r = rig()
    r.arm({"slew_limit_v_s": 50.0})
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    for target_v in (60.0, 20.0):
        r.session.request(m.PiezoSet(target_v, 500.0))
        r.wait(m.EventCode.MOVE_DONE, 5.0)
    v = r.column("actuator_v")
    steps_v = v[20:] - v[:-20]  # over 20 ms: telemetry has steps of its own
    assert steps_v.max() == pytest.approx(1.0, abs=0.05)
    assert steps_v.min() == pytest.approx(-1.0, abs=0.05)


def test_a_ramp_into_the_work_is_a_collision(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.to_pad()
    r.session.request(m.PiezoSet(60.0, 30.0))
    assert r.wait_fault(10.0).code == FaultCode.COLLISION
    assert_safe(r)


def test_stages_stay_while_the_tool_is_down(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.session.request(m.PiezoSet(30.0, 100.0))
    r.wait(m.EventCode.MOVE_DONE, 5.0)
    with pytest.raises(CommandRefused):
        r.session.request(m.StageMove(m.Axis.X, 0, 1_000_000))


def test_an_approach_over_nothing_ends_as_no_spark(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.session.request(m.Approach(5.0, 40.0, 10.0))
    assert r.wait_fault(60.0).code == FaultCode.NO_SPARK
    assert_safe(r)


def test_stroke_used_up_is_a_travel_limit(rig: RigMaker) -> None:
    r = rig()
    r.arm({"piezo_max_v": 28.0})
    r.to_pad()
    r.start_sparking()
    assert r.wait_fault(600.0).code == FaultCode.TRAVEL_LIMIT
    assert_safe(r)


def test_a_silent_host_loses_its_sparks_after_the_watchdog(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.to_pad()
    r.start_sparking()
    r.session.pump(1.0)
    controller = r.bench.controller
    controller.host_heard()
    controller.advance(249)
    assert r.bench.plant.drive.pulses_on == 1
    controller.advance(1)
    assert r.bench.plant.drive.pulses_on == 0
    assert controller.fault == FaultCode.HOST_SILENT
    controller.advance(1000)
    assert r.bench.plant.drive.actuator_v == 0.0


def test_an_abort_run_stops_everything(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.to_pad()
    r.start_sparking()
    r.session.pump(0.5)
    r.session.abort()
    r.bench.transport.read(0.001)
    assert r.bench.plant.drive.pulses_on == 0
    assert r.bench.controller.fault == FaultCode.ABORT_RUN


def test_an_abort_run_that_ends_in_a_later_read_acts_before_the_frame_behind_it(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    controller = r.bench.controller
    controller.receive(bytes(5))
    hello = m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 77, m.SCHEMA_HASH)
    controller.receive(bytes(3) + encode_frame(m.Hello.ID, 0, 99, 0, hello.pack()))
    first, *_ = FrameDecoder(watch_for_abort=False).feed(controller.link.take_output())
    assert controller.fault == FaultCode.ABORT_RUN
    assert m.Fault.unpack(first.payload).code == FaultCode.ABORT_RUN


@pytest.mark.parametrize("what", ["level", "flow"])
def test_lost_dielectric_stops_the_sparks_within_a_slice(rig: RigMaker, what: str) -> None:
    r = rig()
    r.arm()
    r.to_pad()
    r.start_sparking()
    r.session.pump(0.5)
    if what == "level":
        r.bench.plant.dielectric_level_ok = False
    else:
        r.bench.plant.dielectric_flow_lpm = 0.1
    assert r.wait_fault(1.0).code == FaultCode.DIELECTRIC
    assert_safe(r)
    with pytest.raises(CommandRefused):
        r.session.request(m.ClearFault(FaultCode.DIELECTRIC))
    r.bench.plant.dielectric_level_ok, r.bench.plant.dielectric_flow_lpm = True, 1.0
    with pytest.raises(CommandRefused):
        r.session.request(m.ClearFault(FaultCode.ARC_BURN))
    r.session.request(m.ClearFault(FaultCode.DIELECTRIC))
    assert r.bench.controller.state is m.State.IDLE


def test_a_bridge_that_never_breaks_is_a_stuck_short(rig: RigMaker) -> None:
    r = rig()
    r.arm({"short_stuck_s": 1.0})
    r.to_pad()
    r.start_sparking()
    r.session.pump(0.5)
    r.bench.plant.unit.bridge_clear = 0.0
    r.bench.plant.state.bridge_until_um = 1e9
    assert r.wait_fault(5.0).code == FaultCode.SHORT_STUCK
    assert_safe(r)


def test_wrong_parameters_do_not_arm(rig: RigMaker) -> None:
    r = rig()
    with pytest.raises(CommandRefused):
        r.session.request(m.Arm(12345))
    with pytest.raises(CommandRefused):
        r.session.request(m.SetParam(1, 151_000))
    with pytest.raises(CommandRefused):
        r.session.request(m.PiezoSet(10.0, 10.0))


def test_what_this_controller_cannot_do_it_refuses(rig: RigMaker) -> None:
    r = rig()
    with pytest.raises(CommandRefused) as grid:
        r.session.request(m.SetParam(m.PARAMS["servo_period_us"].id, 1500))
    assert grid.value.status == m.Status.OUT_OF_RANGE
    with pytest.raises(CommandRefused) as rate:
        r.session.request(m.TlmStart(500, 10, m.PulseLog.OFF))
    assert rate.value.status == m.Status.RATE_TOO_HIGH
    r.session.request(m.PulseConfig(5.0, 15.0, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0))
    with pytest.raises(CommandRefused) as counts:
        r.session.request(m.TlmStart(10_000, 10, m.PulseLog.OFF))
    assert counts.value.status == m.Status.OUT_OF_RANGE


@pytest.mark.parametrize(
    "message",
    [
        m.Approach(0.0, 100.0, 0.0),
        m.PulseConfig(130.0, 300.0, 0.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0),
        m.PulseConfig(4e6, 200.0, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0),
        m.PulseConfig(130.0, 300.0, 40.0, 40.0, m.PulseMode.ISOFREQUENCY, 0.0),
        m.TouchOff(20.0, 40.0, 0.0, 90.0, 5.0, 0.3, 3),
        m.Jump(10.0, 0.0, 0.1, 1.0),
        m.StageMove(m.Axis.X, 0, 0),
        m.PiezoSet(120.1, 10.0),
    ],
)
def test_nonsense_is_out_of_range(rig: RigMaker, message: m.Approach) -> None:
    r = rig()
    r.arm()
    with pytest.raises(CommandRefused) as refused:
        r.session.request(message)
    assert refused.value.status == m.Status.OUT_OF_RANGE


def test_the_generator_is_not_rewired_in_a_cut(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.to_pad()
    r.start_sparking()
    r.session.pump(1.0)
    r.session.request(m.Jump(20.0, 500.0, 0.5, 2.0))
    assert r.bench.plant.drive.pulses_on == 0
    with pytest.raises(CommandRefused) as refused:
        r.session.request(m.PulseConfig(130.0, 300.0, 100.0, 3.0, m.PulseMode.ISOFREQUENCY, 0.0))
    assert refused.value.status == m.Status.BAD_STATE


@pytest.mark.parametrize("param", m.PARAMS.values(), ids=m.PARAMS)
def test_every_parameter_takes_its_extremes_and_nothing_beyond(rig: RigMaker, param: Param) -> None:
    r = rig()
    # This controller decides once a millisecond at most; a board may be faster.
    least = 1000 if param.name == "servo_period_us" else param.minimum
    for value in (least, param.maximum):
        r.session.request(m.SetParam(param.id, param.to_wire(value)))
        r.session.request(m.CommitProfile(m.param_crc({param.name: value})))
        assert r.session.request(m.GetParam(param.id)).value == param.to_wire(value)
        r.session.request(m.SetParam(param.id, param.to_wire(param.default)))
    for beyond in (param.to_wire(param.minimum) - 1, param.to_wire(param.maximum) + 1):
        with pytest.raises(CommandRefused):
            r.session.request(m.SetParam(param.id, beyond))


def test_a_disarmed_stage_stops_where_it_is_and_says_so(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.session.request(m.StageMove(m.Axis.X, 0, 1_000_000))
    r.session.pump(2.0)
    r.session.request(m.Disarm())
    r.session.pump(0.5)
    x_um = r.session.request(m.GetStatus()).x_um
    assert x_um == pytest.approx(-3000.0, abs=20.0)
    assert r.bench.plant.position_um[0] == pytest.approx(x_um, abs=3.0)


def test_a_cut_ends_at_its_depth_limit_with_the_hole_in_the_work(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.to_pad()
    r.session.request(m.TlmStart(10_000, 10, m.PulseLog.FULL))
    r.start_sparking(z_limit_um=60.0)
    end = r.wait(m.EventCode.CUT_DONE, 300.0)
    assert end.displacement_um == pytest.approx(60.0, abs=0.8)
    (hole,) = r.bench.truth()
    plant = r.bench.plant
    gap = plant.state.surface_um + hole.depth_um + r.bench.tool_wear_um - plant.state.true_z_um
    assert 2.0 < gap < 5.0
    assert r.bench.tool_wear_um / hole.depth_um == pytest.approx(0.389, abs=0.03)


def test_every_pulse_is_accounted_for_in_either_log(rig: RigMaker) -> None:
    for log in (m.PulseLog.FULL, m.PulseLog.BLOCKS):
        r = rig()
        r.arm()
        r.to_pad()
        r.session.request(m.TlmStart(10_000, 10, log))
        r.start_sparking(max_time_s=2.0)
        r.wait(m.EventCode.TIME_UP, 10.0)
        r.session.request(m.TlmStop())
        struck = int(r.bench.controller.loop.pulse_no)
        sampled = sum(r.column(f"n_{c}").sum() for c in ("open", "normal", "arc", "short"))
        if log is m.PulseLog.FULL:
            logged = sum(p.n for p in r.pulses)
        else:
            data = np.frombuffer(b"".join(b.records for b in r.blocks), m.PulseBlocks.record_dtype())
            logged = int(sum(data[f"n_{c}"].astype(int).sum() for c in ("open", "normal", "arc", "short")))
        assert logged == struck
        assert struck - 3 <= sampled <= struck


def test_same_seed_same_bytes_whatever_the_slices(rig: RigMaker) -> None:
    def run(slice_s: float) -> bytes:
        r = rig(BenchConfig(), seed=11)
        r.arm()
        r.to_pad()
        r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
        r.start_sparking(max_time_s=3.0)
        for _ in range(round(3.2 / slice_s)):
            r.session.pump(slice_s)
        return b"".join(t.records for t in r.samples)[: 16 * 2500]

    assert run(0.1) == run(0.037)


def test_isopulse_discharges_last_as_set(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.session.request(m.PulseConfig(130.435, 304.348, 40.0, 0.12, m.PulseMode.ISOPULSE, 20.0))
    r.to_pad()
    r.session.request(m.TlmStart(10_000, 10, m.PulseLog.FULL))
    r.start_sparking(max_time_s=2.0)
    r.wait(m.EventCode.TIME_UP, 10.0)
    data = np.frombuffer(b"".join(p.records for p in r.pulses), m.Pulses.record_dtype())
    normal = data[data["pulse_class"] == m.PulseClass.NORMAL]
    assert normal["discharge_us"].max() == 200
    assert np.median(normal["discharge_us"]) == 200
