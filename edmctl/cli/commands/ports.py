"""`edmctl ports`: which ports this computer has, who holds them, and who answers there."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import SetupOption, command
from edmctl.cli.outcome import Outcome
from edmctl.cli.signals import shell
from edmctl.files import lock_holder

if TYPE_CHECKING:
    from edmctl.link.messages import HelloReply
    from edmctl.link.ports import PortInfo
    from edmctl.link.probing import ProbedPort
    from edmctl.profile.setup import Setup
    from edmctl.results.equipment import Controller, PortRow

ProbeOption = Annotated[
    bool,
    typer.Option("--probe", help="Identify the controllers at the ports that `auto` would try."),
]


@command("ports")
def ports(outcome: Outcome, setup: SetupOption = None, probe: ProbeOption = False) -> None:
    """List serial ports, those of the setup, and virtual ones.

    No port is opened without --probe. It opens ports with known USB ids, those that the setup names, and those of
    `edmctl simulate serve`.
    """
    from edmctl.cli.render.procedure_tables import render_ports
    from edmctl.profile.setup import load_setup

    rows = port_rows(load_setup(setup), probe=probe)
    outcome.result = {"ports": rows}
    outcome.show(lambda style: render_ports(rows, style))


def port_rows(setup: "Setup", *, probe: bool) -> "list[PortRow]":
    """Look at every port that is listed or named in the setup; with `probe` ask those that may be asked."""
    from edmctl.jobs.connect import asks_for_secret, secret_of, served_ports
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
    from edmctl.link.ports import same_port
    from edmctl.results.equipment import PortRow

    return PortRow(
        device=port.device,
        description=port.description,
        usb_id=port.usb_id,
        usb_serial=port.usb_serial,
        held_by=lock_holder(Path(port.device)),
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
