"""What `edmctl first-start` does, from connecting to the report."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime

from edmctl import failures
from edmctl.board.first_start import actuator, cold, generator, stages  # noqa: F401  # declare the checks
from edmctl.board.first_start.checklist import Checklist, FirstStartReport, Item, ItemStatus, Person
from edmctl.board.first_start.person import VirtualHands
from edmctl.errors import EdmError
from edmctl.jobs.connect import connected
from edmctl.jobs.plan import MachineAddress
from edmctl.jobs.surroundings import Surroundings
from edmctl.machine.controller import LinkMachine
from edmctl.profile.setup import Setup


def first_start(
    setup: Setup,
    where: MachineAddress,
    seed: int,
    person: Callable[[LinkMachine], Person],
    show: Callable[[Item], None],
    say: Callable[[str], None],
    surroundings: Surroundings,
) -> tuple[FirstStartReport, EdmError | None]:
    """Go through the checklist; return the report, and the error that ended it early.

    person : makes the one who answers, of the connected machine. At a virtual machine in this process the program
    acts and observes.

    Raises what connecting raises. Whatever happens later, everything on the machine is switched off.
    """
    started = datetime.now(UTC).isoformat(timespec="seconds")
    error: EdmError | None = None
    with ExitStack() as held:
        bench = held.enter_context(connected(None, setup, seed, say, where, surroundings, wires_known=False))
        bench.begin()
        setup = bench.own_setup or setup
        say(f"first-start: {setup.in_words()}")
        machine = bench.machine
        operator = person(machine)
        if bench.virtual is not None:
            say(
                "first-start: this program acts at the virtual machine and observes it, unless answers say so"
            )
            operator = VirtualHands(bench.virtual, operator)
        checklist = Checklist(machine, setup, operator, show, say)
        try:
            checklist.run()
        except EdmError as ended:
            error = ended
        finally:
            machine.safe_stop()
        identity, items = machine.identity, tuple(checklist.items)
        report = FirstStartReport(
            f"{identity.serial} at {identity.transport}, firmware {identity.firmware}",
            identity.simulated,
            started,
            items,
            complete=error is None and all(item.is_right for item in items),
            absent=tuple(item.key for item in items if item.status is ItemStatus.ABSENT),
            ended=error.message if error else "",
        )
        return report, error


def verdict(report: FirstStartReport) -> EdmError | None:
    """Return the error of a complete checklist with failed or, else, skipped items; None if all is right."""
    endings = {ItemStatus.FAIL: failures.items_failed, ItemStatus.SKIPPED: failures.items_skipped}
    for status, failure in endings.items():
        if titles := [item.title for item in report.items if item.status is status]:
            return failure(count=len(titles), items=len(report.items), titles=", ".join(titles))
    return None
