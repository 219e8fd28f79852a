"""The tool in a machine by the job ledger: its identity and account, the recipe of its last run, and refusals."""

from __future__ import annotations

import json
import math
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.dataclasses import dataclass, field, replace
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
NEAR_UM = 10.0
"""The first touch finds a surface within this distance of the recipe's value."""
_LISTS = ("sites", "regimes")
"""Run files keep lists as JSON."""


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
    """Return the identity in the file of a virtual bench; None without a file."""
    file = where.bench_file
    if file is None:
        return None
    from edmctl.record.bench_file import read_bench, refuse_place
    from edmctl.simulator.saving import restored_bench

    refuse_place(file)
    return _identity_of(restored_bench(read_bench(file))) if file.exists() else None


def _identity_of(bench: VirtualBench) -> ToolIdentity:
    now = Now(bench.transport.now_s())
    return ToolIdentity(bench.plant.serial, now, bench.tool_label, bench.plant.config.tool_diameter_um)


def is_unnamed(label: str, diameter_um: float, tool: Tool) -> bool:
    """Whether the tool of that label that is in the machine may be `tool`, and has only not been named yet."""
    return label == NAMELESS and diameter_um == tool.diameter_um


@dataclass(slots=True)
class MachineTool:
    """The tool in the machine of a plan, by the job ledger.

    `account` is that of the profile's tool, which may be the unnamed tool in the machine. If no profile was named it
    is that of the tool on a virtual bench, or of the tool last in use.
    """

    plan: Plan
    identity: ToolIdentity
    ledger: Ledger | None
    history: MachineHistory = field(init=False)
    account: ToolAccount = field(init=False)

    def __post_init__(self) -> None:
        plan, identity = self.plan, self.identity
        self.history = history_of(self.ledger.lines if self.ledger else (), identity.serial)
        tool = plan.loaded.profile.tool
        label = tool.label
        if not plan.names_tool and plan.resumed is None:
            label = (identity.tool if plan.where.lasting else "") or self.history.tool or NAMELESS
        self.account = ToolAccount(label) if plan.new_tool else self.history.account(label)
        is_unknown = label == tool.label and self.account.reference is None and not plan.new_tool
        if is_unknown and is_unnamed(identity.tool, identity.diameter_um, tool):
            self.account = replace(self.history.account(NAMELESS), label=label)

    @property
    def folder(self) -> Path:
        """The folder of ledger and run files."""
        return self.ledger.path.parent if self.ledger else Path()

    @property
    def diameter_um(self) -> float:
        """Diameter of the tool, also if no profile was named; NaN if it is unknown."""
        if self.plan.names_tool:
            return self.plan.loaded.profile.tool.diameter_um
        return _diameter_um(self.account.label, self.identity)

    @property
    def last_run_file(self) -> str:
        """The file of the last run with the tool: of its last hole, else of its reference; empty without any."""
        if self.account.holes:
            return self.account.holes[-1].run_file
        return self.account.reference.run_file if self.account.reference is not None else ""

    @property
    def reference_command(self) -> str:
        """The command that repeats the reference touch with the tool and the setup of the plan."""
        plan, command = self.plan, ["edmctl", "measure-wear", "--reference"]
        if plan.request.profile and plan.names_tool:
            command += ["--profile", plan.request.profile]
        if plan.setup.file is not None:
            command += ["--setup", str(plan.setup.file)]
        return on_machine(shlex.join(command), plan.where.selector)

    def plan_as_found(self, command: str) -> Plan:
        """Return the plan for the run file: without a named profile it has the command's name and this tool."""
        plan, profile = self.plan, self.plan.loaded.profile
        if plan.names_tool or plan.resumed is not None:
            return plan
        label = self.identity.tool or self.history.tool or NAMELESS
        tool: dict[str, object] = {}
        if not (plan.recipe_of and profile.tool.label == label):
            named = _LABEL.fullmatch(label)
            tool = {"id": label, "material": named["material"] if named else "?"}
            tool["diameter_um"] = _diameter_um(label, self.identity)
        meta = profile.meta.model_copy(update={"name": command, "description": ""})
        update = {"meta": meta, "tool": profile.tool.model_copy(update=tool)}
        return replace(plan, loaded=replace(plan.loaded, profile=profile.model_copy(update=update)))

    def name(self) -> None:
        """Write into the ledger that the unnamed tool in the machine is the profile's."""
        if self.ledger is None or self.plan.new_tool or not self.plan.names_tool:
            return
        identity, tool, history = self.identity, self.plan.loaded.profile.tool, self.history
        if history.account(tool.label).reference is not None or history.account(NAMELESS).reference is None:
            return
        if is_unnamed(identity.tool, identity.diameter_um, tool):
            self.ledger.append(identity.serial, ToolNamed(tool.label, NAMELESS))

    def plan_with_recipe_of(self, run_file: str) -> Plan:
        """Return the plan with the recipe of the run in that file, and `--set` on top, if no profile was named."""
        from edmctl.record.reader import present_name, reading

        plan = self.plan
        if plan.names_tool or not run_file or self.ledger is None:
            return plan
        path, table = present_name(self.folder / run_file), dict[str, object]()
        try:
            with reading(path, verify=False) as run:
                values, text = run.profile_values(), run.text("/entry/profile/toml")
                sha256 = run.text("/entry/profile/recipe_sha256")
            for key, value in values.items():
                if not key.startswith("sim.") and not key.endswith("_units"):
                    table = put(
                        table, tuple(key.split(".")), json.loads(str(value)) if key in _LISTS else value
                    )
            table = apply_overrides(Merged((), table, ()), plan.request.overrides).table
            profile = Profile.model_validate(table)
        except (RunFileError, ValueError) as error:
            why = "its values are not those of this version."
            if isinstance(error, RunFileError):
                if error.code == "E9016":
                    raise
                why = error.message
            raise failures.recipe_of_tool_unreadable(path=path, why=why) from error
        loaded = replace(plan.loaded, profile=profile, text=text, sha256=sha256)
        return replace(plan, loaded=loaded, recipe_of=str(path))

    def refuse_other_setup(self) -> None:
        """Raise PreconditionError E8059 if the tool's reference, or the machine's last one, has another setup."""
        for reference in (self.account.reference, self.history.reference):
            if reference is not None and (differences := setup_differences(reference, self.plan.setup)):
                raise failures.reference_under_other_setup(
                    tool=reference.tool,
                    folder=self.folder / reference.run_file,
                    words=self.plan.setup.in_words(),
                    differences=", and ".join(differences),
                    reference_command=self.reference_command,
                )

    def refuse_unknown_length(self) -> None:
        """Raise PreconditionError E8048 if a job of the tool was killed, so that its length is unknown."""
        if not self.account.killed:
            return
        run_file = self.folder / self.account.killed[-1].run_file
        remedy = f"Touch the pad anew with `{self.reference_command}`."
        if command := command_to_go_on(run_file):
            remedy = f"Finish it with `{command}`; to give it up, t{remedy[1:]}"
        raise failures.tool_length_unknown(label=self.account.label, stem=run_file.stem, remedy=remedy)

    def worn(self, profile: Profile) -> Profile:
        """Return the recipe with the gap at 0 V after the tool's last touch, if it differs."""
        pad_um, approach = self.account.pad_um, profile.approach
        moved_um = pad_um - approach.offset_um
        if math.isnan(moved_um) or abs(moved_um) <= NEAR_UM:
            return profile
        worn = {"offset_um": pad_um, "max_travel_um": approach.max_travel_um + moved_um}
        return profile.model_copy(update={"approach": approach.model_copy(update=worn)})

    def refuse_too_short(self, worn: Profile, stroke_um: float) -> None:
        """Raise PreconditionError E8044 if the actuator's stroke is less than `stroke_um` with the worn tool."""
        available_um = stroke_available_um(worn, self.plan.setup)
        if stroke_um > available_um:
            hint = (
                f"Set the tool lower and run `{self.reference_command}`, or change it and add --new-tool. "
                "Keep run files of another machine or of new work in another folder with --out."
            )
            raise failures.stroke_used_up(
                label=self.account.label,
                pad_um=length(self.account.pad_um),
                stroke_um=length(stroke_um),
                available_um=length(available_um),
                remedy=self._remedy(hint),
            )

    def refuse_worn_out(self, profile: Profile) -> list[Diagnostic]:
        """Return a warning if the tool will not last for the whole job."""
        expected = forecast(profile, self.plan.setup, self.plan.loaded.places)
        lost_um, limit_um = self.account.lost_um, profile.tool.max_wear_um
        lost, limit = f"{self.account.label} has lost {length(lost_um)} so far", length(limit_um)
        remedy = self._remedy("Dress or change the tool, and say --new-tool for a new one.")
        if lost_um + expected.wear_um > limit_um:
            more = length(expected.wear_um)
            raise failures.tool_worn_out(lost=lost, wear_um=more, limit_um=limit, remedy=remedy)
        if lost_um + expected.tool_wear_um > limit_um:
            whole = length(expected.tool_wear_um)
            return [failures.tool_will_wear_out(lost=lost, tool_wear_um=whole, limit_um=limit, plan=remedy)]
        return []

    def _remedy(self, hint: str) -> str:
        """Return `hint`; on a bench that this command makes, the remedy for an account of an earlier bench."""
        is_unused = math.isnan(self.account.pad_um) and not self.account.lost_um
        if self.plan.where.seed_of(0) is None or is_unused:
            return hint
        return "The bench is new: keep its runs in another folder with --out, or give it another --seed."

    def other_tool_warning(self) -> list[Diagnostic]:
        """Return a warning if the last reference touch is of another tool."""
        unnamed, label = self.history.account(NAMELESS).reference, self.plan.loaded.profile.tool.label
        if unnamed is None or self.history.tool != NAMELESS or self.account.reference is not None:
            return []
        return [failures.reference_without_profile(run_file=unnamed.run_file, label=label)]

    def unfinished_warnings(self) -> list[Diagnostic]:
        """Return a warning (W8115) of each job of the tool that has cut and could not be resumed after another."""
        label, warnings = self.account.label, []
        for journal in sorted(self.folder.glob(f"*{SUFFIX}")):
            run_file = journal.with_suffix(".h5")
            try:
                interrupted = read_journal(journal)
            except (EdmError, OSError):
                continue
            job, state = interrupted.job, interrupted.state
            is_own = (job.tool, job.serial) == (label, self.identity.serial)
            has_cut = state.get("begun") or state.get("done")
            if is_own and has_cut and (command := command_to_go_on(run_file)):
                warnings.append(
                    failures.interrupted_run_of_tool(run_file=run_file, tool=label, command=command)
                )
        return warnings


def _diameter_um(label: str, identity: ToolIdentity) -> float:
    """Return the diameter of the tool with that label in the machine; NaN if it is unknown."""
    named = _LABEL.fullmatch(label)
    return float(named["um"]) if named else identity.diameter_um


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
    now = reference_setup(setup)
    differences = []
    for name, x, y in (
        ("the reference pad", "x_um", "y_um"),
        ("the parking place", "park_x_um", "park_y_um"),
    ):
        before, after = (getattr(reference, x), getattr(reference, y)), (now[x], now[y])
        if math.dist(before, after) > setup.stage.repeatability_um:
            differences.append(f"{name} was at {coordinates(*before)} and is at {coordinates(*after)}")
    if reference.sensor != setup.sensor.fitted:
        was = "with" if reference.sensor else "without"
        differences.append(f"it was read {was} a displacement sensor (sensor.fitted)")
    return differences
