"""Checks of `doctor` on a machine that answers."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from edmctl.core.boards import board_of
from edmctl.core.build import source_version
from edmctl.errors import EdmError, Interrupted, LinkLost, stages_by_hand
from edmctl.jobs.doctor_host import Checks, fail, ok, warn
from edmctl.link.messages import SCHEMA_HASH, Clock, HelloReply, ResetCause
from edmctl.link.ports import is_adapter
from edmctl.machine.faults import INTERLOCKS
from edmctl.machine.interface import (
    MachineState,
    MachineStatus,
    PulseLog,
    PulseMode,
    PulseSettings,
    SampleListener,
    TelemetryBlock,
    TelemetrySettings,
)
from edmctl.procedures.settings import motion_settings
from edmctl.profile.setup import Setup
from edmctl.results.equipment import Check
from edmctl.results.telemetry import LinkReport
from edmctl.wording import coordinates, decimal, dotted

if TYPE_CHECKING:
    from edmctl.machine.controller import LinkMachine

QUESTIONS = 100
SLOW_S = 0.01
"""A round trip that one in a hundred may take: the promise of the line at its usual rate."""
FOLLOWS_V = 4.5
"""3 % of 150 V: how far the voltage monitor may be off the command."""
REST_UM = 60.0
"""A displacement at 0 V beyond this is no rest: hysteresis and creep leave 45 µm."""
GAP_V, GAP_DUTY = 40.0, 0.25
SETTLED_S = 0.5
"""After this the controller has told of frames that a session before this one has left half sent."""
SAMPLED_S, SAMPLE_PERIOD_US = 0.5, 10_000
SAMPLES_SHARE = 0.6
"""Of the samples that are due: the last frame may be on its way, and a fifth of them may be lost."""


def look(checks: Checks, machine: LinkMachine, setup: Setup) -> None:
    """Everything that can be seen without moving. Raises LinkLost."""
    checks.add(ok("port", f"{machine.identity.transport} is open"))
    machine.rest(SETTLED_S)
    before = machine.link_report()
    checks.add(*_identity(machine), _round_trip(machine), _samples(machine), _line(machine, before))
    status = machine.status()
    checks.add(*_interlocks(status), _fault(machine), _actuator(status), _sensor(status, setup))
    place = f"{coordinates(status.x_um, status.y_um, 1)}, {status.theta_deg:g}°"
    checks.add(ok("stages", f"counted at {place}; the controller cannot measure where they are"))
    checks.add(ok("dielectric", f"{decimal(status.temperature_c, 1)} °C, {status.flow_lpm:.2f} L/min"))


def test_sensors(checks: Checks, machine: LinkMachine, setup: Setup) -> None:
    """Arm, test the gap sensor and disarm; refused unless the machine is idle. Raises LinkLost."""
    from edmctl.procedures.session import safe_state_on_error

    state = machine.status().state
    if state is not MachineState.IDLE:
        checks.add(
            fail(
                "gap sensor",
                f"Not tested: the controller is in state {state.name}.",
                "Let the other program end, or clear the fault with `edmctl reset`.",
            )
        )
        return
    on_us, off_us = 100.0, 100.0 / GAP_DUTY - 100.0
    pulses = PulseSettings(on_us, off_us, GAP_V, 0.1, PulseMode.ISOFREQUENCY, 0.0)
    try:
        with safe_state_on_error(machine):
            motion = motion_settings(setup, 0.0, sensor_fitted=setup.sensor.fitted, pulses=True)
            machine.configure(motion, pulses)
            machine.arm()
            gap_v = machine.self_test()
            machine.disarm()
    except (LinkLost, Interrupted):
        raise
    except EdmError as error:
        checks.fail("gap sensor", error)
    else:
        told = f"{gap_v:.2f} V of {GAP_V * GAP_DUTY:.2f} V with the generator on, none with it off"
        checks.add(ok("gap sensor", told))


def _identity(machine: LinkMachine) -> list[Check]:
    hello, identity = machine.hello, machine.identity
    kind = "virtual machine" if identity.simulated else f"board {hello.board}"
    rate = f", {hello.baud} baud" if hello.baud else ""
    clock = Clock(hello.clock).name.lower()
    told = (
        f"{identity.serial}, {kind}, firmware {identity.firmware}, protocol {identity.protocol}, "
        f"{clock} clock{rate}"
    )
    checks = [ok("controller", told), ok("schema", f"0x{SCHEMA_HASH:08X} on both sides")]
    if not identity.simulated:
        checks.append(_firmware(hello, identity.transport))
    cause = f"boot {hello.boot_count}, {_name(hello.reset_cause)}"
    if hello.reset_cause in (ResetCause.WATCHDOG, ResetCause.BROWN_OUT):
        fix = "Look for a weak 5 V supply, a loose plug or a relay on the same supply."
        checks.append(warn("start", f"{cause}: the controller restarted by itself.", fix))
    else:
        checks.append(ok("start", cause))
    return checks


def _firmware(hello: HelloReply, port: str) -> Check:
    """Whether the board runs what this edmctl builds; of another schema there would be no session."""
    runs = (hello.fw_major, hello.fw_minor, hello.fw_patch)
    board = board_of(hello.board)
    if board is None:
        return ok("firmware", f"{dotted(runs)} of board {hello.board}, which this edmctl builds nothing for")
    try:
        builds = source_version()
    except (OSError, ValueError):
        return ok("firmware", f"{dotted(runs)} of {board.title}")
    if runs == builds:
        return ok("firmware", f"{dotted(runs)} of {board.title}, that of this edmctl")
    if runs > builds:
        return warn(
            "firmware", f"{dotted(runs)}, newer than the {dotted(builds)} of this edmctl.", "Update edmctl."
        )
    fix = f"`edmctl firmware build --board {board.name}`, `edmctl firmware flash edmctl-{board.name}.bin"
    fix += f" --port {port}`."
    return warn("firmware", f"{dotted(runs)}, older than the {dotted(builds)} of this edmctl.", fix)


def _name(reset_cause: int) -> str:
    try:
        return ResetCause(reset_cause).name.lower().replace("_", " ")
    except ValueError:
        return f"reset cause {reset_cause}"


def _round_trip(machine: LinkMachine) -> Check:
    """Return the round trip of a command; a slow one is no fault of a virtual machine, which waits for its host."""
    times_s, port = [], machine.identity.transport
    for _ in range(QUESTIONS):
        start_s = time.perf_counter()
        machine.status()
        times_s.append(time.perf_counter() - start_s)
    times_s.sort()
    p50_s, p99_s = times_s[QUESTIONS // 2], times_s[QUESTIONS - 2]
    told = f"{1e3 * p50_s:.2f} ms, {1e3 * p99_s:.2f} ms at the 99th percentile of {QUESTIONS}"
    if p99_s > SLOW_S and not machine.identity.simulated:
        fix = "Close what keeps the computer busy"
        fix += "; on an FTDI adapter set its latency timer to 1 ms." if is_adapter(port) else "."
        return warn("round trip", f"{told}.", fix)
    return ok("round trip", told)


class _Counted(SampleListener):
    """A listener that counts samples."""

    def __init__(self) -> None:
        self.samples = 0

    def telemetry(self, block: TelemetryBlock) -> None:
        """Count."""
        self.samples += len(block.time_s)


def _samples(machine: LinkMachine) -> Check:
    """Whether the samples come that every motion is judged by."""
    counted, wanted = _Counted(), round(SAMPLED_S * 1e6 / SAMPLE_PERIOD_US)
    machine.start_telemetry(TelemetrySettings(SAMPLE_PERIOD_US, 10, PulseLog.OFF), counted)
    machine.rest(SAMPLED_S)
    machine.stop_telemetry()
    told = f"{counted.samples} of {wanted} in {SAMPLED_S:g} s"
    if counted.samples < SAMPLES_SHARE * wanted:
        fix = "See that no other program reads the port, then restart the controller; without samples no job "
        fix += f"continues. {stages_by_hand()}"
        return fail("samples", f"Only {told} came.", fix)
    return ok("samples", told)


def _line(machine: LinkMachine, before: LinkReport) -> Check:
    """How the line has done since `before`: half a frame of a session that broke off is older."""
    report = machine.link_report()
    here = report.bad_frames - before.bad_frames
    there = report.controller_bad_frames - before.controller_bad_frames
    repeated = report.retries - before.retries
    told = (
        f"{report.frames_sent} frames out, {report.frames_received} in; damaged {here} here and {there} there, "
        f"{repeated} repeated"
    )
    if here or there or repeated:
        fix = (
            "Lay the cable away from the generator, use a shielded one with a ferrite, and check the ground."
        )
        return warn("line", f"{told}.", fix)
    return ok("line", told)


def _interlocks(status: MachineStatus) -> list[Check]:
    return [
        fail(f"interlock {name}", f"Open: {words}.", fix)
        if bit in status.interlocks
        else ok(f"interlock {name}", "closed")
        for bit, (name, words, fix) in INTERLOCKS.items()
    ]


def _fault(machine: LinkMachine) -> Check:
    latched = machine.latched_fault()
    return fail("fault", latched.message, latched.hint) if latched else ok("fault", "none latched")


def _actuator(status: MachineStatus) -> Check:
    told = f"{decimal(status.actuator_v)} V commanded, the monitor shows {decimal(status.monitor_v)} V"
    if abs(status.monitor_v - status.actuator_v) > FOLLOWS_V:
        fix = "Switch the amplifier on, and check its cable to the actuator and its monitor output."
        return fail("actuator", f"{told}.", fix)
    return ok("actuator", told)


def _sensor(status: MachineStatus, setup: Setup) -> Check:
    if not setup.sensor.fitted:
        return ok("displacement", "no sensor fitted")
    told = f"{decimal(status.displacement_um)} µm at {decimal(status.actuator_v)} V"
    if status.actuator_v == 0.0 and abs(status.displacement_um) > REST_UM:
        return warn("displacement", f"{told}.", "Check the zero of the displacement sensor and its fixing.")
    return ok("displacement", told)
