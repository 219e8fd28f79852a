"""What a host does with a controller that another host, or a fault, has left behind."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.errors import MachineFault, PreconditionError, UsageError
from edmctl.link.faults import FaultCode
from edmctl.link.messages import Disarm
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.machine.faults import FaultLatched, InterlockOpen, NothingLatched
from edmctl.machine.interface import Interlock, MachineState, PulseLog, TelemetryFlag
from edmctl.simulator.bench import MemoryTransport
from edmctl.simulator.injection import parse_injection

from .conftest import PULSES, SETTINGS

if TYPE_CHECKING:
    from .conftest import MakeRig, Rig


def another_host(r: Rig) -> LinkMachine:
    """A host that comes after the first one has died in the middle of what it did."""
    session = Session(MemoryTransport(r.bench.controller), Random(2))
    session.open()
    return LinkMachine(session)


def in_fault(r: Rig, tool_v: float = 40.0) -> LinkMachine:
    """The machine just after its door was opened with the tool down, and closed again."""
    r.ready()
    r.machine.ramp(tool_v, 200.0)
    r.bench.controller.raise_fault(FaultCode.DOOR)
    return another_host(r)


def test_an_idle_controller_is_left_alone(rig: MakeRig) -> None:
    r = rig()
    r.machine.status()
    before_s = r.bench.transport.now_s()
    r.machine.wait_for_rest()
    assert r.bench.transport.now_s() - before_s < 0.002


def test_a_cut_whose_host_died_has_ended_when_the_next_one_has_said_hello(rig: MakeRig) -> None:
    r = rig().ready().sparking()
    r.machine.watch_cut(0.5)
    machine = another_host(r)
    assert r.bench.plant.drive.pulses_on == 0
    assert (machine.hello.state, machine.hello.fault) == (MachineState.FAULT, 1001)
    machine.wait_for_rest()
    status = machine.status()
    assert (status.state, status.fault, status.actuator_v) == (MachineState.FAULT, 1001, 0.0)


def test_the_job_after_a_dead_host_is_refused_with_the_command_that_clears_its_fault(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.ramp(40.0, 200.0)
    machine = another_host(r)
    machine.wait_for_rest()
    with pytest.raises(FaultLatched, match="another took its place") as caught:
        machine.configure(SETTINGS, PULSES)
    assert caught.value.hint.endswith("`edmctl reset --ack 1001`.")
    machine.clear_fault(1001)
    machine.configure(SETTINGS, PULSES)
    machine.arm()


def test_a_disarm_whose_host_died_is_waited_for(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.ramp(40.0, 200.0)
    r.session.request(Disarm())
    machine = another_host(r)
    assert machine.status().actuator_v > 0.0
    machine.wait_for_rest()
    status = machine.status()
    assert (status.state, status.fault, status.actuator_v) == (MachineState.IDLE, 0, 0.0)


def test_in_a_fault_only_the_retreat_is_waited_for(rig: MakeRig) -> None:
    machine = in_fault(rig())
    assert machine.status().actuator_v > 0.0
    machine.wait_for_rest()
    status = machine.status()
    assert (status.state, status.fault, status.actuator_v) == (MachineState.FAULT, 4002, 0.0)


def test_a_fault_is_cleared_as_soon_as_the_tool_is_back(rig: MakeRig) -> None:
    machine = in_fault(rig())
    machine.clear_fault(4002)
    status = machine.status()
    assert (status.state, status.fault, status.actuator_v) == (MachineState.IDLE, 0, 0.0)


def test_another_fault_than_the_latched_one_is_not_cleared(rig: MakeRig) -> None:
    machine = in_fault(rig())
    with pytest.raises(UsageError) as caught:
        machine.clear_fault(3001)
    assert caught.value.code == "E2030"
    assert "Not fault 3001 is latched but 4002: The door" in caught.value.message
    assert "`edmctl reset --ack 4002`" in caught.value.hint
    assert machine.status().fault == 4002


def test_an_interlock_that_is_still_open_is_named(rig: MakeRig) -> None:
    r = rig()
    machine = in_fault(r)
    r.bench.plant.door_open = True
    with pytest.raises(InterlockOpen, match="the door is open") as caught:
        machine.clear_fault(4002)
    assert (caught.value.interlocks, caught.value.exit_code) == (Interlock.DOOR, 8)
    assert machine.status().fault == 4002


def test_nothing_to_clear_is_told_as_such(rig: MakeRig) -> None:
    with pytest.raises(NothingLatched, match="holds no fault"):
        rig().machine.clear_fault(4002)


def test_a_job_on_a_latched_fault_is_refused_with_the_command_that_clears_it(rig: MakeRig) -> None:
    machine = in_fault(rig())
    with pytest.raises(FaultLatched) as caught:
        machine.configure(SETTINGS, PULSES)
    assert (caught.value.code, caught.value.fault) == ("E8010", 4002)
    assert caught.value.hint == "Close the door; then `edmctl reset --ack 4002`."


def test_the_black_box_holds_the_two_seconds_before_the_fault(rig: MakeRig) -> None:
    r = rig().ready().sparking()
    for _ in range(25):
        r.machine.watch_cut(0.1)
    r.bench.controller.raise_fault(FaultCode.DOOR)
    with pytest.raises(MachineFault):
        r.machine.rest(1.0)
    r.machine.safe_stop()
    box = r.machine.black_box()
    assert box is not None
    assert len(box.time_s) == 2048
    assert np.diff(box.time_s) == pytest.approx(1e-3)
    assert np.all(box.state == MachineState.MACHINING)
    assert np.all(box.flags & TelemetryFlag.PULSES_ON)
    heard = np.concatenate([block.time_s for block in r.heard.blocks])
    volts = np.concatenate([block.actuator_v for block in r.heard.blocks])
    told = (heard >= box.time_s[0]) & (heard <= box.time_s[-1])
    assert np.interp(heard[told], box.time_s, box.actuator_v) == pytest.approx(volts[told], abs=0.005)


def test_the_waveforms_of_a_fault_cover_it_in_time_with_the_pulses(rig: MakeRig) -> None:
    r = rig().ready(PulseLog.FULL).sparking()
    r.machine.watch_cut(1.0)
    assert r.machine.waveforms() is None
    r.bench.controller.raise_fault(FaultCode.DOOR)
    batch = r.machine.waveforms()
    assert batch is not None, "asked at once, it waits until they are whole"
    r.machine.safe_stop()
    box = r.machine.black_box()
    assert box is not None
    period_s = 434.783e-6
    assert batch.time_s[0] - box.time_s[-1] == pytest.approx(-64 * period_s, abs=period_s)
    assert batch.time_s[-1] - box.time_s[-1] == pytest.approx(16 * period_s, abs=2e-6)
    assert np.diff(batch.time_s) == pytest.approx(1e-6)
    assert batch.gap_v.max() == pytest.approx(40.0, abs=0.5)
    train = r.heard.trains[-1]
    starts_s = train.start_s + train.period_s * np.arange(len(train.delay_us))
    lit = np.flatnonzero((train.discharge_us > 50.0) & (starts_s > batch.time_s[0]))[:-1]
    assert len(lit) > 5
    for pulse in lit:
        middle_s = starts_s[pulse] + 1e-6 * (train.delay_us[pulse] + 0.5 * train.discharge_us[pulse])
        assert np.interp(middle_s, batch.time_s, batch.current_a) > 0.1
    r.machine.clear_fault(FaultCode.DOOR)
    assert r.machine.waveforms() is None


def test_the_waveforms_of_a_short_memory_are_read_as_far_as_they_go(rig: MakeRig) -> None:
    r = rig()
    r.bench.controller.waveforms.memory = 2000
    r.ready()
    r.sparking()
    r.machine.watch_cut(1.0)
    r.bench.controller.raise_fault(FaultCode.DOOR)
    batch, box = r.machine.waveforms(), r.machine.black_box()
    assert batch is not None
    assert box is not None
    assert batch.time_s[-1] - box.time_s[-1] == pytest.approx(400e-6, abs=2e-6)
    assert 1100 < len(batch.time_s) - 400 <= 1600


def test_the_self_test_measures_the_mean_gap_voltage(rig: MakeRig) -> None:
    r = rig().ready()
    assert r.machine.self_test() == pytest.approx(0.3 * 40.0, rel=0.01)
    assert r.machine.status().state is MachineState.ARMED


@pytest.mark.parametrize("broken", ["GAP_SENSOR_HIGH@arm+0", "GAP_SENSOR_LOW@arm+0"])
def test_a_wrong_gap_sensor_is_found_before_anything_moves(rig: MakeRig, broken: str) -> None:
    r = rig()
    r.bench.inject(parse_injection(broken))
    r.ready()
    r.machine.rest(0.05)
    with pytest.raises(MachineFault) as caught:
        r.machine.self_test()
    assert caught.value.code == "E63003"
    assert r.machine.status().actuator_v == 0.0


def test_a_self_test_with_the_tool_down_is_refused(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.ramp(10.0, 100.0)
    with pytest.raises(PreconditionError):
        r.machine.self_test()


def test_the_status_shows_the_monitor_and_the_flags(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.ramp(20.0, 100.0)
    r.machine.rest(0.1)
    status = r.machine.status()
    assert status.monitor_v == pytest.approx(20.0, abs=0.05)
    assert not status.flags & TelemetryFlag.PULSES_ON


def test_the_link_report_counts_both_ways(rig: MakeRig) -> None:
    r = rig().ready()
    report = r.machine.link_report()
    assert report.frames_sent == r.session.statistics.frames_sent > 40
    assert (report.bad_frames, r.machine.bad_frames) == (0, 0)
