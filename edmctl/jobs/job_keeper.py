"""Ledger entries and journal of one job: reads what earlier jobs left, writes what this job does."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from edmctl import failures
from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import MachineFault, PreconditionError, RunFileError
from edmctl.jobs.corrections import choose_drift, unknown_use_warning
from edmctl.jobs.prepared_job import Place, hole_radius_um, prepared_job
from edmctl.jobs.resume import resumed_job
from edmctl.jobs.run_context import RunContext, ending
from edmctl.jobs.run_header import RunName
from edmctl.jobs.tool import reference_setup
from edmctl.jobs.truth import TrueWear
from edmctl.procedures.job import Job, JobState, NoStateStore
from edmctl.procedures.run import after_pause
from edmctl.quantity import half_width
from edmctl.record.journal import JournalFile, JournalledJob, remove_journal
from edmctl.record.ledger import (
    UNFINISHED,
    JobBegun,
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolChanged,
)
from edmctl.record.rows import TruthMap
from edmctl.results.job import ChannelResult, JobResult, SiteResult

DONE = "done"
PHASE_BEFORE = "starting"


@dataclass(slots=True, eq=False)
class JobKeeper:
    """Keeps the states of one job: the ledger next to its run file, and the journal by which it can be resumed.

    A machine that ends with the command has neither. `true_wear` is that of a virtual bench.
    """

    run: RunContext
    true_wear: TrueWear | None = None
    _truth: Mapping[str, float] | None = None
    """True values of a virtual bench's tool at the start of the job."""
    _places: tuple[Place, ...] = ()
    _has_z1: bool = False
    _needs_reference: bool = False
    _begun: dict[str, JobState] = field(default_factory=dict)
    _journal: JournalFile | None = None
    _newest: JobState | None = None

    def job(self) -> Job:
        """Return the job for the present tool. Writes nothing."""
        run, plan, ledger = self.run, self.run.plan, self.run.ledger
        serial, resuming = run.bench.serial, plan.resumed.run_files if plan.resumed else ()
        is_known = ledger is not None and any(line.serial == serial for line in ledger.lines)
        if ledger is not None and is_known and run.bench.seed is not None:
            run.warn([failures.bench_new_for_ledger(ledger=ledger.path, serial=serial)])
        prepared = prepared_job(plan, run.tool_identity, run.actuator, ledger, resuming)
        run.drift = choose_drift(plan.surroundings.environ, plan.setup, serial, lasting=plan.where.lasting)
        job = replace(prepared.job, drift=run.drift.model, creep_left=run.creep_left)
        run.warn([*run.drift.warnings, *unknown_use_warning(run.drift, job.unknown_use_s)])
        if ledger is not None:
            run.warn(prepared.refuse(resuming))
            self._places = prepared.places
            state = plan.resumed.state if plan.resumed else None
            is_first = state is None or not (state.z1_touches or state.done)
            self._needs_reference = prepared.tool.account.reference is None and is_first
        return job

    def begin(self, job: Job) -> Job:
        """Return the job with the progress of an earlier run; write its first state and its places.

        The journal of the earlier run is replaced.
        """
        run, plan, resumed, virtual = self.run, self.run.plan, self.run.plan.resumed, self.run.bench.virtual
        if virtual is not None:
            self._truth = {"tool_wear_um": virtual.tool_wear_um}
            self.true_wear = TrueWear(virtual, NoStateStore())
            if resumed is not None:
                self.true_wear.resume(resumed)
        if resumed is not None:
            job = resumed_job(resumed, job, run.bench.now)
        if run.name is not None and plan.where.lasting:

            def stages_um() -> tuple[float, float]:
                status = run.bench.machine.status()
                return status.x_um, status.y_um

            def truth() -> Mapping[str, object] | None:
                return self.true_wear.as_mapping() if self.true_wear else None

            journalled, kept_s = self._journalled(job, run.name), run.bench.kept_s
            self._journal = JournalFile(run.name.journal, journalled, stages_um, truth, kept_s, run.disk)
            first = after_pause(job) if resumed else JobState(PHASE_BEFORE, 0.0, job.profile.tool.label)
            self._keep_journal(first, urgent=True)
            if resumed is not None and resumed.path != run.name.journal:
                remove_journal(resumed.path)
        radius_um, wear_um = hole_radius_um(plan.loaded.profile), plan.forecast.tool_wear_um
        begun = JobBegun(self._tool, run.file_name, radius_um, self._places, wear_um, plan.setup.sha256)
        run.write_down(*([ToolChanged(self._tool)] if plan.new_tool else []), begun)
        return job

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Keep a state, the first Z1, and the holes that were started."""
        if self.true_wear is not None:
            self.true_wear.keep(state, urgent=urgent)
        if not self._has_z1 and state.z1_touches and not state.begun:
            self._has_z1 = True
            if self._needs_reference:  # at once because the job may be killed
                self._write_reference(state)
        if state.begun:
            self._begun[state.site] = state
        self._keep_journal(state, urgent=urgent)

    def _keep_journal(self, state: JobState, *, urgent: bool) -> None:
        """Write the journal; a bench in a file is written first, so its work is never older."""
        if self._journal is None:
            return
        if urgent:
            self.run.bench.keep_all()
        else:
            self.run.bench.keep()
        self._journal.keep(state, urgent=urgent)
        self._newest = state

    @contextmanager
    def writing_result(self) -> Iterator[None]:
        """Write the result into ledger, journal and run file, however the block ends."""
        run = self.run
        try:
            try:
                yield
            finally:
                run.note_creep()
        except BaseException as error:
            with suppress(RunFileError):
                self._close_ledger(ending(error)[0])
            with suppress(RunFileError):
                self._leave_journal(error)
            raise
        else:
            self._close_ledger(DONE)
            self._remove_journal()
        finally:
            if run.bench.virtual and run.plan.loaded.profile.path is not None:
                with suppress(RunFileError):  # a disk error is reported at the end of the file
                    run.recorder.append(TruthMap(*run.bench.virtual.truth_map()))

    def _close_ledger(self, status: str) -> None:
        if self._places:
            result = self.run.tally.result()
            ended = RunEnded(self.run.file_name, status, result.time_s - result.earlier_time_s)
            self.run.write_down(*self._sites(result), ended)

    def _leave_journal(self, error: BaseException) -> None:
        """Remove the journal of a job that was refused, or ended by a fault, before it touched or cut anything."""
        state = self._newest
        if state is None or state.has_cut or state.z1_touches:
            return
        if isinstance(error, MachineFault):
            error.hint = f"{error.hint} Nothing was cut: start the job again, without --resume."
        if isinstance(error, MachineFault | PreconditionError):
            self._remove_journal()

    def _remove_journal(self) -> None:
        if self._journal is not None:
            self._journal.remove()

    @property
    def _tool(self) -> str:
        return self.run.plan.loaded.profile.tool.label

    def _write_reference(self, z1: JobState) -> None:
        """Write the first touch as the tool's reference."""
        reference = ReferenceTouched(
            tool=self._tool,
            run_file=self.run.file_name,
            z_um=z1.z1_um,
            sd_um=z1.z1_sd_um,
            touches=z1.z1_touches,
            model_um=z1.z1_model_um,
            speed_um_s=self.run.plan.loaded.profile.measure.speed_um_s,
            time_s=z1.z1_time_s,
            home_um=z1.home_um,
            truth=self._truth,
            **reference_setup(self.run.plan.setup),
        )
        self.run.write_down(reference)

    def _sites(self, result: JobResult) -> list[SiteMachined]:
        """Return the holes in the order of machining, as the last one determines the length of the tool.

        These are measured holes and those that were begun and left; or the channel, place by place.
        """
        blank = SiteMachined(
            tool=self._tool,
            run_file=self.run.file_name,
            name="",
            x_um=math.nan,
            y_um=math.nan,
            radius_um=hole_radius_um(self.run.plan.loaded.profile),
            status=UNFINISHED,
            depth_um=math.nan,
            wear_um=math.nan,
            home_um=result.home_um,
        )
        places = [replace(blank, name=name, x_um=x_um, y_um=y_um) for name, x_um, y_um in self._places]
        if self.run.plan.loaded.profile.path is not None:
            return _channel(places, result, next(iter(self._begun.values()), None))
        unmeasured, entries = {place.name: place for place in places}, []
        for site in result.sites:
            if site.name in unmeasured:
                found = _machined(unmeasured.pop(site.name), site)
                entries.append(found if site.finished else replace(found, status=UNFINISHED))
        for name, place in unmeasured.items():
            if name in self._begun:
                entries.append(_abandoned(place, self._begun[name]))
        return entries

    def _journalled(self, job: Job, name: RunName) -> JournalledJob:
        plan, request, machine = self.run.plan, self.run.plan.request, self.run.bench.machine
        return JournalledJob(
            run_id=name.run_id,
            start=name.start.isoformat(timespec="milliseconds"),
            profile=str(plan.loaded.path.resolve()),
            overrides=request.overrides,
            profile_sha256=plan.loaded.sha256,
            sim_sha256=plan.loaded.sim_sha256,
            setup=str(request.setup.resolve()) if request.setup else "",
            setup_sha256=plan.setup.sha256,
            calibration=str(request.calibration.resolve()) if request.calibration else "",
            allow_model=request.allow_model,
            port=plan.where.selector,
            serial=machine.identity.serial,
            boots=machine.hello.boot_count,
            tool=job.profile.tool.label,
            seed=self.run.bench.seed,
            places=tuple(
                (site.name, site.x_um, site.y_um, site.theta_deg, site.depth_um) for site in job.sites
            ),
            parents=plan.resumed.job.family if plan.resumed else (),
        )


def _abandoned(place: SiteMachined, state: JobState) -> SiteMachined:
    """Return a hole that this run has not measured, with the values of the journal."""
    return replace(
        place,
        depth_um=state.depth_um,
        depth_u95_um=half_width(state.depth_u_um),
        depth_u_um=state.depth_u_um,
        wear_um=state.wear_um,
        wear_u95_um=half_width(state.wear_u_um),
    )


def _machined(place: SiteMachined, found: SiteResult | ChannelResult) -> SiteMachined:
    z3_um = found.z3_um + found.drift_correction_um
    return replace(
        place,
        status=DONE,
        depth_um=found.depth_um,
        depth_u95_um=found.depth_u95_um,
        depth_u_um=found.depth_u_um,
        wear_um=found.wear_um,
        wear_u95_um=found.wear_u95_um,
        z1_um=found.z1_um,
        z2_um=z3_um + found.depth_um,
        z3_um=z3_um,
        through=isinstance(found, SiteResult) and found.through,
    )


def _channel(places: Sequence[SiteMachined], result: JobResult, state: JobState | None) -> list[SiteMachined]:
    """Return a channel as a row of holes, the whole wear at the first; empty if nothing was cut.

    Everywhere its floor has the mean depth, and is uneven by its scatter. Values of a channel that no run has
    measured come from the journal.
    """
    if not result.machining_time_s:
        return []
    channel = result.channel
    if channel is not None:
        floor_sd_um = channel.floor_sd_um if channel.floor else 0.0
        floor: dict[str, Any] = {
            "depth_u95_um": math.hypot(channel.depth_u95_um, half_width(floor_sd_um)),
            "depth_u_um": math.hypot(channel.depth_u_um, floor_sd_um),
            "status": DONE if channel.finished else UNFINISHED,
        }
        places = [replace(_machined(place, channel), **floor) for place in places]
    elif state is not None:
        places = [_abandoned(place, state) for place in places]
    first, *others = places
    return [first, *(replace(place, wear_um=0.0, wear_u95_um=0.0) for place in others)]
