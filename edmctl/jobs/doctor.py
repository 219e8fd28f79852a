"""Checks of `doctor`: of this computer, its files and its line, and of a connected machine."""

from __future__ import annotations

import dataclasses
import os
import platform
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from edmctl import failures
from edmctl.core.boards import board_of
from edmctl.core.build import source_version
from edmctl.dataclasses import dataclass, field
from edmctl.errors import EdmError, Interrupted, LinkLost, PreconditionError, installing, stages_by_hand
from edmctl.jobs.plan import where_is
from edmctl.jobs.runs.opening import on_machine
from edmctl.link.messages import SCHEMA_HASH, Clock, HelloReply, ResetCause
from edmctl.link.ports import is_adapter
from edmctl.machine.controller import LinkMachine
from edmctl.machine.faults import INTERLOCKS
from edmctl.machine.interface import (
    MachineListener,
    MachineState,
    PulseLog,
    PulseMode,
    PulseSettings,
    TelemetryBlock,
    TelemetrySettings,
)
from edmctl.machine.stop import safe_state_on_error
from edmctl.procedures.settings import motion_settings
from edmctl.profile.calibration import Calibration
from edmctl.profile.folders import find_kept
from edmctl.profile.setup import Setup, load_setup
from edmctl.results.measurements import Check, CheckStatus
from edmctl.results.telemetry import LinkReport
from edmctl.version import __version__
from edmctl.wording import coordinates, decimal, dotted


def ok(name: str, message: str) -> Check:
    """A check without a finding."""
    return Check(name, CheckStatus.OK, message)


def warn(name: str, message: str, fix: str) -> Check:
    """A check with a finding that stops nothing."""
    return Check(name, CheckStatus.WARN, message, fix)


def fail(name: str, message: str, fix: str) -> Check:
    """A check with a finding that stops a job."""
    return Check(name, CheckStatus.FAIL, message, fix)


@dataclass(slots=True)
class Checks:
    """All checks so far, in order."""

    done: list[Check] = field(default_factory=list)

    def add(self, *checks: Check) -> None:
        self.done += checks

    def fail(self, name: str, error: EdmError) -> None:
        """Add a check that ended with an error."""
        self.add(fail(name, error.message, error.hint))

    def as_list(self) -> list[dict[str, str]]:
        """Every check as a mapping of plain values."""
        return [{**dataclasses.asdict(check), "status": check.status.value} for check in self.done]

    def error(self) -> PreconditionError | None:
        """Return the error of the failed checks; None if none failed."""
        failed = [check.name for check in self.done if check.status is CheckStatus.FAIL]
        if not failed:
            return None
        return failures.doctor_checks_failed(
            failed_count=len(failed), done_count=len(self.done), failed=", ".join(failed)
        )


LIBRARIES = ("numpy", "scipy", "h5py", "pyserial", "pydantic")
LEAST_FREE_BYTES = 100e6
"""A job with every pulse recorded takes 26 MB in a quarter of an hour."""
COMFORTABLE_FREE_BYTES = 1e9
LOW_LATENCY_MS = 1
_SYS, _PROC = Path("/sys"), Path("/proc")


def versions() -> Check:
    """Python, edmctl and the libraries that a job needs."""
    found, missing = [f"edmctl {__version__}", f"Python {platform.python_version()}"], []
    for name in LIBRARIES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return fail("versions", f"Missing: {', '.join(missing)}.", f"Install them: {installing(*missing)}.")
    return ok("versions", ", ".join(found))


def run_folder(folder: Path) -> Check:
    """Whether run files can be written, and how much room there is."""
    absolute = folder.absolute()
    place = next((path for path in (absolute, *absolute.parents) if path.exists()), absolute)
    if not (place.is_dir() and os.access(place, os.W_OK | os.X_OK)):
        fix = "Name another folder with --out, or allow writing there."
        return fail("run folder", f"{folder} cannot be written.", fix)
    free_bytes = shutil.disk_usage(place).free
    free = f"{folder}: {free_bytes / 1e9:.1f} GB free"
    if free_bytes < LEAST_FREE_BYTES:
        return fail("run folder", f"{free}.", "Free some space, or name another disk with --out.")
    if free_bytes < COMFORTABLE_FREE_BYTES:
        return warn("run folder", f"{free}.", "Free some space before a long job.")
    return ok("run folder", free)


def load(checks: Checks, path: Path | None) -> Setup:
    """Read the setup; return the default if it cannot be read."""
    try:
        return load_setup(path)
    except EdmError as error:
        checks.fail("setup", error)
        return Setup()


def calibration(environ: Mapping[str, str], setup: Setup, serial: str, port: str) -> Check:
    """Whether the calibration that a job would use exists, can be read, and is of this machine."""
    path = find_kept("calibration", environ, setup.actuator.calibration, serial)
    missing, remedy = f"None of {serial}", f"Run `{on_machine('edmctl calibrate', port)}`."
    if not where_is(port or None, setup).lasting:
        # It is the same machine again only with its seed, which its serial number contains.
        path = find_kept("calibration", environ, setup.actuator.calibration, None)
        seed = serial.removeprefix("SIM-")
        missing = "None is named"
        remedy = f"Run `edmctl calibrate --seed {seed}`, and name its file with --calibration."
    if path is None:
        if setup.sensor.fitted:
            return warn("calibration", f"{missing}; a job makes a quick one of its own.", remedy)
        return fail("calibration", f"{missing}, and no displacement sensor is fitted.", remedy)
    try:
        found = Calibration.load(path)
    except EdmError as error:
        return fail("calibration", error.message, error.hint or remedy)
    if found.serial != serial:
        return warn("calibration", f"{path} is of {found.serial}; this machine is {serial}.", remedy)
    if not found.quality.accepted:
        return warn("calibration", f"{path} was not accepted.", remedy)
    return ok("calibration", str(path))


def line_settings(selector: str | None, sys: Path = _SYS, proc: Path = _PROC) -> Sequence[Check]:
    """Check the latency of an FTDI adapter, and whether ModemManager writes into ports, on Linux."""
    device = os.path.realpath(selector or "")
    if selector is None or not device.startswith("/dev/") or not is_adapter(device):
        return ()
    checks = []
    latency = sys / "bus" / "usb-serial" / "devices" / Path(device).name / "latency_timer"
    with suppress(OSError, ValueError):
        wait_ms = int(latency.read_text())
        slow = f"The adapter keeps bytes back for {wait_ms} ms."
        fix = f"Install the udev rule of docs/, or `echo {LOW_LATENCY_MS} | sudo tee {latency}`."
        is_slow = wait_ms > LOW_LATENCY_MS
        checks.append(warn("latency timer", slow, fix) if is_slow else ok("latency timer", f"{wait_ms} ms"))
    for comm in proc.glob("[0-9]*/comm"):
        with suppress(OSError):
            if comm.read_text().strip() == "ModemManager":
                found = "ModemManager runs; it sends AT commands into a port that has just been plugged in."
                fix = "Install the udev rule of docs/, or `sudo systemctl disable --now ModemManager`."
                checks.append(warn("ModemManager", found, fix))
                break
    return checks


QUESTIONS = 100
SLOW_S = 0.01
"""A round trip that one in a hundred may take: the promise of the line at its usual rate."""
FOLLOWS_V = 4.5
"""3 % of 150 V: how far the voltage monitor may be off the command."""
REST_UM = 60.0
"""A displacement at 0 V beyond this is no rest: hysteresis and creep leave 45 µm."""
GAP_V, GAP_DUTY = 40.0, 0.25
SETTLED_S = 0.5
"""After this time the controller has reported frames that an earlier session sent in part."""
SAMPLED_S, SAMPLE_PERIOD_US = 0.5, 10_000
SAMPLES_SHARE = 0.6
"""Of the samples that are due: the last frame may be on its way, and a fifth of them may be lost."""


def look(checks: Checks, machine: LinkMachine, setup: Setup) -> None:
    """Everything that can be seen without moving. Raises LinkLost."""
    checks.add(ok("port", f"{machine.identity.transport} is open"))
    machine.rest(SETTLED_S)
    before = machine.link_report()
    checks.add(*_identity(machine), _round_trip(machine), _samples(machine), _line(machine, before))
    status, latched = machine.status(), machine.latched_fault()
    for bit, (name, state, fix) in INTERLOCKS.items():
        name = f"interlock {name}"
        is_open = bit in status.interlocks
        checks.add(fail(name, f"Open: {state}.", fix) if is_open else ok(name, "closed"))
    checks.add(fail("fault", latched.message, latched.hint) if latched else ok("fault", "none latched"))
    monitored = f"{decimal(status.actuator_v)} V commanded, the monitor shows {decimal(status.monitor_v)} V"
    if abs(status.monitor_v - status.actuator_v) <= FOLLOWS_V:
        checks.add(ok("actuator", monitored))
    else:
        fix = "Switch the amplifier on, and check its cable to the actuator and its monitor output."
        checks.add(fail("actuator", f"{monitored}.", fix))
    displacement = f"{decimal(status.displacement_um)} µm at {decimal(status.actuator_v)} V"
    if not setup.sensor.fitted:
        checks.add(ok("displacement", "no sensor fitted"))
    elif status.actuator_v == 0.0 and abs(status.displacement_um) > REST_UM:
        fix = "Check the zero of the displacement sensor and its fixing."
        checks.add(warn("displacement", f"{displacement}.", fix))
    else:
        checks.add(ok("displacement", displacement))
    place = f"{coordinates(status.x_um, status.y_um, 1)}, {status.theta_deg:g}°"
    checks.add(ok("stages", f"counted at {place}; the controller cannot measure where they are"))
    checks.add(ok("dielectric", f"{decimal(status.temperature_c, 1)} °C, {status.flow_lpm:.2f} L/min"))


def test_sensors(checks: Checks, machine: LinkMachine, setup: Setup) -> None:
    """Arm, test the gap sensor and disarm; refused unless the machine is idle. Raises LinkLost."""
    state = machine.status().state
    if state is not MachineState.IDLE:
        fix = "Let the other program end, or clear the fault with `edmctl reset`."
        checks.add(fail("gap sensor", f"Not tested: the controller is in state {state.name}.", fix))
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
        read = f"{gap_v:.2f} V of {GAP_V * GAP_DUTY:.2f} V with the generator on, none with it off"
        checks.add(ok("gap sensor", read))


def _identity(machine: LinkMachine) -> list[Check]:
    hello, identity = machine.hello, machine.identity
    kind = "virtual machine" if identity.simulated else f"board {hello.board}"
    rate = f", {hello.baud} baud" if hello.baud else ""
    clock = Clock(hello.clock).name.lower()
    versions = f"firmware {identity.firmware}, protocol {identity.protocol}, {clock} clock{rate}"
    checks = [
        ok("controller", f"{identity.serial}, {kind}, {versions}"),
        ok("schema", f"0x{SCHEMA_HASH:08X} on both sides"),
    ]
    if not identity.simulated:
        checks.append(_firmware(hello, identity.transport))
    cause = f"reset cause {hello.reset_cause}"
    with suppress(ValueError):
        cause = ResetCause(hello.reset_cause).name.lower().replace("_", " ")
    start = f"boot {hello.boot_count}, {cause}"
    if hello.reset_cause in (ResetCause.WATCHDOG, ResetCause.BROWN_OUT):
        fix = "Look for a weak 5 V supply, a loose plug or a relay on the same supply."
        return [*checks, warn("start", f"{start}: the controller restarted by itself.", fix)]
    return [*checks, ok("start", start)]


def _firmware(hello: HelloReply, port: str) -> Check:
    """Compare the board's firmware version with the version that this edmctl builds."""
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
    is_newer = runs > builds
    compared = f"{dotted(runs)}, {'newer' if is_newer else 'older'} than the {dotted(builds)} of this edmctl."
    fix = f"`edmctl firmware build --board {board.name}`, `edmctl firmware flash edmctl-{board.name}.bin"
    return warn("firmware", compared, "Update edmctl." if is_newer else f"{fix} --port {port}`.")


def _round_trip(machine: LinkMachine) -> Check:
    """Return the round trip of a command; a slow one is no fault of a virtual machine, which waits for its host."""
    times_s = []
    for _ in range(QUESTIONS):
        start_s = time.perf_counter()
        machine.status()
        times_s.append(time.perf_counter() - start_s)
    times_s.sort()
    p50_s, p99_s = times_s[QUESTIONS // 2], times_s[QUESTIONS - 2]
    measured = f"{1e3 * p50_s:.2f} ms, {1e3 * p99_s:.2f} ms at the 99th percentile of {QUESTIONS}"
    if p99_s <= SLOW_S or machine.identity.simulated:
        return ok("round trip", measured)
    adapter = is_adapter(machine.identity.transport)
    timer = "; on an FTDI adapter set its latency timer to 1 ms." if adapter else "."
    return warn("round trip", f"{measured}.", f"Close what keeps the computer busy{timer}")


class _Counted(MachineListener):
    """A listener that counts samples."""

    samples = 0

    def telemetry(self, block: TelemetryBlock) -> None:
        self.samples += len(block.time_s)


def _samples(machine: LinkMachine) -> Check:
    """Whether the samples arrive that every motion depends on."""
    counted, due = _Counted(), round(SAMPLED_S * 1e6 / SAMPLE_PERIOD_US)
    machine.start_telemetry(TelemetrySettings(SAMPLE_PERIOD_US, 10, PulseLog.OFF), counted)
    machine.rest(SAMPLED_S)
    machine.stop_telemetry()
    came = f"{counted.samples} of {due} in {SAMPLED_S:g} s"
    if counted.samples >= SAMPLES_SHARE * due:
        return ok("samples", came)
    fix = "See that no other program reads the port, then restart the controller; without samples no job "
    return fail("samples", f"Only {came} came.", f"{fix}continues. {stages_by_hand()}")


def _line(machine: LinkMachine, before: LinkReport) -> Check:
    """Return the errors of the line since `before`: half a frame of an earlier session is older."""
    report = machine.link_report()
    here = report.bad_frames - before.bad_frames
    there = report.controller_bad_frames - before.controller_bad_frames
    repeated = report.retries - before.retries
    frames = (
        f"{report.frames_sent} frames out, {report.frames_received} in; damaged {here} here and {there} there"
    )
    if not (here or there or repeated):
        return ok("line", f"{frames}, {repeated} repeated")
    fix = "Lay the cable away from the generator, use a shielded one with a ferrite, and check the ground."
    return warn("line", f"{frames}, {repeated} repeated.", fix)
