"""What the virtual controller tells and tests: schema, black box, self test, rates, restarts, stage stop."""

from __future__ import annotations

import pytest

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.session import CommandRefused
from edmctl.link.wire import Message, Request
from edmctl.simulator import BenchConfig
from edmctl.simulator.injection import parse_injection
from tests.simulator.conftest import Rig, RigMaker

NEAR = BenchConfig(offset_um=20.0)


def refusal(r: Rig, message: Request[Message]) -> int:
    with pytest.raises(CommandRefused) as refused:
        r.session.request(message)
    return refused.value.status


@pytest.mark.parametrize("gain", [0.5, 1.5], ids=["lags", "leads"])
def test_an_actuator_away_from_its_command_is_a_fault_whichever_way(rig: RigMaker, gain: float) -> None:
    r = rig()
    r.bench.plant.unit.monitor_gain = gain
    r.arm()
    r.session.request(m.PiezoSet(60.0, 100.0))
    assert r.wait_fault(2.0).code == FaultCode.PIEZO_TRACK


def test_a_gap_voltage_at_closed_contact_is_seen_in_a_touch(rig: RigMaker) -> None:
    r = rig(NEAR).arm().to_pad()
    r.bench.inject(parse_injection("GAP_SENSOR_HIGH@touch+0"))
    r.session.request(m.TouchOff(20.0, 10.0, 5.0, 90.0, 5.0, 0.1, 1))
    assert r.wait_fault(60.0).code == FaultCode.GAP_SENSOR


def test_a_stage_stops_where_it_is(rig: RigMaker) -> None:
    r = rig().arm()
    assert refusal(r, m.StageStop()) == m.Status.BAD_STATE
    r.session.request(m.StageMove(m.Axis.X, 0, 1_000_000))
    r.session.pump(2.0)
    r.session.request(m.StageStop())
    r.session.pump(0.1)
    assert r.events[-1].code == m.EventCode.STOPPED
    assert r.session.request(m.GetStatus()).x_um == pytest.approx(-3000.0, abs=20.0)
    assert r.bench.controller.state is m.State.ARMED


def test_what_watches_the_host_goes_by_the_hosts_clock(rig: RigMaker) -> None:
    r = rig().arm()
    controller = r.bench.controller
    controller.host_time_scale = 10.0
    controller.host_heard()
    controller.advance(2499)
    assert controller.fault == 0
    controller.advance(1)
    assert controller.fault == FaultCode.HOST_SILENT
