"""Commands that look after what is connected: `edmctl doctor`, `edmctl ports` and `edmctl reset`.

They look one by one at everything that a job will need; tell which ports this computer has, who holds them, and who
answers there; and clear the fault that a controller has latched.
"""

import os
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import NOTES, PortOption, SetupOption, WaitOption, command
from edmctl.cli.outcome import Outcome, stream_style, tell
from edmctl.cli.signals import shell
from edmctl.errors import PreconditionError

if TYPE_CHECKING:
    from edmctl.errors import EdmError
    from edmctl.jobs.doctor_host import Checks
    from edmctl.link.messages import HelloReply
    from edmctl.link.ports import PortInfo
    from edmctl.link.probing import ProbedPort
    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.setup import Setup
    from edmctl.results.equipment import Controller, PortRow

OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the run files.")]
SensorsOption = Annotated[
    bool,
    typer.Option(
        "--sensors", help="Also arm, make pulses with the tool retracted to test the gap sensor, and disarm."
    ),
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
    """Check computer, line and machine, and name the remedies.

    Nothing moves, but with --sensors.
    """
    from edmctl.console.procedure_tables import render_checks
    from edmctl.jobs.doctor_host import Checks

    checks = Checks()
    error = None
    try:
        error = _look(outcome, checks, setup, (port, wait), out, sensors=sensors)
    finally:
        outcome.result = {"checks": checks.as_list()}
        outcome.text = render_checks(checks.done, stream_style(sys.stdout))
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
    """Do every check that can be done; the error of the line or the protocol, if that is what fails."""
    from edmctl.errors import EdmError, Interrupted, LinkLost, ProtocolMismatch
    from edmctl.jobs import doctor_host as doctor_host
    from edmctl.jobs import doctor_machine as doctor_machine
    from edmctl.jobs.connect import machine_at

    say = partial(tell, outcome.output)
    port, wait_s = place
    checks.add(doctor_host.versions())
    checks.add(doctor_host.run_folder(out))
    setup = doctor_host.load(checks, setup_file)
    selector = port or setup.port
    checks.add(*doctor_host.line_settings(selector))
    try:
        with machine_at(setup, port, wait_s, say, shell()) as machine:
            outcome.simulated = machine.identity.simulated
            doctor_machine.look(checks, machine, setup)
            checks.add(doctor_host.calibration(os.environ, setup, machine.identity.serial, port or ""))
            if sensors:
                say("doctor: arming, and making pulses with the tool retracted, for about a second.")
                doctor_machine.test_sensors(checks, machine, setup)
    except ProtocolMismatch as error:
        checks.fail("protocol", error)
        return error
    except Interrupted:
        raise
    except EdmError as error:
        checks.fail("port", error)
        return error if isinstance(error, LinkLost) else None
    return None


ProbeOption = Annotated[
    bool,
    typer.Option("--probe", help="Ask the controllers at the ports that `auto` would ask who they are."),
]


@command("ports")
def ports(outcome: Outcome, setup: SetupOption = None, probe: ProbeOption = False) -> None:
    """List serial ports, those of the setup, and virtual ones.

    Nothing is opened but with --probe, and then only ports of known USB ids, those that the setup names, and
    those that `edmctl simulate serve` serves.
    """
    from edmctl.console.procedure_tables import render_ports
    from edmctl.profile.setup import load_setup

    rows = port_rows(load_setup(setup), probe=probe)
    outcome.result = {"ports": rows}
    outcome.text = render_ports(rows, stream_style(sys.stdout))


def port_rows(setup: "Setup", *, probe: bool) -> "list[PortRow]":
    """Look at every port that is listed or named in the setup; with `probe` ask those that may be asked."""
    from edmctl.jobs.connect import asks_for_secret, secret_of
    from edmctl.jobs.served_controllers import served_ports
    from edmctl.link import ports as link_ports
    from edmctl.link import probing

    link = setup.link
    named = _named(setup)
    known = link_ports.probable_ports(link.usb_ids, named)
    served = [
        port
        for port in served_ports(shell().environ)
        if not any(link_ports.same_port(port.device, k.device) for k in known)
    ]
    every_known = [*known, *served]
    may_ask = probe and asks_for_secret(*(port.device for port in every_known))
    secret = secret_of(link.secret_file, shell().environ) if may_ask else b""
    asked = probing.probe(every_known, link.baud, link.hello_s, secret) if probe else []
    answers = {answer.port.device: answer for answer in asked}
    devices = {port.device for port in known}
    listed = link_ports.listed_ports()
    here = {port.device for port in listed}
    every = [*listed, *(port for port in (*known, *served) if port.device not in here)]
    return [_row(port, named, port.device in devices, answers.get(port.device)) for port in every]


def _named(setup: "Setup") -> tuple[str, ...]:
    """The ports that the setup names; a selector such as `auto` or `serial:ID` names none."""
    port = setup.port or ""
    is_port = "://" in port or not (port == "auto" or port.startswith(("sim", "serial:")))
    mine = (port,) if port and is_port else ()
    return tuple(dict.fromkeys((*mine, *setup.link.candidates)))


def _row(port: "PortInfo", named: tuple[str, ...], known: bool, answer: "ProbedPort | None") -> "PortRow":
    from edmctl.link.ports import port_owner, same_port
    from edmctl.results.equipment import PortRow

    return PortRow(
        device=port.device,
        description=port.description,
        usb_id=port.usb_id,
        usb_serial=port.usb_serial,
        held_by=port_owner(Path(port.device)),
        in_setup=any(same_port(name, port.device) for name in named),
        known=known,
        controller=_controller(answer.hello) if answer and answer.hello else None,
        error=answer.error if answer and not answer.hello else None,
    )


def _controller(hello: "HelloReply") -> "Controller":
    from edmctl.link.faults import FAULTS
    from edmctl.link.messages import State
    from edmctl.results.equipment import Controller

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


AckOption = Annotated[
    int | None,
    typer.Option("--ack", metavar="CODE", help="The fault to clear. Default: show it only."),
]


@command("reset")
def reset(
    outcome: Outcome,
    ack: AckOption = None,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
) -> None:
    """Clear the latched fault, or tell which one it is.

    The fault must be named, so that nobody clears another one than the one that was looked at.
    """
    from edmctl.jobs.connect import machine_at
    from edmctl.jobs.plan import where_is
    from edmctl.profile.setup import load_setup

    settings = load_setup(setup)
    where = where_is(port, settings)
    lasting = where.lasting
    if (file := where.bench_file) is not None and not file.exists():
        raise PreconditionError(
            f"There is no bench {file}, and a new one holds no fault.",
            hint="Name the machine that holds the fault with --port or EDMCTL_PORT.",
            code="E8013",
        )
    with machine_at(settings, port, wait, partial(tell, outcome.output), shell()) as machine:
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
