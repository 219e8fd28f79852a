"""What the virtual controller tells and tests: schema, black box, self test, rates, restarts, stage stop."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from contextlib import suppress
from random import Random
from typing import TYPE_CHECKING

import pytest

from edmctl.core.library import BOX_TICKS
from edmctl.errors import LinkLost
from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.session import CommandRefused, Session
from edmctl.simulator import BenchConfig
from edmctl.simulator.injection import parse_injection
from tools.generate.schema import load_schema

if TYPE_CHECKING:
    from edmctl.link.wire import Message, Request
    from tests.simulator.conftest import Rig

RigMaker = Callable[..., "Rig"]
NEAR = BenchConfig(offset_um=20.0)
REBOOT = m.Reboot(0x0B007EDB)


def black_box(r: Rig) -> tuple[bytes, int]:
    """Every record, and the time of the first."""
    records, t0_us, total = b"", -1, 1
    while len(records) < 16 * total:
        part = r.session.request(m.BlackboxRead(len(records) // 16))
        total, t0_us = part.total, part.t0_us if t0_us < 0 else t0_us
        records += part.records
    assert r.session.request(m.BlackboxRead(total)).n == 0
    return records, t0_us


def reboot(r: Rig) -> None:
    """Restart the controller, which the session notices, and open another session on it."""
    with suppress(LinkLost):
        r.session.request(REBOOT)
    with pytest.raises(LinkLost, match="restarted"):
        r.session.pump(0.1)
    r.session = Session(r.bench.transport, Random(r.bench.controller.boot_count))
    r.session.subscribe(m.Tlm, r.samples.append)
    r.session.open()


def refusal(r: Rig, message: Request[Message]) -> int:
    with pytest.raises(CommandRefused) as refused:
        r.session.request(message)
    return refused.value.status


def test_the_schema_comes_in_parts(rig: RigMaker) -> None:
    r = rig()
    data, total = b"", 1
    while len(data) < total:
        part = r.session.request(m.GetSchema(len(data)))
        total, data = part.total, data + part.records
    assert zlib.decompress(data).decode() == load_schema().canonical_json()
    assert r.session.request(m.GetSchema(total + 5)).n == 0


@pytest.mark.parametrize("gain", [0.5, 1.5], ids=["lags", "leads"])
def test_an_actuator_away_from_its_command_is_a_fault_whichever_way(rig: RigMaker, gain: float) -> None:
    r = rig()
    r.bench.plant.unit.monitor_gain = gain
    r.arm()
    r.session.request(m.PiezoSet(60.0, 100.0))
    assert r.wait_fault(2.0).code == FaultCode.PIEZO_TRACK


def test_the_black_box_is_the_telemetry_up_to_the_fault(rig: RigMaker) -> None:
    r = rig(NEAR)
    r.arm()
    r.to_pad()
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    r.start_sparking()
    r.session.pump(2.5)
    r.session.request(m.Jump(20.0, 500.0, 0.1, 2.0))
    r.session.pump(0.5)
    r.bench.inject(parse_injection("AMPLIFIER_DEAD@0"))
    fault = r.wait_fault(5.0)
    r.session.pump(1.0)
    records, t0_us = black_box(r)
    assert len(records) == 16 * BOX_TICKS
    told = b"".join(t.records for t in r.samples)
    begin = (t0_us - r.samples[0].t0_us) // 1000 * 16
    assert told[begin : begin + len(records)] == records
    assert t0_us + (BOX_TICKS - 1) * 1000 == fault.t_us
    r.bench.clear_injections()
    r.session.request(m.ClearFault(fault.code))
    r.session.pump(0.1)
    assert black_box(r)[1] > t0_us


def test_a_young_controller_has_a_short_black_box(rig: RigMaker) -> None:
    r = rig()
    r.session.pump(0.1)
    total = r.session.request(m.BlackboxRead(0)).total
    assert total == r.bench.controller.tick
    assert total < BOX_TICKS
    assert r.session.request(m.BlackboxRead(total - 3)).n == 3


def test_a_reboot_ends_the_session_and_clears_no_fault(rig: RigMaker) -> None:
    r = rig()
    controller = r.bench.controller
    r.arm({"watchdog_s": 0.5})
    assert refusal(r, REBOOT) == m.Status.BAD_STATE
    r.session.abort()
    r.session.pump(1.0)
    assert refusal(r, m.Reboot(1)) == m.Status.OUT_OF_RANGE
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    reboot(r)
    assert (r.session.hello.boot_count, r.session.hello.reset_cause) == (2, m.ResetCause.COMMANDED)
    assert (controller.state, controller.fault) == (m.State.FAULT, FaultCode.ABORT_RUN)
    assert controller.seen.param_crc == m.param_crc({})
    assert r.bench.controller.seen.tlm_next == -1
    assert (r.session.hello.boot_count, r.session.hello.fault) == (2, FaultCode.ABORT_RUN)
    r.session.request(m.ClearFault(FaultCode.ABORT_RUN))
    reboot(r)
    assert (controller.state, controller.fault) == (m.State.IDLE, 0)
    assert controller.time_us < 200_000


def test_telemetry_after_a_reset_counts_from_the_start(rig: RigMaker) -> None:
    r = rig()
    r.session.pump(0.333)
    reboot(r)
    r.session.request(m.TlmStart(10_000, 2, m.PulseLog.OFF))
    r.session.pump(0.1)
    assert r.samples[0].t0_us % 10_000 == 0
    assert r.samples[0].t0_us < 200_000


def test_a_sound_gap_sensor_passes_the_test(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.session.request(m.SelfTest())
    event = r.wait(m.EventCode.TEST_DONE, 1.0)
    assert event.arg == pytest.approx(12_000, abs=60)
    assert r.bench.controller.state is m.State.ARMED
    assert r.bench.plant.drive.pulses_on == 0


@pytest.mark.parametrize("stuck", ["GAP_SENSOR_HIGH", "GAP_SENSOR_LOW"])
def test_a_stuck_gap_sensor_fails_the_test(rig: RigMaker, stuck: str) -> None:
    r = rig()
    r.bench.inject(parse_injection(f"{stuck}@0"))
    r.arm()
    r.session.request(m.SelfTest())
    assert r.wait_fault(1.0).code == FaultCode.GAP_SENSOR
    assert r.bench.plant.drive.pulses_on == 0


def test_a_gap_voltage_at_closed_contact_is_seen_in_a_touch(rig: RigMaker) -> None:
    r = rig(NEAR)
    r.arm()
    r.to_pad()
    r.bench.inject(parse_injection("GAP_SENSOR_HIGH@touch+0"))
    r.session.request(m.TouchOff(20.0, 10.0, 5.0, 90.0, 5.0, 0.1, 1))
    assert r.wait_fault(60.0).code == FaultCode.GAP_SENSOR


def test_the_test_wants_a_retracted_tool_and_permitted_pulses(rig: RigMaker) -> None:
    r = rig()
    assert refusal(r, m.SelfTest()) == m.Status.BAD_STATE
    r.arm()
    r.session.request(m.PulseEnable(0))
    assert refusal(r, m.SelfTest()) == m.Status.BAD_STATE
    r.session.request(m.PulseEnable(1))
    r.session.request(m.PiezoSet(20.0, 100.0))
    r.wait(m.EventCode.MOVE_DONE, 5.0)
    assert refusal(r, m.SelfTest()) == m.Status.BAD_STATE


def test_a_rate_that_the_line_cannot_carry_is_refused(rig: RigMaker) -> None:
    r = rig()
    fast, slow = m.TlmStart(1000, 14, m.PulseLog.OFF), m.TlmStart(2000, 14, m.PulseLog.OFF)
    everything = m.TlmStart(1000, 14, m.PulseLog.FULL)
    for baud, refused in ((115_200, fast), (230_400, everything), (57_600, slow)):
        r.bench.controller.baud = baud
        assert refusal(r, refused) == m.Status.RATE_TOO_HIGH
    for baud, granted in ((115_200, slow), (230_400, fast), (921_600, everything), (0, everything)):
        r.bench.controller.baud = baud
        r.session.request(granted)


def test_a_new_session_gets_no_telemetry_of_the_former_one(rig: RigMaker) -> None:
    r = rig()
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.BLOCKS))
    r.session.pump(0.1)
    r.session.open()
    r.samples.clear()
    r.session.pump(0.2)
    assert r.samples == []


def test_a_stage_stops_where_it_is(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    assert refusal(r, m.StageStop()) == m.Status.BAD_STATE
    r.session.request(m.StageMove(m.Axis.X, 0, 1_000_000))
    r.session.pump(2.0)
    r.session.request(m.StageStop())
    r.session.pump(0.1)
    assert r.events[-1].code == m.EventCode.STOPPED
    assert r.session.request(m.GetStatus()).x_um == pytest.approx(-3000.0, abs=20.0)
    assert r.bench.controller.state is m.State.ARMED


def test_status_has_the_voltage_monitor_and_the_flags(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    r.session.request(m.PiezoSet(30.0, 100.0))
    r.wait(m.EventCode.MOVE_DONE, 5.0)
    r.session.pump(0.1)
    status = r.session.request(m.GetStatus())
    assert status.monitor_v == pytest.approx(30.0, abs=0.02)
    assert status.flags & m.TlmFlags.PULSES_ON == 0


def test_what_watches_the_host_goes_by_the_hosts_clock(rig: RigMaker) -> None:
    r = rig()
    r.arm()
    controller = r.bench.controller
    controller.host_time_scale = 10.0
    controller.host_heard()
    controller.advance(2499)
    assert controller.fault == 0
    controller.advance(1)
    assert controller.fault == FaultCode.HOST_SILENT
