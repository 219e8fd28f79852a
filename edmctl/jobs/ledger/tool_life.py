"""How much of a tool is left after earlier jobs: how far it reaches, and how much more it may lose."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic, EdmError, PreconditionError
from edmctl.jobs.resume.way_on import command_to_go_on, on_machine
from edmctl.wording import length

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from edmctl.profile.model import Profile
    from edmctl.profile.places import Place
    from edmctl.profile.setup import Setup
    from edmctl.record.tool_account import ToolAccount

NEAR_UM = 10.0
"""The first touch finds a surface that lies so far from where the recipe says: then nothing has to be told to it."""
_NEW = "Dress or change the tool, and say --new-tool for a new one."


def on_worn_tool(profile: Profile, account: ToolAccount) -> Profile:
    """Return the recipe with the gap at 0 V that the tool's last touch left, where that is another one."""
    moved_um = account.pad_um - profile.approach.offset_um
    if math.isnan(moved_um) or abs(moved_um) <= NEAR_UM:
        return profile
    approach = profile.approach.model_copy(
        update={
            "offset_um": account.pad_um,
            "max_travel_um": profile.approach.max_travel_um + moved_um,
        }
    )
    return profile.model_copy(update={"approach": approach})


def refuse_too_short(worn: Profile, setup: Setup, stroke_um: float, account: ToolAccount, port: str) -> None:
    """Raise PreconditionError E8044 where the actuator does not take the worn tool down by `stroke_um`."""
    from edmctl.forecasts.forecast import stroke_available_um

    available_um = stroke_available_um(worn, setup)
    if stroke_um > available_um:
        raise PreconditionError(
            f"{account.label} touches the pad at {length(account.pad_um)} by now; a stroke of {length(stroke_um)} "
            f"is needed then, and the actuator has {length(available_um)}.",
            hint=f"Set the tool lower and say `{on_machine('edmctl measure-wear --reference', port)}`, or change it "
            "and say --new-tool. Keep run files of another machine or of new work in another folder with --out.",
            code="E8044",
        )


def refuse_unknown_length(account: ToolAccount, folder: Path, port: str) -> None:
    """Raise PreconditionError E8048 where a job of the tool was killed, and nobody knows what it took off."""
    if not account.killed:
        return
    run_file = folder / account.killed[-1].run_file
    command = command_to_go_on(run_file)
    anew = f"touch the pad anew with `{on_machine('edmctl measure-wear --reference', port)}`."
    raise PreconditionError(
        f"How long the tool {account.label} is, nobody knows: {run_file} was killed while it machined.",
        hint=f"Finish it with `{command}`; to give it up, {anew}"
        if command
        else f"{anew[0].upper()}{anew[1:]}",
        code="E8048",
    )


def refuse_worn_out(
    profile: Profile, setup: Setup, places: Sequence[Place], account: ToolAccount
) -> list[Diagnostic]:
    """Return a warning where the tool will not last for the whole job.

    Raises PreconditionError E8043 where it will not last for one hole of it.
    """
    from edmctl.forecasts.forecast import forecast

    expected, limit_um = forecast(profile, setup, places), profile.tool.max_wear_um
    lost = f"{account.label} has lost {length(account.lost_um)} so far"
    if account.lost_um + expected.wear_um > limit_um:
        raise PreconditionError(
            f"{lost} and would lose {length(expected.wear_um)} more; tool.max_wear_um is {length(limit_um)}.",
            hint=_NEW,
            code="E8043",
        )
    if account.lost_um + expected.tool_wear_um > limit_um:
        message = (
            f"{lost}; the whole job takes {length(expected.tool_wear_um)}, of {length(limit_um)} in all."
        )
        hint = f"The job will stop in order before a hole that the tool cannot make. {_NEW}"
        return [Diagnostic("W8110", message, hint, is_warning=True)]
    return []


def left_to_finish(tool: str, serial: str, folder: Path) -> list[Diagnostic]:
    """Return a warning (W8115) of each job of the tool that could still be taken up, and not after another job."""
    from edmctl.record.journal import SUFFIX, read_journal

    warnings = []
    for journal in sorted(folder.glob(f"*{SUFFIX}")):
        run_file = journal.with_suffix(".h5")
        try:
            job = read_journal(journal).job
        except (EdmError, OSError):
            continue
        if (job.tool, job.serial) == (tool, serial) and (command := command_to_go_on(run_file)):
            message = f"{run_file} was interrupted and cannot be finished once {tool} has done another job."
            hint = f"Stop this job and finish that one first, with `{command}`."
            warnings.append(Diagnostic("W8115", message, hint, is_warning=True))
    return warnings
