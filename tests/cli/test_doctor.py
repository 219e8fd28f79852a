"""`edmctl doctor`: one line for each check, the fix beside what fails, and the exit code of the gravest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from edmctl.errors import ProtocolMismatch
from edmctl.jobs import doctor
from edmctl.jobs.doctor import _line, _round_trip
from edmctl.link.faults import FaultCode
from edmctl.link.messages import ClearFault, ResetCause, State
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.profile.setup import Sensor, Setup
from edmctl.results.measurements import CheckStatus
from edmctl.results.telemetry import LinkReport
from edmctl.simulator import VirtualBench
from edmctl.simulator.bench import MemoryTransport
from edmctl.simulator.injection import parse_injection
from tests.cli.commands import Here, Said
from tests.faults.workshop import Workshop

INTERLOCKS = ("emergency stop", "door", "level", "flow", "temperature", "high voltage")


def found(said: Said) -> dict[str, dict[str, Any]]:
    return {check["name"]: check for check in said.document["result"]["checks"]}


@pytest.fixture
def workshop(here: Here, monkeypatch: pytest.MonkeyPatch) -> Workshop:
    """Return the machine that `doctor` will look at."""
    workshop = Workshop()
    monkeypatch.setattr("edmctl.simulator.open_bench", workshop)
    here("reset")
    return workshop


NAMES = """versions, run folder, setup, port, controller, schema, start, round trip, samples, line, fault, actuator,
displacement, stages, dielectric, calibration"""
CALIBRATE = "Run `edmctl calibrate --seed 1`, and name its file with --calibration."


def test_a_sound_machine_has_nothing_that_fails(here: Here) -> None:
    said = here("doctor", "--json")
    assert said.exit_code == 0, said.err
    checks = found(said)
    names = [" ".join(name.split()) for name in NAMES.split(",")]
    assert set(checks) == {*names, *(f"interlock {name}" for name in INTERLOCKS)}
    assert {check["status"] for check in checks.values()} <= {"ok", "warn"}
    assert checks["calibration"]["fix"] == CALIBRATE
    assert "SIM-1" in checks["controller"]["message"]
    lines = here("doctor").out.splitlines()
    assert lines[0].startswith("ok    versions")
    index = next(i for i, line in enumerate(lines) if line.startswith("warn  calibration"))
    assert lines[index + 1].strip() == f"fix: {CALIBRATE}"


def test_frames_that_were_damaged_before_the_look_do_not_blame_the_cable() -> None:
    before = LinkReport(3, 3, 1, 0, 0, 1, 0, 0.1, 0.1, 0.0, 0.0, 0.0)
    for damaged, status in ((1, "ok"), (2, "warn")):
        after = replace(before, frames_sent=100, frames_received=100, controller_bad_frames=damaged)
        machine = cast("LinkMachine", SimpleNamespace(link_report=lambda report=after: report))
        assert _line(machine, before).status == status


def door(bench: VirtualBench) -> None:
    bench.plant.door_open = True


def hot(bench: VirtualBench) -> None:
    bench.plant.dielectric_temperature_c = 60.0


def latched(bench: VirtualBench) -> None:
    bench.controller.raise_fault(FaultCode.SHORT_STUCK)


def monitor(bench: VirtualBench) -> None:
    bench.plant.unit.monitor_zero_v = 10.0


def injected(text: str) -> Callable[[VirtualBench], None]:
    return lambda bench: bench.inject(parse_injection(text))


@pytest.mark.parametrize(
    ("break_it", "options", "name", "words"),
    [
        (door, (), "interlock door", "Close the door."),
        (hot, (), "interlock temperature", "cool down"),
        (latched, (), "fault", "`edmctl reset --ack 3001`"),
        (latched, ("--sensors",), "gap sensor", "in state FAULT"),
        (monitor, (), "actuator", "amplifier"),
        (injected("GAP_SENSOR_LOW@arm+0"), ("--sensors",), "gap sensor", "`edmctl reset --ack 3003`"),
        (injected("SAMPLES_LOST@0"), (), "samples", "0 of 50"),
    ],
)
def test_what_fails_on_the_machine_is_a_precondition_with_its_fix(
    here: Here,
    workshop: Workshop,
    break_it: Callable[[VirtualBench], None],
    options: tuple[str, ...],
    name: str,
    words: str,
) -> None:
    break_it(workshop.bench)
    said = here("doctor", *options, "--json")
    checks = found(said)
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8040")
    failed = {check for check in checks if checks[check]["status"] == "fail"}
    assert name in failed <= {name, "fault"}
    assert words in f"{checks[name]['message']} {checks[name]['fix']}"
    assert name in said.document["error"]["message"]
    assert workshop.bench.controller.loop.command_v == 0.0


def test_a_controller_that_restarted_by_itself_is_a_warning(here: Here, workshop: Workshop) -> None:
    workshop.bench.controller.reset(ResetCause.BROWN_OUT)
    session = Session(MemoryTransport(workshop.bench.controller))
    session.open()
    session.request(ClearFault(FaultCode.RESET))
    said = here("doctor", "--json")
    start = found(said)["start"]
    assert (said.exit_code, start["status"]) == (0, "warn")
    assert start["message"].startswith("boot 2, brown out")


def test_the_gap_sensor_is_tested_on_demand_and_said_so_before(here: Here, workshop: Workshop) -> None:
    said = here("doctor", "--sensors", "--json")
    assert said.exit_code == 0, said.err
    assert found(said)["gap sensor"]["message"].startswith("10.00 V of 10.00 V")
    assert "making pulses" in said.err
    assert "making pulses" not in here("doctor", "--sensors", "--quiet").err
    assert workshop.bench.controller.state is State.IDLE


def test_a_check_that_fails_leaves_the_others(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("setup.toml").write_text("[sensor]\nfited = true\n", encoding="utf-8")
    said = here("doctor", "--setup", "setup.toml", "--json")
    checks = found(said)
    assert (said.exit_code, checks["setup"]["status"], checks["controller"]["status"]) == (8, "fail", "ok")
    said = here("doctor", "--port", "/dev/nothing-of-the-kind", "--json")
    checks = found(said)
    assert (said.exit_code, checks["port"]["status"]) == (4, "fail")
    assert checks["port"]["fix"]
    assert ("versions" in checks, "controller" in checks) == (True, False)

    def refuse(*_: object) -> None:
        raise ProtocolMismatch("Another version.", hint="Update the firmware.")

    monkeypatch.setattr("edmctl.link.session.check_hello", refuse)
    said = here("doctor", "--json")
    protocol = found(said)["protocol"]
    assert (said.exit_code, protocol["status"]) == (5, "fail")
    assert (protocol["message"], protocol["fix"]) == ("Another version.", "Update the firmware.")


def test_a_folder_that_cannot_be_written_fails(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert doctor.run_folder(tmp_path / "file" / "runs").status is CheckStatus.FAIL
    assert doctor.run_folder(tmp_path / "new" / "runs").status is not CheckStatus.FAIL


def test_a_machine_without_sensor_needs_a_calibration(tmp_path: Path) -> None:
    setup = Setup(sensor=Sensor(fitted=False))
    machine = (setup, "SIM-1", "sim:bench.h5")
    check = doctor.calibration({"EDMCTL_HOME": str(tmp_path)}, *machine)
    assert check.status is CheckStatus.FAIL
    assert check.fix == "Run `edmctl calibrate --port sim:bench.h5`."
    named = doctor.calibration({"EDMCTL_CALIBRATION": str(tmp_path / "none.toml")}, *machine)
    assert named.status is CheckStatus.FAIL
    assert "none.toml" in named.message


@pytest.fixture
def system(tmp_path: Path) -> tuple[Path, Path]:
    """Return a /sys with one FTDI adapter, and a /proc with one program."""
    adapter = tmp_path / "sys" / "bus" / "usb-serial" / "devices" / "ttyUSB0"
    adapter.mkdir(parents=True)
    (adapter / "latency_timer").write_text("16\n")
    program = tmp_path / "proc" / "4711"
    program.mkdir(parents=True)
    (program / "comm").write_text("ModemManager\n")
    return tmp_path / "sys", tmp_path / "proc"


def test_linux_tells_of_slow_adapters_and_of_modem_manager(system: tuple[Path, Path], tmp_path: Path) -> None:
    def told(port: str | None) -> list[tuple[str, str]]:
        return [(check.name, check.status.value) for check in doctor.line_settings(port, *system)]

    (tmp_path / "edm").symlink_to("/dev/ttyUSB0")
    for port in ("/dev/ttyUSB0", str(tmp_path / "edm")):
        assert told(port) == [("latency timer", "warn"), ("ModemManager", "warn")]
    assert "16 ms" in doctor.line_settings("/dev/ttyUSB0", *system)[0].message
    (system[0] / "bus/usb-serial/devices/ttyUSB0/latency_timer").write_text("1\n")
    (system[1] / "4711" / "comm").write_text("bash\n")
    assert told("/dev/ttyUSB0") == [("latency timer", "ok")]
    (tmp_path / "virtual").symlink_to("/dev/pts/0")
    for name in (None, "sim:", "/dev/pts/0", str(tmp_path / "virtual"), "socket://127.0.0.1:7321"):
        assert told(name) == []


@pytest.mark.parametrize(
    ("port", "is_told"),
    [("/dev/ttyUSB0", True), ("COM3", True), ("/dev/pts/0", False), ("socket://a:1", False)],
)
def test_a_slow_line_is_blamed_on_an_adapter_where_there_is_one(
    monkeypatch: pytest.MonkeyPatch, port: str, is_told: bool
) -> None:
    monkeypatch.setattr("edmctl.jobs.doctor.SLOW_S", -1.0)
    identity = SimpleNamespace(transport=port, simulated=False)
    machine = cast("LinkMachine", SimpleNamespace(identity=identity, status=lambda: None))
    check = _round_trip(machine)
    assert check.status is CheckStatus.WARN
    assert ("FTDI" in check.fix) == is_told
    identity.simulated = True
    assert _round_trip(machine).status is CheckStatus.OK
