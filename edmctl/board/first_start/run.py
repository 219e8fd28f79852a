"""What `edmctl first-start` does, from connecting to the report."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime

from edmctl import failures
from edmctl.board.first_start import actuator, cold, generator, nets, stages
from edmctl.board.first_start.checklist import (
    Cause,
    Checklist,
    FirstStartReport,
    Item,
    ItemStatus,
    cause,
)
from edmctl.board.first_start.person import Person, VirtualHands
from edmctl.errors import EdmError, LinkLost, MachineFault
from edmctl.jobs.connect import connected
from edmctl.jobs.plan import MachineAddress
from edmctl.jobs.surroundings import Surroundings
from edmctl.link.faults import FaultCode
from edmctl.machine.controller import LinkMachine
from edmctl.profile.setup import Setup

PARTS = (cold.PART, stages.PART, actuator.PART, generator.PART)


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
        ask = operator.ask
        if bench.virtual is not None:
            say(
                "first-start: this program acts at the virtual machine and observes it, unless answers say so"
            )
            ask = VirtualHands(bench.virtual, operator).ask
        checklist = Checklist(machine, setup, ask, show, say, causes_of)
        try:
            checklist.run_all(PARTS)
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
    count = len(report.items)
    if failed := report.titles(ItemStatus.FAIL):
        return failures.items_failed(failed_count=len(failed), items_count=count, failed=", ".join(failed))
    if skipped := report.titles(ItemStatus.SKIPPED):
        return failures.items_skipped(
            skipped_count=len(skipped), items_count=count, skipped=", ".join(skipped)
        )
    return None


_CAUSES = {
    FaultCode.ESTOP: cause("e-stop came without being pressed: a loose contact, or noise", nets.ESTOP),
    FaultCode.DOOR: cause("door came without being opened: a loose contact, or noise", nets.DOOR),
    FaultCode.HV_SUPPLY: cause(
        "the supply does not hold, its input is loose, or the mode switch is not where it is set (its guard)",
        nets.SUPPLY_OK,
        nets.MODE,
    ),
    FaultCode.DIELECTRIC: cause("the dielectric does not hold", nets.LEVEL, nets.FLOW, nets.TEMPERATURE),
    FaultCode.PIEZO_TRACK: cause("actuator monitor does not follow the command", nets.MONITOR, nets.DAC),
    FaultCode.PIEZO_OV: cause("actuator monitor is out of its range", nets.MONITOR),
    FaultCode.COLLISION: cause("the contact closed while the tool moved in the air", nets.CONTACT),
    FaultCode.STUCK_CONTACT: cause("the contact is closed in the air", nets.CONTACT),
    FaultCode.GAP_SENSOR: cause(
        "gap voltage and generator do not agree, and the sensor reads a battery right: gate, mode switch or enable",
        nets.GATE,
        nets.MODE,
        nets.ALIVE,
    ),
    FaultCode.NO_SPARK: cause(
        "no pulse comes: the wire from gate to driver is off, or the driver has no supply", nets.GATE
    ),
    FaultCode.GEN_FAULT: cause(
        "current where there is none, or pulses with the gate off: current sensor's offset or sign, gate, chain",
        nets.CURRENT,
        nets.GATE,
        nets.BREAK,
    ),
    FaultCode.MODE_SWITCH: cause(
        "the driver switches though its gate is off: noise on the gate's wire, no pull-down, or on the sense wire",
        nets.GATE,
        nets.GATE_SENSE,
    ),
    FaultCode.STAGE_LIMIT: cause("a limit switch is closed: on the way, or wired wrongly", nets.LIMITS),
    FaultCode.SHORT_STUCK: cause("tool and workpiece are connected", nets.GAP),
    FaultCode.HOST_SILENT: cause("this program was not heard: the line, or a busy computer", nets.LINE),
}


def causes_of(error: EdmError) -> tuple[Cause, ...]:
    """Return the likely mistakes behind an error of machine or host during an item."""
    if isinstance(error, LinkLost):
        text = "the line broke, or the board restarted: its supply, its plug, or noise"
        return (cause(text, nets.LINE, "5 V"),)
    if isinstance(error, MachineFault) and error.fault in _CAUSES:
        return (_CAUSES[FaultCode(error.fault)],)
    return (cause(f"not one of the usual mistakes: {error.hint or error.message}"),)
