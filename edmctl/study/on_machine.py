"""Running a study on a machine that lasts: hole after hole at the next free place, tool after tool.

Any error stops the study in a state from which the next command continues: an interrupted hole is resumed, one that
was finished without a row is read from its run file.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import (
    Diagnostic,
    EdmError,
    ObjectiveNotReached,
    PreconditionError,
    RunFileError,
)
from edmctl.files import path_variable
from edmctl.jobs.ledger.prepared_job import WALL_UM
from edmctl.jobs.plan import Plan, check
from edmctl.jobs.run_header import RunName
from edmctl.jobs.surroundings import Surroundings, Warn
from edmctl.jsonout import JsonValue, to_json_value
from edmctl.profile.folders import SETUP_VARIABLE
from edmctl.record.ledger import JobBegun, Ledger, SiteMachined, ToolChanged
from edmctl.results.progress import SeriesObserver
from edmctl.study.folder import StudyFolder, StudyState, StudyWriter
from edmctl.study.planning import grid_of, request_of
from edmctl.study.results import RunKind, RunRow, RunState, StudyRun
from edmctl.study.running import bare_row, refuse_other_recipe, row_of, run_name
from edmctl.study.suggestions import opening_run
from edmctl.wording import coordinates, plural, settings_words

WORN_OUT = "E8043"
JOB_RESUMED = re.compile(r"Go on with `edmctl machine --resume[^`]*`[^.]*\.")
"""How a job alone would go on; that of a study is resumed with the study."""


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
    """Make the runs that are left, one after the other; return how many were made.

    Raises PreconditionError: E8201 another command runs the study, E8204 the tool has to be changed, E8205 a run
    waits for approval, E8207 no place is free; and the error of a run that stopped the study, with the way on.
    """
    if folder.source.file.machine is None:
        raise failures.study_without_machine()
    with folder.claimed(), folder.writer() as writer:
        if folder.read().rows.port != options.port:
            writer.on_machine(options.port)
        return _Series(folder, options, observer, writer).run()


def without_port(folder: StudyFolder) -> list[Diagnostic]:
    """Return a warning where a study that says a machine is made on virtual ones."""
    if folder.source.file.machine is None:
        return []
    return [failures.study_on_virtual_machines()]


class _Series:
    def __init__(
        self, folder: StudyFolder, options: MachineRuns, observer: SeriesObserver, writer: StudyWriter
    ) -> None:
        assert folder.source.file.machine is not None
        self._folder, self._options, self._observer, self._writer = folder, options, observer, writer
        self._machine, self._new_tool = folder.source.file.machine, options.new_tool

    def run(self) -> int:
        made = 0
        while self._options.most is None or made < self._options.most:
            state = self._folder.read()
            left = sum(run.state is RunState.OPEN for run in state.runs)
            self._observer.runs(len(state.runs) - left, len(state.runs))
            if (run := next_run(state)) is None:
                break
            if made:
                self._pause()
            self._make(run)
            made += 1
        return made

    def _make(self, run: StudyRun) -> None:
        name = run_name(self._folder.runs, run.planned, run.attempts + 1, datetime.now(UTC))
        bare = bare_row(run.planned, run.attempts + 1, None, datetime.now(UTC))
        left = self._left(run, name)
        if isinstance(left, tuple):
            self._keep(run, replace(bare, tool=self._tool_of_begun(run)), *left, None)
            return
        if left is not None and self._new_tool:
            raise failures.new_tool_in_interrupted_hole(number=run.planned.number, run=self._giving_up(run))
        tool = self._look_at_tool(run) if left is None else self._tool_of_begun(run)
        if left is None and (opening := self._opening_run(run, tool)) is not None:
            self._make(opening)
            return
        begun = left if left is not None else self._fresh(run, name)
        if left is None and self._wants_approval(run) and not self._options.approve(run, begun.plan):
            raise failures.run_not_approved(number=run.planned.number, value=self._command())
        from edmctl.jobs.job import carry_out

        what = "resuming" if left is not None else "making"
        where = f"{settings_words(run.planned.settings)}, at {coordinates(*begun.site_um)}"
        self._observer.note(f"{what} run {run.planned.number}: {where}")
        seed, warn = self._folder.source.file.design.seed, self._options.warn
        before = Ledger.open(self._folder.runs).lines if self._folder.runs.is_dir() else ()
        serial = before[-1].serial if before else ""  # of the machine that has made the runs until now
        report = carry_out(begun.plan, seed, self._observer, begun.name, warn, serial)
        if report.error is not None and not isinstance(report.error, ObjectiveNotReached):
            self._stop(run, report.error)
        self._new_tool = False
        made = replace(bare, tool=tool, site_um=begun.site_um)
        self._keep(run, made, report.to_dict(), report.run_file, report.error)

    def _left(self, run: StudyRun, name: RunName) -> _Begun | tuple[dict[str, JsonValue], Path] | None:
        """Return what an earlier command left of an attempt: a hole to resume, a result without a row, or None."""
        from edmctl.jobs.resume import checked, find_run, name_of_resumed
        from edmctl.jobs.runs.opening import recovered_before

        options = self._options
        try:
            resumption = find_run(name.run_id, self._folder.runs, homed=options.homed)
        except PreconditionError as error:
            if error.code == "E8051":
                return _finished(name)
            if error.code != "E8050":
                raise
            return None
        try:
            plan = checked(resumption, options.port, options.wait_s, options.surroundings)
        except PreconditionError as error:
            way_out = f"To give the hole up and make the run at another place: `{self._giving_up(run)}`."
            error.hint = f"{error.hint} {way_out}".strip()
            raise
        options.warn(recovered_before(resumption))
        _, x_um, y_um, *_ = resumption.job.places[0]
        return _Begun(plan, name_of_resumed(resumption, None, datetime.now(UTC)), (x_um, y_um))

    def _fresh(self, run: StudyRun, name: RunName) -> _Begun:
        options, planned = self._options, run.planned
        setup = self._folder.base.setup or path_variable(SETUP_VARIABLE, options.surroundings.environ)
        base = replace(self._folder.base, setup=setup, port=options.port, wait_s=options.wait_s)
        request = request_of(base, planned.settings)
        without_place = check(request, options.surroundings)
        refuse_other_recipe(without_place, self._folder.recipes.get(planned.point), planned)
        x_um, y_um = self._next_free_um(without_place)
        at = f'sites=[{{x_um={x_um!r}, y_um={y_um!r}, name="run{planned.number:04d}"}}]'
        request = replace(request, overrides=(*request.overrides, at), new_tool=self._new_tool)
        return _Begun(check(request, options.surroundings), name, (x_um, y_um))

    def _next_free_um(self, plan: Plan) -> tuple[float, float]:
        """The first place of the grid that is clear of every hole that was made or begun."""
        profile = plan.loaded.profile
        radius_um = profile.tool.diameter_um / 2.0 + profile.work.side_gap_um
        taken = list(_taken(self._folder.runs))
        for x_um, y_um in grid_of(self._machine):
            if all(math.hypot(x_um - x, y_um - y) >= radius_um + own + WALL_UM / 2 for x, y, own in taken):
                return x_um, y_um
        raise failures.grid_full()

    def _tool_of_begun(self, run: StudyRun) -> int:
        """Return the number of the tool that began a hole: that of the row before, or the one changed for it."""
        made = _made(self._folder.read())
        if not made:
            return max(1, run.planned.tool)
        files = {file for row in made for file in row.run_files}
        is_new = False
        for line in Ledger.open(self._folder.runs).lines:
            if isinstance(line.entry, ToolChanged):
                is_new = True
            elif isinstance(line.entry, JobBegun) and line.entry.run_file in files:
                is_new = False
        return max(made[-1].tool + 1, run.planned.tool) if is_new else made[-1].tool

    def _look_at_tool(self, run: StudyRun) -> int:
        """Return the number of the tool in the machine; stop where the run is of another one than the run before."""
        state = self._folder.read()
        made = _made(state)
        if not made:
            return max(1, run.planned.tool)
        tool = made[-1].tool
        if self._new_tool:
            return max(tool + 1, run.planned.tool)
        if is_of_next_tool(state, run):
            holes = sum(row.tool == tool for row in made)
            self._writer.paused(run, f"tool {tool} is done")
            raise failures.tool_change_due(
                tool=tool, holes=plural(holes, "hole"), number=run.planned.number, value=self._command()
            )
        return tool

    def _opening_run(self, run: StudyRun, tool: int) -> StudyRun | None:
        """Return the centre run that a tool begins with, where the plan has none: it was changed before its time."""
        if not self._machine.center_runs or run.planned.kind in (RunKind.CENTER, RunKind.CONFIRMATION):
            return None
        state = self._folder.read()
        made = _made(state)
        if not made or any(row.tool == tool for row in made):
            return None
        for one in state.runs[len(self._folder.plan.runs) :]:
            if one.planned.kind is RunKind.CENTER and one.state is RunState.OPEN and one.planned.tool == tool:
                return one
        self._writer.planned([opening_run(state, tool)])
        return self._folder.read().runs[-1]

    def _wants_approval(self, run: StudyRun) -> bool:
        policy = self._machine.approval
        is_suggestion = run.planned.kind in (RunKind.SUGGESTED, RunKind.CONFIRMATION)
        return policy == "each" or (policy == "suggestions" and is_suggestion)

    def _stop(self, run: StudyRun, error: EdmError) -> None:
        worn_tool = _tool_in_use(self._folder.read(), run) if error.code == WORN_OUT else None
        self._writer.paused(run, f"{error.code}: {error.message}", worn_tool)
        command = self._command() + (" --homed" if "--homed" in error.hint else "")
        if error.code == WORN_OUT:
            hint = f"Dress or change it, and go on with `{command} --new-tool`."
        else:
            hint = f"Go on with `{command}`: what is made is kept, and a begun hole is resumed."
        error.hint = f"{JOB_RESUMED.sub('', error.hint).strip()} {hint}".strip()
        raise error

    def _keep(
        self,
        run: StudyRun,
        bare: RunRow,
        result: dict[str, JsonValue],
        file: Path | None,
        error: EdmError | None,
    ) -> None:
        base = replace(self._folder.base, port=self._options.port)
        plan = check(request_of(base, run.planned.settings), self._options.surroundings)
        duration_s = (datetime.now(UTC) - datetime.fromisoformat(bare.started)).total_seconds()
        row = row_of(bare, plan, result, file, error)
        self._writer.run(
            replace(
                row,
                site_um=row.site_um or _place_of(result),
                duration_s=round(duration_s, 3),
                order=next_order(self._folder.read()),
            )
        )

    def _pause(self) -> None:
        """Wait between two runs; a signal ends that as it ends a job."""
        if not self._machine.pause_s:
            return
        around = self._options.surroundings
        stop = around.stop(self._observer.note)
        end_s = time.monotonic() + self._machine.pause_s
        with around.guard(stop, lambda: None):
            while (left_s := end_s - time.monotonic()) > 0:
                time.sleep(min(0.1, left_s))
                stop.check()

    def _giving_up(self, run: StudyRun) -> str:
        number = str(run.planned.number)
        return self._folder.command("judge", number, "repeat", "REASON")

    def _command(self) -> str:
        return self._folder.command(self._options.command, "--port", self._options.port)


def next_order(state: StudyState) -> int:
    """Return the place of the next hole in the order in which they were made."""
    made = (row for rows in state.rows.attempts.values() for row in rows)
    return max((row.order for row in made), default=0) + 1


def next_run(state: StudyState) -> StudyRun | None:
    """Return the run that is made next: a hole that was begun comes first, its tool is in the machine."""
    left = [run for run in state.runs if run.state is RunState.OPEN]
    return next((run for run in left if is_begun(state.folder, run)), left[0] if left else None)


def wants_new_tool(state: StudyState) -> bool:
    """Return whether the next run waits for another tool: one was worn out, or has made its holes."""
    run = next_run(state)
    if run is None or not state.rows.port or is_begun(state.folder, run):
        return False
    last = state.rows.paused
    worn = (last.number, last.worn_tool) if last is not None else (0, None)
    return worn == (run.planned.number, _tool_in_use(state, run)) or is_of_next_tool(state, run)


def is_of_next_tool(state: StudyState, run: StudyRun) -> bool:
    """Return whether a run is of a later tool than the runs before, by its own plan or by that of its block."""
    made = _made(state)
    if not made:
        return False
    # The plan has a run for a later tool than all before: also where a tool was changed early.
    planned = {one.number: one.tool for one in state.plan.runs}
    before = [planned[row.number] for row in made if row.number in planned]
    begins_a_block = bool(before) and planned.get(run.planned.number, 0) > max(before)
    return run.planned.tool > made[-1].tool or begins_a_block


def _made(state: StudyState) -> list[RunRow]:
    """The last attempt at every run that was made, in the order in which they were made, whatever clocks said."""
    return sorted((run.row for run in state.runs if run.row is not None), key=lambda row: row.order)


def _tool_in_use(state: StudyState, run: StudyRun) -> int:
    made = _made(state)
    return made[-1].tool if made else max(1, run.planned.tool)


def is_begun(folder: StudyFolder, run: StudyRun) -> bool:
    """Return whether the next attempt at a run has a file already: its hole was begun and left."""
    name = run_name(folder.runs, run.planned, run.attempts + 1, datetime.now(UTC))
    return folder.runs.is_dir() and any(folder.runs.glob(f"{name.run_id}.*"))


@dataclass(frozen=True, slots=True)
class _Begun:
    plan: Plan
    name: RunName
    site_um: tuple[float, float]


def _finished(name: RunName) -> tuple[dict[str, JsonValue], Path] | None:
    """The result in the run file of a hole that was finished before its row was written."""
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


def _taken(runs: Path) -> list[tuple[float, float, float]]:
    """Axes and radii of all holes that the ledger of the run files knows, made or begun."""
    if not runs.is_dir():
        return []
    found = []
    for line in Ledger.open(runs).lines:
        entry = line.entry
        if isinstance(entry, JobBegun):
            found += [(x_um, y_um, entry.radius_um) for _, x_um, y_um in entry.places]
        elif isinstance(entry, SiteMachined):
            found.append((entry.x_um, entry.y_um, entry.radius_um))
    return found


def _place_of(result: dict[str, JsonValue]) -> tuple[float, float] | None:
    sites = result.get("sites")
    if isinstance(sites, list) and sites and isinstance(sites[0], dict):
        x_um, y_um = sites[0].get("x_um"), sites[0].get("y_um")
        if isinstance(x_um, int | float) and isinstance(y_um, int | float):
            return float(x_um), float(y_um)
    return None
