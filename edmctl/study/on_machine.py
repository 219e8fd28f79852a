"""Running a study on a persistent machine: hole after hole at the next free place, tool after tool.

Any error stops the study in a state from which the next command continues: an interrupted hole is resumed, one that
was finished without a row is read from its run file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, EdmError, ObjectiveNotReached, PreconditionError, RunFileError
from edmctl.files import path_variable
from edmctl.jobs.plan import Plan, check
from edmctl.jobs.prepared_job import WALL_UM
from edmctl.jobs.run_header import RunName
from edmctl.jobs.surroundings import Surroundings, Warn
from edmctl.jsonout import JsonValue, to_json_value
from edmctl.profile.folders import SETUP_VARIABLE
from edmctl.record.ledger import JobBegun, Ledger, SiteMachined, ToolChanged
from edmctl.results.progress import SeriesObserver
from edmctl.study.folder import StudyFolder, StudyState, StudyWriter, absolute_port
from edmctl.study.planning import grid_of, request_of
from edmctl.study.results import RunKind, RunRow, RunState, StudyRun
from edmctl.study.running import bare_row, refuse_other_recipe, row_of, run_name
from edmctl.study.study_file import StudyMachine
from edmctl.wording import coordinates, plural, settings_words

if TYPE_CHECKING:
    from edmctl.jobs.plan import Resumption

WORN_OUT, NOT_BEGUN, FINISHED = "E8043", "E8050", "E8051"
JOB_RESUMED = re.compile(r"Go on with `edmctl machine --resume[^`]*`[^.]*\.")
"""How a job alone is resumed; that of a study is resumed with the study."""


@dataclass(frozen=True, slots=True)
class MachineRuns:
    """How the runs of a study are made on one machine.

    approve : is called before sparks of a run that has to be approved
    new_tool : the electrode was changed since the last run
    homed : the stages are where the restarted controller counts them
    command : the one that continues where these runs stop
    """

    port: str
    surroundings: Surroundings
    approve: Callable[[StudyRun, Plan], bool]
    warn: Warn
    wait_s: float = 0.0
    new_tool: bool = False
    homed: bool = False
    most: int | None = None
    command: str = "resume"


def run_on_machine(folder: StudyFolder, options: MachineRuns, observer: SeriesObserver) -> int:
    """Make the open runs, one after the other; return how many were made.

    Raises PreconditionError: E8201 another command runs the study, E8204 the tool has to be changed, E8205 a run
    waits for approval, E8207 no place is free; and the error of a run that stopped the study, with the remedy.
    """
    machine = folder.source.file.machine
    if machine is None:
        raise failures.study_without_machine()
    with folder.claimed(), folder.writer() as writer:
        if folder.read().rows.port != absolute_port(options.port):
            writer.on_machine(options.port)
        return _Series(folder, options, observer, writer, machine, options.new_tool).run()


def without_port(folder: StudyFolder) -> list[Diagnostic]:
    """Return a warning if a study with a [machine] is made on virtual machines."""
    return [] if folder.source.file.machine is None else [failures.study_on_virtual_machines()]


@dataclass(slots=True)
class _Series:
    folder: StudyFolder
    options: MachineRuns
    observer: SeriesObserver
    writer: StudyWriter
    machine: StudyMachine
    new_tool: bool

    def run(self) -> int:
        made = 0
        while self.options.most is None or made < self.options.most:
            state = self.folder.read()
            remaining = sum(run.state is RunState.OPEN for run in state.runs)
            self.observer.runs(len(state.runs) - remaining, len(state.runs))
            if (run := next_run(state)) is None:
                break
            self._make(run)
            made += 1
        return made

    def _make(self, run: StudyRun) -> None:
        """Make a run: read a finished hole from its run file, resume an interrupted one, or begin a new one."""
        from edmctl.jobs.job import carry_out
        from edmctl.jobs.resume import find_run

        name = run_name(self.folder.runs, run.planned, run.attempts + 1, datetime.now(UTC))
        row = bare_row(run.planned, run.attempts + 1, None, datetime.now(UTC))
        resumption = None
        try:
            resumption = find_run(name.run_id, self.folder.runs, homed=self.options.homed)
        except PreconditionError as error:
            if error.code not in (NOT_BEGUN, FINISHED):
                raise
            if error.code == FINISHED and (finished := _finished(name)) is not None:
                result, file = finished
                row = replace(row, tool=self._tool_of_begun(run), site_um=_place_of(result))
                self._keep(run, row, result, file, None)
                return
        if resumption is not None:
            tool = self._tool_of_begun(run)
            plan, name, site_um = self._resumed(run, resumption)
        else:
            tool = self._checked_tool(run)
            plan, site_um = self._begun(run)
            is_suggestion = run.planned.kind in (RunKind.SUGGESTED, RunKind.CONFIRMATION)
            policy = self.machine.approval
            needs_approval = policy == "each" or (policy == "suggestions" and is_suggestion)
            if needs_approval and not self.options.approve(run, plan):
                raise failures.run_not_approved(number=run.planned.number, value=self._command())
        verb = "making" if resumption is None else "resuming"
        settings = settings_words(run.planned.settings)
        self.observer.note(f"{verb} run {run.planned.number}: {settings}, at {coordinates(*site_um)}")
        lines = Ledger.open(self.folder.runs).lines if self.folder.runs.is_dir() else ()
        serial = lines[-1].serial if lines else ""  # of the machine that has made the runs before
        seed = self.folder.source.file.design.seed
        report = carry_out(plan, seed, self.observer, name, self.options.warn, serial)
        if report.error is not None and not isinstance(report.error, ObjectiveNotReached):
            self._stop(run, report.error)
        self.new_tool = False
        row = replace(row, tool=tool, site_um=site_um)
        self._keep(run, row, report.to_dict(), report.run_file, report.error)

    def _resumed(self, run: StudyRun, resumption: Resumption) -> tuple[Plan, RunName, tuple[float, float]]:
        from edmctl.jobs.resume import checked, name_of_resumed
        from edmctl.jobs.runs.opening import recovered_before

        options = self.options
        abandon = self.folder.command("judge", str(run.planned.number), "repeat", "REASON")
        if self.new_tool:
            raise failures.new_tool_in_interrupted_hole(number=run.planned.number, run=abandon)
        try:
            plan = checked(resumption, options.port, options.wait_s, options.surroundings)
        except PreconditionError as error:
            remedy = f"To abandon the hole and make the run at another place: `{abandon}`."
            error.hint = f"{error.hint} {remedy}".strip()
            raise
        options.warn(recovered_before(resumption))
        _, x_um, y_um, *_ = resumption.job.places[0]
        return plan, name_of_resumed(resumption, None, datetime.now(UTC)), (x_um, y_um)

    def _begun(self, run: StudyRun) -> tuple[Plan, tuple[float, float]]:
        """Return the job of a new hole at the first free place of the grid."""
        options, planned = self.options, run.planned
        setup = self.folder.base.setup or path_variable(SETUP_VARIABLE, options.surroundings.environ)
        base = replace(self.folder.base, setup=setup, port=options.port, wait_s=options.wait_s)
        request = request_of(base, planned.settings)
        plan = check(request, options.surroundings)
        refuse_other_recipe(plan, self.folder.recipes.get(planned.point), planned)
        x_um, y_um = self._next_free_um(plan)
        site = f'sites=[{{x_um={x_um!r}, y_um={y_um!r}, name="run{planned.number:04d}"}}]'
        request = replace(request, overrides=(*request.overrides, site), new_tool=self.new_tool)
        return check(request, options.surroundings), (x_um, y_um)

    def _next_free_um(self, plan: Plan) -> tuple[float, float]:
        """Return the first place of the grid that is clear of every hole that was made or begun."""
        profile = plan.loaded.profile
        clear_um = profile.tool.diameter_um / 2.0 + profile.work.side_gap_um + WALL_UM / 2
        taken: list[tuple[float, float, float]] = []
        for line in Ledger.open(self.folder.runs).lines if self.folder.runs.is_dir() else ():
            entry = line.entry
            if isinstance(entry, JobBegun):
                taken += [(x_um, y_um, entry.radius_um) for _, x_um, y_um in entry.places]
            elif isinstance(entry, SiteMachined):
                taken.append((entry.x_um, entry.y_um, entry.radius_um))
        for x_um, y_um in grid_of(self.machine):
            if all(math.hypot(x_um - x, y_um - y) >= clear_um + radius_um for x, y, radius_um in taken):
                return x_um, y_um
        raise failures.grid_full()

    def _tool_of_begun(self, run: StudyRun) -> int:
        """Return the number of the tool that began a hole: that of the row before, or the one changed for it."""
        made = _made(self.folder.read())
        if not made:
            return max(1, run.planned.tool)
        files = {file for row in made for file in row.run_files}
        is_new = False
        for line in Ledger.open(self.folder.runs).lines:
            if isinstance(line.entry, ToolChanged):
                is_new = True
            elif isinstance(line.entry, JobBegun) and line.entry.run_file in files:
                is_new = False
        return max(made[-1].tool + 1, run.planned.tool) if is_new else made[-1].tool

    def _checked_tool(self, run: StudyRun) -> int:
        """Return the number of the tool in the machine. Raises PreconditionError E8204 if another one is due."""
        state = self.folder.read()
        made = _made(state)
        tool = made[-1].tool if made else max(1, run.planned.tool)
        if self.new_tool and made:
            return max(tool + 1, run.planned.tool)
        if is_of_next_tool(state, run):
            holes = plural(sum(row.tool == tool for row in made), "hole")
            self.writer.paused(run, f"tool {tool} is done; dress or change it, and add --new-tool")
            raise failures.tool_change_due(
                tool=tool, holes=holes, number=run.planned.number, value=self._command()
            )
        return tool

    def _stop(self, run: StudyRun, error: EdmError) -> NoReturn:
        self.writer.paused(run, f"{error.code}: {error.message}")
        command = self._command() + (" --homed" if "--homed" in error.hint else "")
        hint = f"Continue with `{command}`: finished runs are kept, and an interrupted hole is resumed."
        if error.code == WORN_OUT:
            hint = f"Dress or change it, and continue with `{command} --new-tool`."
        error.hint = f"{JOB_RESUMED.sub('', error.hint).strip()} {hint}".strip()
        raise error

    def _keep(
        self,
        run: StudyRun,
        row: RunRow,
        result: dict[str, JsonValue],
        file: Path | None,
        error: EdmError | None,
    ) -> None:
        base = replace(self.folder.base, port=self.options.port)
        plan = check(request_of(base, run.planned.settings), self.options.surroundings)
        duration_s = (datetime.now(UTC) - datetime.fromisoformat(row.started)).total_seconds()
        row = row_of(row, plan, result, file, error)
        order = next_order(self.folder.read())
        self.writer.run(replace(row, duration_s=round(duration_s, 3), order=order))

    def _command(self) -> str:
        return self.folder.command(self.options.command, "--port", self.options.port)


def next_order(state: StudyState) -> int:
    """Return the place of the next hole in the order in which holes were made."""
    made = (row for rows in state.rows.attempts.values() for row in rows)
    return max((row.order for row in made), default=0) + 1


def next_run(state: StudyState) -> StudyRun | None:
    """Return the run that is made next: a hole that was begun comes first, its tool is in the machine."""
    open_runs = [run for run in state.runs if run.state is RunState.OPEN]
    begun = (run for run in open_runs if is_begun(state.folder, run))
    return next(begun, open_runs[0] if open_runs else None)


def is_of_next_tool(state: StudyState, run: StudyRun) -> bool:
    """Return whether a run is of a later tool than the runs before, by its own plan or by that of its block."""
    made = _made(state)
    if not made:
        return False
    # The plan has a run for a later tool than all before: also where a tool was changed early.
    planned = {one.number: one.tool for one in state.plan.runs}
    tools = [planned[row.number] for row in made if row.number in planned]
    return run.planned.tool > made[-1].tool or planned.get(run.planned.number, 0) > max(
        tools, default=math.inf
    )


def _made(state: StudyState) -> list[RunRow]:
    """Return the last attempt at every run that was made, in the order in which they were made."""
    return sorted((run.row for run in state.runs if run.row is not None), key=lambda row: row.order)


def is_begun(folder: StudyFolder, run: StudyRun) -> bool:
    """Return whether the next attempt at a run has a file already: its hole was interrupted."""
    name = run_name(folder.runs, run.planned, run.attempts + 1, datetime.now(UTC))
    return folder.runs.is_dir() and any(folder.runs.glob(f"{name.run_id}.*"))


def _finished(name: RunName) -> tuple[dict[str, JsonValue], Path] | None:
    """Return the result in the run file of a hole that was finished before its row was written."""
    from edmctl.record.reader import open_run

    later = sorted(name.path.parent.glob(f"{name.run_id}-r[0-9]*.h5"))
    for file in [*reversed(later), name.path]:
        try:
            with open_run(file) as run:
                summary = run.summary() if run.text("/entry/status") == "done" else None
        except (RunFileError, OSError):
            continue
        if summary is not None:
            return {name: to_json_value(value, name) for name, value in summary.items()}, file
    return None


def _place_of(result: Mapping[str, Any]) -> tuple[float, float] | None:
    sites = result.get("sites")
    return (float(sites[0]["x_um"]), float(sites[0]["y_um"])) if sites else None
