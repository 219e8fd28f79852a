"""Stop requests and faults as errors."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING

import pytest
from cobs import cobs

from edmctl.errors import Interrupted, MachineFault
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.link_errors import CommandRefused
from edmctl.link.messages import PARAMS, Fault
from edmctl.link.transport import Transport
from edmctl.machine.controller import LinkMachine
from edmctl.machine.faults import fault_error, host_fault
from edmctl.machine.interface import Axis, CutRequest, JumpRequest, MachineState
from edmctl.machine.stop import StopRequest

from .conftest import PULSES, REFERENCE_V, SETTINGS, TELEMETRY
from .lying import LyingLine

if TYPE_CHECKING:
    from .conftest import MakeRig


DEFAULTS = {name: param.default for name, param in PARAMS.items()}


def test_the_first_stop_request_wins() -> None:
    stop = StopRequest()
    stop.check()
    stop.request(signal.SIGINT)
    stop.request(signal.SIGTERM)
    with pytest.raises(Interrupted, match="SIGINT") as caught:
        stop.check()
    assert caught.value.signal_number == signal.SIGINT


@pytest.mark.parametrize("code", sorted(FAULTS))
def test_every_fault_has_a_message_with_its_figures_and_a_remedy(code: int) -> None:
    error, row = fault_error(code, DEFAULTS), FAULTS[code]
    assert (error.exit_code, error.code) == (row.exit_code, row.error)
    assert "{" not in error.message
    assert error.hint.startswith(row.hint.removesuffix("."))
    assert (f"`edmctl reset --ack {code}`" in error.hint) == row.latched
    if isinstance(error, MachineFault):
        assert error.fault == code


def test_the_port_of_a_real_machine_stands_in_the_command_that_clears() -> None:
    error = fault_error(4002, DEFAULTS, port="/dev/ttyACM0")
    assert error.hint == "Close the door; then `edmctl reset --ack 4002 --port /dev/ttyACM0`."


def test_what_the_host_finds_needs_no_clearing() -> None:
    error = host_fault("LINE_NOISE", " On COM3.", bad_frames=12)
    assert (error.code, error.exit_code) == ("E61003", 6)
    assert "12 damaged frames" in error.message
    assert error.message.endswith("On COM3.")
    assert "reset" not in error.hint


def test_the_silent_host_is_told_for_how_long() -> None:
    assert "0.4 s" in fault_error(1001, {**DEFAULTS, "watchdog_s": 0.4}).message


def test_an_unknown_fault_is_still_named() -> None:
    assert "9999" in fault_error(9999, DEFAULTS).message


def test_a_motion_that_never_ends_is_a_fault_that_names_what_was_waited_for(rig: MakeRig) -> None:
    r = rig()
    r.machine.configure(replace(SETTINGS, slew_limit_v_s=1.0), PULSES)
    r.machine.start_telemetry(TELEMETRY, r.heard)
    r.machine.arm()
    start_s = r.machine.time_s
    # 0.3 s by the request, 30 s by the controller's own slew limit.
    with pytest.raises(MachineFault, match=r"did not report MOVE_DONE within 5\.3 s") as caught:
        r.machine.ramp(30.0, 100.0)
    assert caught.value.code == "E6001"
    assert caught.value.exit_code == 6
    assert caught.value.hint
    assert r.machine.time_s - start_s == pytest.approx(5.3, abs=0.3)
    r.machine.safe_stop()
    r.session.pump(1.0)  # as slow on the way back
    status = r.machine.status()
    assert (status.state, status.actuator_v) == (MachineState.IDLE, 0.0)


class LateFaults(LyingLine):
    """A line on which a FAULT, with its repetitions, comes `late_s` after the first."""

    def __init__(self, line: Transport, late_s: float) -> None:
        super().__init__(line, None, Random(1))
        self._late_s = late_s

    def _passed(self, part: bytes) -> bytes:
        if cobs.decode(part)[0] != Fault.ID:
            return b"\0" + part + b"\0"
        if self.told_s is None:
            self.told_s = self.now_s()
        return b"\0" + part + b"\0" if self.now_s() - self.told_s >= self._late_s else b""


COMMANDS: dict[str, Callable[[LinkMachine], object]] = {
    "ramp": lambda machine: machine.ramp(1.0, 100.0),
    "stage": lambda machine: machine.move_stage(Axis.X, -4000.0, 5000.0),
    "jump": lambda machine: machine.jump(JumpRequest(50.0, 500.0, 0.0, 5.0)),
    "zero": lambda machine: machine.set_zero(0.0),
    "cut": lambda machine: machine.start_cut(CutRequest(REFERENCE_V, 400.0, 10.0)),
    "stop": lambda machine: machine.stop_cut(),
    "arm": lambda machine: machine.arm(),
    "pulses": lambda machine: machine.set_pulses(PULSES),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("late_s", [0.25, 60.0])
def test_a_refusal_that_overtakes_its_fault_hides_it_not(command: str, late_s: float, rig: MakeRig) -> None:
    r = rig()
    r.session.transport = LateFaults(r.session.transport, late_s)
    r.ready()
    r.bench.controller.raise_fault(FaultCode.HOST_SILENT)
    with pytest.raises(MachineFault) as caught:
        COMMANDS[command](r.machine)
    error = caught.value
    assert (error.code, error.exit_code, error.fault) == ("E61001", 6, 1001)
    assert "reset --ack 1001" in error.hint


def test_a_refusal_without_a_fault_stays_one_and_is_told_at_once(rig: MakeRig) -> None:
    r = rig()
    r.machine.configure(SETTINGS, PULSES)
    before_s = r.session.machine_now_s()
    with pytest.raises(CommandRefused, match="PIEZO_SET: BAD_STATE"):
        r.machine.ramp(1.0, 100.0)
    assert r.session.machine_now_s() - before_s < 0.1
