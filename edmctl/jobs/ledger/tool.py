"""The machine's identity and tool, and the account of that tool by the ledger."""

from __future__ import annotations

import json
import math
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, EdmError, RunFileError
from edmctl.jobs.connected_machine import CALENDAR, ConnectedMachine, Now
from edmctl.jobs.plan import MachineAddress, Plan
from edmctl.jobs.runs.opening import command_to_go_on, on_machine
from edmctl.planning.forecast import forecast, stroke_available_um
from edmctl.profile.model import Profile, Tool
from edmctl.profile.read import Merged, apply_overrides, put
from edmctl.profile.setup import Setup
from edmctl.record.journal import SUFFIX, read_journal
from edmctl.record.ledger import Ledger, MachineHistory, ReferenceTouched, ToolAccount, ToolNamed, history_of
from edmctl.wording import coordinates, length

if TYPE_CHECKING:
    from edmctl.simulator.bench import VirtualBench

_LABEL = re.compile(r"(?P<material>.+) (?P<um>\d+(?:\.\d+)?) µm")
NAMELESS = "tool"
"""Label of a tool without a name: on a virtual bench before its first profile, or with an empty ledger."""


@dataclass(frozen=True, slots=True)
class ToolIdentity:
    """Serial number, present time and tool of a machine; "" and NaN if only a virtual bench would know.

    `is_new`: the virtual bench was made by this command.
    """

    serial: str
    now: Now = CALENDAR
    tool: str = ""
    diameter_um: float = math.nan
    is_new: bool = False


def tool_identity(bench: ConnectedMachine) -> ToolIdentity:
    """Return the identity of a connected machine."""
    if bench.virtual is None:
        return ToolIdentity(bench.serial)
    return replace(_identity_of(bench.virtual), is_new=bench.seed is not None)


def tool_identity_in_file(where: MachineAddress) -> ToolIdentity | None:
    """Return the identity in the file of a virtual bench; None without a file.

    Raises RunFileError as `read_bench`, and E9024 if the folder does not exist.
    """
    file = where.bench_file
    if file is None:
        return None
    from edmctl.record.bench_file import read_bench, refuse_place
    from edmctl.simulator.saving import restored_bench

    refuse_place(file)
    if not file.exists():
        return None
    return _identity_of(restored_bench(read_bench(file)))


def _identity_of(bench: VirtualBench) -> ToolIdentity:
    now = Now(bench.transport.now_s())
    return ToolIdentity(bench.plant.serial, now, bench.tool_label, bench.plant.config.tool_diameter_um)


def not_seen(where: MachineAddress) -> str:
    """Return the note of a dry run about a machine that is not connected."""
    return (
        "job ledger, bench and the machine's own setup were not looked at: the serial number of "
        f"{where.selector} is known only once it is connected"
    )


def is_unnamed(label: str, diameter_um: float, tool: Tool) -> bool:
    """Whether the tool of that label that is in the machine may be `tool`, and has only not been named yet."""
    return label == NAMELESS and diameter_um == tool.diameter_um


def account_of(plan: Plan, identity: ToolIdentity, history: MachineHistory) -> ToolAccount:
    """Return the account of the profile's tool, which may be the unnamed tool in the machine.

    If no profile was named it is the account of the tool on a virtual bench, or of the tool last in use.
    """
    tool, label = plan.loaded.profile.tool, plan.loaded.profile.tool.label
    if not plan.names_tool and plan.resumed is None:
        label = (identity.tool if plan.where.lasting else "") or history.tool or NAMELESS
    if plan.new_tool:
        return ToolAccount(label)
    account = history.account(label)
    if (
        label == tool.label
        and account.reference is None
        and is_unnamed(identity.tool, identity.diameter_um, tool)
    ):
        return replace(history.account(NAMELESS), label=tool.label)
    return account


def diameter_of(label: str, identity: ToolIdentity) -> float:
    """Return the diameter of the tool with that label in the machine, µm; NaN if it is unknown."""
    named = _LABEL.fullmatch(label)
    return float(named["um"]) if named else identity.diameter_um


def as_found(plan: Plan, bench: ConnectedMachine, ledger: Ledger | None, command: str) -> Plan:
    """Return the plan for the run file: without a named profile it has the command's name and the machine's tool."""
    if plan.names_tool or plan.resumed is not None:
        return plan
    identity, profile = tool_identity(bench), plan.loaded.profile
    last = history_of(ledger.lines, identity.serial).tool if ledger is not None else ""
    label = identity.tool or last or NAMELESS
    named, diameter_um = _LABEL.fullmatch(label), diameter_of(label, identity)
    tool = {"id": label, "material": named["material"] if named else "?", "diameter_um": diameter_um}
    if plan.recipe_of and profile.tool.label == label:
        tool = {}
    found = profile.model_copy(
        update={
            "meta": profile.meta.model_copy(update={"name": command, "description": ""}),
            "tool": profile.tool.model_copy(update=tool),
        }
    )
    return replace(plan, loaded=replace(plan.loaded, profile=found))


def other_tool(plan: Plan, account: ToolAccount, history: MachineHistory) -> list[Diagnostic]:
    """Return a warning if the last reference touch is of another tool."""
    unnamed = history.account(NAMELESS).reference
    if unnamed is None or history.tool != NAMELESS or account.reference is not None:
        return []
    label = plan.loaded.profile.tool.label
    return [failures.reference_without_profile(run_file=unnamed.run_file, label=label)]


def reference_command(plan: Plan) -> str:
    """Return the command that repeats the reference touch with the tool and the setup of the plan."""
    command, profile = ["edmctl", "measure-wear", "--reference"], plan.request.profile
    if profile and plan.names_tool:
        command += ["--profile", profile]
    if plan.setup.file is not None:
        command += ["--setup", str(plan.setup.file)]
    return on_machine(shlex.join(command), plan.where.selector)


def name_tool(plan: Plan, bench: ConnectedMachine, ledger: Ledger | None) -> None:
    """Write into the ledger that the unnamed tool in the machine is the profile's.

    Raises RunFileError if that fails.
    """
    if ledger is None or plan.new_tool or not plan.names_tool:
        return
    identity, tool = tool_identity(bench), plan.loaded.profile.tool
    history = history_of(ledger.lines, identity.serial)
    if history.account(tool.label).reference is not None or history.account(NAMELESS).reference is None:
        return
    if is_unnamed(identity.tool, identity.diameter_um, tool):
        ledger.append(identity.serial, ToolNamed(tool.label, NAMELESS))


def reference_setup(setup: Setup) -> dict[str, Any]:
    """Return the setup values that a reference entry contains."""
    stage = setup.stage
    return {
        "sensor": setup.sensor.fitted,
        "x_um": stage.reference_x_um,
        "y_um": stage.reference_y_um,
        "park_x_um": stage.park_x_um,
        "park_y_um": stage.park_y_um,
        "setup_sha256": setup.sha256,
    }


def setup_differences(reference: ReferenceTouched | None, setup: Setup) -> list[str]:
    """Return the differences from the setup of the reference touch; unknown places do not count."""
    if reference is None:
        return []
    stage = setup.stage
    places = (
        ("the reference pad", reference.x_um, reference.y_um, stage.reference_x_um, stage.reference_y_um),
        ("the parking place", reference.park_x_um, reference.park_y_um, stage.park_x_um, stage.park_y_um),
    )
    found = [
        f"{name} was at {coordinates(x_um, y_um)} and is at {coordinates(now_x_um, now_y_um)}"
        for name, x_um, y_um, now_x_um, now_y_um in places
        if math.hypot(now_x_um - x_um, now_y_um - y_um) > stage.repeatability_um
    ]
    if reference.sensor != setup.sensor.fitted:
        was = "with" if reference.sensor else "without"
        found.append(f"it was read {was} a displacement sensor (sensor.fitted)")
    return found


def refuse_other_setup(account: ToolAccount, history: MachineHistory, plan: Plan, folder: Path) -> None:
    """Raise PreconditionError E8059 if the tool's reference, or the machine's last one, has another setup."""
    for reference in (account.reference, history.reference):
        if reference is not None and (differences := setup_differences(reference, plan.setup)):
            raise failures.reference_under_other_setup(
                tool=reference.tool,
                folder=folder / reference.run_file,
                words=plan.setup.in_words(),
                differences=", and ".join(differences),
                reference_command=reference_command(plan),
            )


NEAR_UM = 10.0
"""The first touch finds a surface within this distance of the recipe's value."""
_NEW = "Dress or change the tool, and say --new-tool for a new one."


def on_worn_tool(profile: Profile, account: ToolAccount) -> Profile:
    """Return the recipe with the gap at 0 V after the tool's last touch, if it differs."""
    moved_um = account.pad_um - profile.approach.offset_um
    if math.isnan(moved_um) or abs(moved_um) <= NEAR_UM:
        return profile
    travel_um = profile.approach.max_travel_um + moved_um
    worn = {"offset_um": account.pad_um, "max_travel_um": travel_um}
    return profile.model_copy(update={"approach": profile.approach.model_copy(update=worn)})


def refuse_too_short(worn: Profile, setup: Setup, stroke_um: float, account: ToolAccount, plan: Plan) -> None:
    """Raise PreconditionError E8044 if the stroke of the actuator is less than `stroke_um` with the worn tool."""
    available_um = stroke_available_um(worn, setup)
    if stroke_um > available_um:
        hint = (
            f"Set the tool lower and run `{reference_command(plan)}`, or change it and add --new-tool. "
            "Keep run files of another machine or of new work in another folder with --out."
        )
        raise failures.stroke_used_up(
            label=account.label,
            pad_um=length(account.pad_um),
            stroke_um=length(stroke_um),
            available_um=length(available_um),
            remedy=_remedy(plan, account, hint),
        )


def _remedy(plan: Plan, account: ToolAccount, hint: str) -> str:
    """Return `hint`; on a bench that this command makes, the remedy for an account of an earlier bench."""
    if plan.where.seed_of(0) is None or (math.isnan(account.pad_um) and not account.lost_um):
        return hint
    return "The bench is new: keep its runs in another folder with --out, or give it another --seed."


def refuse_unknown_length(account: ToolAccount, folder: Path, plan: Plan) -> None:
    """Raise PreconditionError E8048 if a job of the tool was killed, so that its length is unknown."""
    if not account.killed:
        return
    run_file = folder / account.killed[-1].run_file
    command = command_to_go_on(run_file)
    anew = f"touch the pad anew with `{reference_command(plan)}`."
    remedy = (
        f"Finish it with `{command}`; to give it up, {anew}" if command else f"{anew[0].upper()}{anew[1:]}"
    )
    raise failures.tool_length_unknown(label=account.label, stem=run_file.stem, remedy=remedy)


def refuse_worn_out(profile: Profile, setup: Setup, plan: Plan, account: ToolAccount) -> list[Diagnostic]:
    """Return a warning if the tool will not last for the whole job.

    Raises PreconditionError E8043 if it will not last for one hole.
    """
    expected, limit_um = forecast(profile, setup, plan.loaded.places), profile.tool.max_wear_um
    lost = f"{account.label} has lost {length(account.lost_um)} so far"
    limit, remedy = length(limit_um), _remedy(plan, account, _NEW)
    if account.lost_um + expected.wear_um > limit_um:
        one = length(expected.wear_um)
        raise failures.tool_worn_out(lost=lost, wear_um=one, limit_um=limit, remedy=remedy)
    if account.lost_um + expected.tool_wear_um > limit_um:
        whole = length(expected.tool_wear_um)
        return [failures.tool_will_wear_out(lost=lost, tool_wear_um=whole, limit_um=limit, plan=remedy)]
    return []


def left_to_finish(tool: str, serial: str, folder: Path) -> list[Diagnostic]:
    """Return a warning (W8115) of each job of the tool that has cut and could not be resumed after another job."""
    warnings = []
    for journal in sorted(folder.glob(f"*{SUFFIX}")):
        run_file = journal.with_suffix(".h5")
        try:
            interrupted = read_journal(journal)
        except (EdmError, OSError):
            continue
        job, has_cut = interrupted.job, interrupted.state.get("begun") or interrupted.state.get("done")
        if has_cut and (job.tool, job.serial) == (tool, serial) and (command := command_to_go_on(run_file)):
            warnings.append(failures.interrupted_run_of_tool(run_file=run_file, tool=tool, command=command))
    return warnings


_LISTS = ("sites", "regimes")
"""Run files keep lists as JSON."""


def last_run_of(account: ToolAccount) -> str:
    """Return the file of the last run with the tool: of its last hole, else of its reference; empty without any."""
    if account.holes:
        return account.holes[-1].run_file
    return account.reference.run_file if account.reference is not None else ""


def with_recipe_of(plan: Plan, folder: Path, run_file: str) -> Plan:
    """Return the plan with the recipe of the run in that file, and `--set` on top, if no profile was named.

    Raises PreconditionError E8063 if the recipe cannot be read, RunFileError E9016 if another program has its file.
    """
    from edmctl.record.reader import present_name, reading

    if plan.names_tool or not run_file:
        return plan
    path = present_name(folder / run_file)
    try:
        with reading(path, verify=False) as run:
            values, text = run.profile_values(), run.text("/entry/profile/toml")
            sha256 = run.text("/entry/profile/recipe_sha256")
        table: dict[str, object] = {}
        for key, value in values.items():
            if not key.startswith("sim.") and not key.endswith("_units"):
                table = put(table, tuple(key.split(".")), json.loads(str(value)) if key in _LISTS else value)
        profile = Profile.model_validate(apply_overrides(Merged((), table, ()), plan.request.overrides).table)
    except (RunFileError, ValueError) as error:
        if isinstance(error, RunFileError) and error.code == "E9016":
            raise
        why = (
            error.message if isinstance(error, RunFileError) else "its values are not those of this version."
        )
        raise failures.recipe_of_tool_unreadable(path=path, why=why) from error
    loaded = replace(plan.loaded, profile=profile, text=text, sha256=sha256)
    return replace(plan, loaded=loaded, recipe_of=str(path))
