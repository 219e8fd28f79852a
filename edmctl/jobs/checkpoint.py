"""The journal around one job: it begins before anything moves, and goes when the job has come to its end."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError, MachineFault, ObjectiveNotReached, PreconditionError, RunFileError
from edmctl.jobs.plan import Plan
from edmctl.jobs.resume import find_run, refuse_elsewhere, refuse_untouchable, taken_up
from edmctl.jobs.run_context import RunContext
from edmctl.jobs.run_header import RunName
from edmctl.jobs.runs.opening import resume_command
from edmctl.procedures.job import Job, JobState
from edmctl.procedures.run import after_pause
from edmctl.record.journal import JournalFile, JournalledJob, remove_journal

PHASE_BEFORE = "starting"
RESTARTED = "E4005"
"""The stage positions have to be confirmed after a restart of the controller."""


def tell_way_on(error: EdmError, plan: Plan, name: RunName | None) -> None:
    """Add the command that resumes the job to the hint of an error, if there is a journal for it."""
    if name is None or isinstance(error, ObjectiveNotReached) or not name.journal.exists():
        return
    try:
        refuse_untouchable(find_run(str(name.journal), name.path.parent), plan)
    except (PreconditionError, RunFileError):
        return
    command = resume_command(name.path, plan.where.selector)
    if (plan.resumed is not None and plan.resumed.homed) or error.code == RESTARTED:
        command += " --homed"
    error.hint = f"{error.hint} Go on with `{command}`, before this tool does anything else.".strip()


@dataclass(slots=True, eq=False)
class JobCheckpoint:
    """Keeps the journal of a job next to its run file; keeps none on a machine that ends with the command.

    `truth` returns the true values of a virtual bench.
    """

    run: RunContext
    truth: Callable[[], Mapping[str, object] | None] = lambda: None
    _file: JournalFile | None = None
    _left: JobState | None = None

    def refuse(self) -> None:
        """Raise PreconditionError if the interrupted run cannot be resumed on this machine and tool."""
        resumption = self.run.plan.resumed
        if resumption is None:
            return
        ledger = self.run.ledger
        refuse_elsewhere(resumption, self.run.bench, ledger.lines if ledger else ())

    def begin(self, job: Job) -> Job:
        """Return the job with the progress of an earlier run, and write its first state.

        The journal of the earlier run is replaced.
        """
        resumption = self.run.plan.resumed
        if resumption is not None:
            job = taken_up(resumption, job, self.run.bench.now)
        if self.run.name is None or not self.run.plan.where.lasting:
            return job
        self._file = JournalFile(
            self.run.name.journal,
            self._job(job),
            self._stages_um,
            self.truth,
            self.run.bench.kept_s,
            self.run.disk,
        )
        tool = job.profile.tool.label
        self.keep(after_pause(job) if resumption else JobState(PHASE_BEFORE, 0.0, tool), urgent=True)
        if resumption is not None and resumption.path != self.run.name.journal:
            remove_journal(resumption.path)
        return job

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Hand a state on; a bench in a file is written first, so its work is never older than the journal."""
        if self._file is None:
            return
        if urgent:
            self.run.bench.keep_all()
        else:
            self.run.bench.keep()
        self._file.keep(state, urgent=urgent)
        self._left = state

    def leave(self, error: BaseException) -> None:
        """Remove the journal of a job that was refused, or ended by a fault, before it touched or cut anything."""
        left = self._left
        if left is None or left.has_cut or left.z1_touches:
            return
        if isinstance(error, MachineFault):
            error.hint = f"{error.hint} Nothing was cut: start the job again, without --resume."
        if isinstance(error, MachineFault | PreconditionError):
            self.end()

    def end(self) -> None:
        """Remove the journal of a finished job. Raises RunFileError E9040 if that fails."""
        if self._file is not None:
            self._file.remove()

    def _stages_um(self) -> tuple[float, float]:
        status = self.run.bench.machine.status()
        return status.x_um, status.y_um

    def _job(self, job: Job) -> JournalledJob:
        assert self.run.name is not None
        plan, request, machine = self.run.plan, self.run.plan.request, self.run.bench.machine
        resumption = plan.resumed
        return JournalledJob(
            run_id=self.run.name.run_id,
            start=self.run.name.start.isoformat(timespec="milliseconds"),
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
            parents=resumption.job.family if resumption else (),
        )
