"""The checklist from connecting to the report: what `edmctl first-start` does."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

from edmctl import failures
from edmctl.board.first_start import actuator, cold, generator, nets, stages
from edmctl.board.first_start.checklist import Checklist
from edmctl.board.first_start.hands import VirtualHands, written_hands
from edmctl.board.first_start.nets import cause
from edmctl.board.first_start.person import Asked, Person
from edmctl.board.results import Cause, FirstStartReport, Item, ItemStatus
from edmctl.errors import EdmError, LinkLost, MachineFault
from edmctl.jobs.connect import connected
from edmctl.jobs.plan import MachineAddress
from edmctl.jobs.surroundings import Surroundings
from edmctl.link.faults import FaultCode
from edmctl.link.messages import Clock
from edmctl.machine.controller import LinkMachine
from edmctl.profile.setup import Setup


def first_start(
    setup: Setup,
    where: MachineAddress,
    seed: int,
    person: Callable[[LinkMachine], Asked],
    acts: Path | None,
    tell: Callable[[Item], None],
    say: Callable[[str], None],
    surroundings: Surroundings,
) -> tuple[FirstStartReport, EdmError | None]:
    """Go through the checklist on a machine; the report, and the error that ended it early.

    person : who does and answers, of a machine that is connected; at a virtual machine its hands and eyes are the
    program's. acts : the file by which those of a served virtual machine act.

    Raises what connecting raises. Whatever happens later, the machine is left with everything off.
    """
    started = datetime.now(UTC).isoformat(timespec="seconds")
    error: EdmError | None = None
    with ExitStack() as held:
        bench = held.enter_context(connected(None, setup, seed, say, where, surroundings, wires_known=False))
        bench.begin()
        if bench.own_setup is not None:
            setup = bench.own_setup
        say(f"first-start: {setup.in_words()}")
        machine, asked = bench.machine, person(bench.machine)
        stands: Person = asked
        if bench.virtual is not None:
            say(
                "first-start: hands and eyes at the virtual machine are this program's, but where answers tell"
            )
            stands = VirtualHands(bench.virtual, asked)
        elif acts is not None:
            if not machine.identity.simulated and machine.hello.clock != Clock.DRIVEN:
                raise failures.acts_with_real_machine()
            stands = written_hands(acts, asked)
        checklist = Checklist(machine, setup, stands, tell, say, cause_of)
        try:
            if cold.look(checklist):
                stages.look(checklist)
                actuator.look(checklist)
                generator.look(checklist)
        except EdmError as ended:
            error = ended
        finally:
            machine.safe_stop()
        name = (
            f"{machine.identity.serial} at {machine.identity.transport}, firmware {machine.identity.firmware}"
        )
        items = tuple(checklist.items)
        complete = error is None and all(item.is_right for item in items)
        absent = tuple(item.key for item in items if item.status is ItemStatus.ABSENT)
        ended_by = error.message if error else ""
        return FirstStartReport(
            name, machine.identity.simulated, started, items, complete, absent, ended_by
        ), error


def verdict(report: FirstStartReport) -> EdmError | None:
    """Return the error of a checklist that came to its end: what failed, else what was skipped, else none."""
    failed = [item.title for item in report.items if item.status is ItemStatus.FAIL]
    if failed:
        return failures.items_failed(
            failed_count=len(failed), items_count=len(report.items), failed=", ".join(failed)
        )
    skipped = [item.title for item in report.items if item.status is ItemStatus.SKIPPED]
    if skipped:
        return failures.items_skipped(
            skipped_count=len(skipped), items_count=len(report.items), skipped=", ".join(skipped)
        )
    return None


def cause_of(error: EdmError) -> tuple[Cause, ...]:
    """Return the likely mistakes behind an error that the machine, or the host, has raised in an item."""
    if isinstance(error, LinkLost):
        return (
            cause("the line broke, or the board restarted: its supply, its plug, or noise", nets.LINE, "5 V"),
        )
    code = error.fault if isinstance(error, MachineFault) else 0
    by_fault = {
        FaultCode.ESTOP: cause("e-stop came while nobody pressed it: a loose contact, or noise", nets.ESTOP),
        FaultCode.DOOR: cause("door came while nobody opened it: a loose contact, or noise", nets.DOOR),
        FaultCode.HV_SUPPLY: cause(
            "the supply does not hold, its input is loose, or the guard of the mode switch: it does not go where "
            "it is told",
            nets.SUPPLY_OK,
            nets.MODE,
        ),
        FaultCode.DIELECTRIC: cause("the dielectric does not hold", nets.LEVEL, nets.FLOW, nets.TEMPERATURE),
        FaultCode.PIEZO_TRACK: cause("actuator monitor does not follow the command", nets.MONITOR, nets.DAC),
        FaultCode.PIEZO_OV: cause("actuator monitor is out of its range", nets.MONITOR),
        FaultCode.COLLISION: cause("the contact closed while the tool moved in the air", nets.CONTACT),
        FaultCode.STUCK_CONTACT: cause("the contact is closed in the air", nets.CONTACT),
        FaultCode.GAP_SENSOR: cause(
            "gap voltage and generator do not agree, and the sensor reads a battery right: gate, mode switch or "
            "enable of the high voltage",
            nets.GATE,
            nets.MODE,
            nets.ALIVE,
        ),
        FaultCode.NO_SPARK: cause(
            "no pulse comes: the wire from gate to driver is off, or the driver has no supply", nets.GATE
        ),
        FaultCode.GEN_FAULT: cause(
            "current where there is none, or pulses while the gate is off: the current sensor's offset or sign, the "
            "gate, or the break chain",
            nets.CURRENT,
            nets.GATE,
            nets.BREAK,
        ),
        FaultCode.MODE_SWITCH: cause(
            "the driver switches though its gate is off: noise on the gate's wire, no pull-down, or edges that the "
            "sense wire picks up",
            nets.GATE,
            nets.GATE_SENSE,
        ),
        FaultCode.STAGE_LIMIT: cause("a limit switch is closed: on the way, or wired wrongly", nets.LIMITS),
        FaultCode.SHORT_STUCK: cause("tool and work are connected", nets.GAP),
        FaultCode.HOST_SILENT: cause("this program was not heard: the line, or a busy computer", nets.LINE),
    }
    if code in by_fault:
        return (by_fault[FaultCode(code)],)
    return (cause(f"not one of the usual mistakes: {error.hint or error.message}"),)
