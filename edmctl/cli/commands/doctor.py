"""`edmctl doctor`, `ports` and `reset`: check what a job needs, list the ports, clear a latched fault."""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from edmctl import failures
from edmctl.cli.options import NOTES, PortOption, SetupOption, WaitOption, command, option
from edmctl.cli.outcome import Outcome, tell
from edmctl.cli.render.procedure_tables import render_checks, render_ports
from edmctl.cli.signals import shell
from edmctl.errors import EdmError, Interrupted, LinkLost, PreconditionError, ProtocolMismatch
from edmctl.files import lock_holder

if TYPE_CHECKING:
    from edmctl.jobs.doctor import Checks
    from edmctl.link.messages import HelloReply
    from edmctl.link.ports import PortInfo
    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.setup import Setup
    from edmctl.results.measurements import Controller, PortRow

OutOption = Annotated[Path, option("--out DIR", "Folder of the run files.")]
SensorsOption = Annotated[
    bool,
    option("--sensors", "Also arm, make pulses with the tool retracted to test the gap sensor, and disarm."),
]
AckOption = Annotated[int | None, option("--ack CODE", "The fault to clear. Default: show it only.")]
ProbeOption = Annotated[
    bool, option("--probe", "Identify the controllers at the ports that `auto` would try.")
]


@command("doctor", NOTES)
def doctor(
    outcome: Outcome,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
    sensors: SensorsOption = False,
    out: OutOption = Path("runs"),
) -> None:
    """Check host, port and controller, with a remedy for each problem.

    Nothing moves. --sensors arms the generator briefly.
    """
    from edmctl.jobs.doctor import Checks

    checks = Checks()
    error = None
    try:
        error = _look(outcome, checks, setup, (port, wait), out, sensors=sensors)
    finally:
        outcome.result = {"checks": checks.as_list()}
        outcome.show(lambda style: render_checks(checks.done, style))
    if error or (error := checks.error()):
        raise error


def _look(
    outcome: Outcome,
    checks: "Checks",
    setup_file: Path | None,
    place: tuple[str | None, float],
    out: Path,
    *,
    sensors: bool,
) -> "EdmError | None":
    """Do every check that is possible; return the error of the line or the protocol, if that fails."""
    from edmctl.jobs import doctor as jobs_doctor
    from edmctl.jobs.connect import machine_at

    say = partial(tell, outcome.output)
    port, wait_s = place
    checks.add(jobs_doctor.versions())
    checks.add(jobs_doctor.run_folder(out))
    setup = jobs_doctor.load(checks, setup_file)
    selector = port or setup.port
    checks.add(*jobs_doctor.line_settings(selector))
    try:
        with machine_at(setup, port, wait_s, say, shell()) as bench:
            machine = bench.machine
            if bench.own_setup is not None:
                setup = bench.own_setup
            outcome.simulated = machine.identity.simulated
            jobs_doctor.look(checks, machine, setup)
            checks.add(jobs_doctor.calibration(os.environ, setup, machine.identity.serial, port or ""))
            if sensors:
                say("doctor: arming, and making pulses with the tool retracted, for about a second.")
                jobs_doctor.test_sensors(checks, machine, setup)
    except ProtocolMismatch as error:
        checks.fail("protocol", error)
        return error
    except Interrupted:
        raise
    except EdmError as error:
        checks.fail("port", error)
        return error if isinstance(error, LinkLost) else None
    finally:
        if all(check.name != "setup" for check in checks.done):
            checks.add(jobs_doctor.ok("setup", setup.in_words()))
    return None


@command("reset")
def reset(
    outcome: Outcome,
    ack: AckOption = None,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
) -> None:
    """Show the latched fault, or clear it.

    Name the fault code with --ack, so that only the fault that you have read is cleared.
    """
    from edmctl.jobs.connect import machine_at
    from edmctl.jobs.plan import where_is
    from edmctl.profile.setup import load_setup

    settings = load_setup(setup)
    where = where_is(port, settings)
    lasting = where.lasting
    if (file := where.bench_file) is not None and not file.exists():
        raise failures.bench_absent(file=file)
    with machine_at(settings, port, wait, partial(tell, outcome.output), shell()) as bench:
        machine = bench.machine
        outcome.simulated = machine.identity.simulated
        _clear(outcome, machine, ack, lasting=lasting)


def _clear(outcome: Outcome, machine: "LinkMachine", ack: int | None, *, lasting: bool) -> None:
    from edmctl.machine.faults import NothingLatched

    latched = machine.latched_fault()
    outcome.result = {"latched": latched.fault if latched else None, "cleared": False}
    if ack is None:
        if latched:
            raise latched
        outcome.text = "The controller holds no fault."
        if not lasting:
            outcome.text += " It is a fresh virtual machine, because none was named: --port names another."
        return
    try:
        machine.clear_fault(ack)
    except NothingLatched as nothing:
        if not lasting:
            raise PreconditionError(
                f"{nothing.message} It is a fresh virtual machine, because none was named.",
                hint="Name the machine that holds the fault with --port or EDMCTL_PORT.",
                code=nothing.code,
            ) from nothing
        outcome.text = nothing.message
        return
    outcome.result = {"latched": None, "cleared": True}
    outcome.text = f"Fault {ack} is cleared; the controller is idle."


@command("ports")
def ports(outcome: Outcome, setup: SetupOption = None, probe: ProbeOption = False) -> None:
    """List serial ports, and those of the setup.

    No port is opened without --probe. It opens ports with known USB ids and those that the setup names.
    """
    from edmctl.profile.setup import load_setup

    rows = _port_rows(load_setup(setup), probe=probe)
    outcome.result = {"ports": rows}
    outcome.show(lambda style: render_ports(rows, style))


def _port_rows(setup: "Setup", *, probe: bool) -> "list[PortRow]":
    """Look at every port that is listed or named in the setup; with `probe` ask those that may be asked."""
    from edmctl.link.ports import listed_ports, probable_ports, same_port
    from edmctl.results.measurements import PortRow

    # A selector such as `auto` or `serial:ID` names no port.
    port = setup.port or ""
    is_port = "://" in port or not (port == "auto" or port.startswith(("sim", "serial:")))
    named = tuple(dict.fromkeys((*([port] if port and is_port else ()), *setup.link.candidates)))
    known = probable_ports(setup.link.usb_ids, named)
    known_devices = {one.device for one in known}
    answers = _answers(setup, known) if probe else {}
    listed = listed_ports()
    listed_devices = {one.device for one in listed}
    rows = []
    for one in (*listed, *(one for one in known if one.device not in listed_devices)):
        hello, error = answers.get(one.device, (None, None))
        rows.append(
            PortRow(
                device=one.device,
                description=one.description,
                usb_id=one.usb_id,
                usb_serial=one.usb_serial,
                held_by=lock_holder(Path(one.device)),
                in_setup=any(same_port(name, one.device) for name in named),
                known=one.device in known_devices,
                controller=_controller(hello) if hello else None,
                error=None if hello else error,
            )
        )
    return rows


def _answers(setup: "Setup", known: "list[PortInfo]") -> "Mapping[str, tuple[HelloReply | None, str | None]]":
    """Ask the ports who is there; the reply or the error of each device."""
    from edmctl.jobs.connect import secret_for
    from edmctl.link.probing import probe

    secret = secret_for([one.device for one in known], setup.link.secret_file, shell().environ)
    answers = probe(known, setup.link.baud, setup.link.hello_s, secret)
    return {answer.port.device: (answer.hello, answer.error) for answer in answers}


def _controller(hello: "HelloReply") -> "Controller":
    from edmctl.link.faults import FAULTS
    from edmctl.link.messages import State
    from edmctl.results.measurements import Controller

    names = {int(code): row.name for code, row in FAULTS.items()}
    return Controller(
        serial=hello.serial,
        firmware=f"{hello.fw_major}.{hello.fw_minor}.{hello.fw_patch}",
        protocol=f"{hello.proto_major}.{hello.proto_minor}",
        state=State(hello.state).name if hello.state in set(State) else f"state {hello.state}",
        fault=hello.fault,
        fault_name=names.get(hello.fault, ""),
        simulated=hello.board == 0,
    )
