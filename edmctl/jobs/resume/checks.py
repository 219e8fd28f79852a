"""Whether the machine, its tool and its stages are those of an interrupted run; asked before anything moves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from edmctl.errors import PreconditionError, stages_by_hand
from edmctl.jobs.connected_machine import ConnectedMachine
from edmctl.jobs.plan import Plan, Resumption
from edmctl.record.journal import read_journal
from edmctl.record.ledger import JobBegun, Line, RunEnded, SiteMachined, ToolChanged
from edmctl.wording import coordinates

HOMED_WITHIN_UM = 2.0
"""The side gap of a hole leaves so much room to a tool that comes back into it."""


def refuse_untouchable(resumption: Resumption, plan: Plan) -> None:
    """Raise PreconditionError: E8054 the journal tells nothing of its channel, E8062 there is no hole to restart."""
    run_id, state = resumption.job.run_id, resumption.state
    is_channel = plan.loaded.profile.path is not None
    if is_channel and state.channel is None:
        raise PreconditionError(
            f"{run_id} machines a channel, and the edmctl that wrote its journal kept nothing of channels.",
            hint="Machine the channel anew on fresh work.",
            code="E8054",
        )
    if is_channel and resumption.restart_hole:
        raise PreconditionError(
            f"{run_id} machines a channel, and --restart-hole makes holes anew.",
            hint="Leave --restart-hole out; on fresh work, order the channel as a job of its own.",
            code="E8062",
        )
    if resumption.restart_hole and not resumption.state.begun:
        raise PreconditionError(
            f"{run_id} has begun no hole that could be made anew; the next one is machined from its face anyway.",
            hint="Leave --restart-hole out.",
            code="E8062",
        )


def refuse_elsewhere(resumption: Resumption, bench: ConnectedMachine, lines: Sequence[Line]) -> None:
    """Look at the connected machine, and at the ledger's `lines`, before anything moves.

    Raises PreconditionError: E8051 the run went on meanwhile, E8055 another machine, E8056 another tool, or one that
    was used since, E8057 nobody knows where the stages are. FaultLatched E8010 while a fault is held.
    """
    job, machine, virtual = resumption.job, bench.machine, bench.virtual
    serial = machine.identity.serial
    if serial != job.serial:
        raise PreconditionError(
            f"This is {serial}; {job.run_id} ran on {job.serial}, where its work is.",
            hint=f"Name that machine with --port (it was {job.port}).",
            code="E8055",
        )
    latched = machine.latched_fault()
    if latched is not None:
        raise latched
    try:
        same = read_journal(resumption.path).written_utc_s == resumption.journal.written_utc_s
    except FileNotFoundError:
        same = False
    if not same:
        raise PreconditionError(
            f"{job.run_id} went on while this command waited for the machine.",
            hint="Look at its result; if it was interrupted again, say the same command again.",
            code="E8051",
        )
    if virtual is not None and virtual.tool_label != resumption.state.tool:
        raise _other_tool(
            f"{virtual.tool_label} is in the machine; {job.run_id} had {resumption.state.tool}."
        )
    refuse_used_tool(resumption, lines)
    if virtual is None and machine.hello.boot_count != job.boots and not resumption.homed:
        raise _not_homed(resumption, bench)


def _other_tool(message: str) -> PreconditionError:
    return PreconditionError(
        message,
        hint="Only the tool that began a hole can tell its own wear by touching. "
        "Machine it at another place or on new work.",
        code="E8056",
    )


def refuse_used_tool(resumption: Resumption, lines: Iterable[Line]) -> None:
    """Look at what the ledger tells of the machine since the run began. Raises PreconditionError E8056."""
    tool, own, begun = resumption.state.tool, resumption.run_files, False
    lines = tuple(line for line in lines if line.serial == resumption.job.serial)
    for number, line in enumerate(lines):
        entry = line.entry
        if isinstance(entry, RunEnded):
            continue
        if isinstance(entry, JobBegun) and entry.run_file in own:
            begun = True
        elif not begun:
            continue
        elif isinstance(entry, ToolChanged) and entry.tool == tool:
            raise _other_tool(f"{tool} was changed for a new one since {resumption.job.run_id}.")
        elif entry.tool != tool:
            raise _other_tool(
                f"{entry.tool} was in the machine since {resumption.job.run_id}, and not {tool}."
            )
        elif isinstance(entry, JobBegun) and not _was_idle(entry.run_file, lines[number + 1 :]):
            raise _other_tool(f"{tool} has machined {entry.run_file} since {resumption.job.run_id} was left.")


def _was_idle(run_file: str, later: Sequence[Line]) -> bool:
    """Whether a job came to its end, refused or stopped, before it cut anywhere, by the lines after its begin."""
    for line in later:
        entry = line.entry
        if isinstance(entry, JobBegun | SiteMachined):
            return False
        if isinstance(entry, RunEnded):
            return entry.run_file == run_file
    return False


def _not_homed(resumption: Resumption, bench: ConnectedMachine) -> PreconditionError:
    status, journal = bench.machine.status(), resumption.journal
    here = f"{coordinates(status.x_um, status.y_um, 1)}, {status.theta_deg:g}°, within {HOMED_WITHIN_UM:g} µm"
    return PreconditionError(
        f"The controller was restarted since {journal.job.run_id}; the run was last seen at "
        f"{coordinates(journal.x_um, journal.y_um, 1)}.",
        hint=f"{stages_by_hand(here)} Then confirm that with --homed.",
        code="E8057",
    )
