"""`edmctl reset`: clear the fault that a controller has latched."""

from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import PortOption, SetupOption, WaitOption, command
from edmctl.cli.outcome import Outcome, tell
from edmctl.cli.signals import shell
from edmctl.errors import PreconditionError

if TYPE_CHECKING:
    from edmctl.machine.controller import LinkMachine

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
