"""The context of a run: connected machine, calibration and run file, from the first check to the closed file.

A job or procedure that moves a machine reads in the order of events:

    with connected_run(plan, seed, observer, name, warn) as run:
        run.check_machine()
        ...  # refuse; nothing is written and nothing moves
        with run.recording("machine", summary):
            ...  # move the machine

Both blocks close run file and connection however they end; `procedures.session.running` brings the machine into its
safe state. An expected error ends the outer block and is kept as `run.error`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import MEANING, EdmError, ExitCode, RunFileError, error_exit_code
from edmctl.jobs.connect import connected, introduction
from edmctl.jobs.connected_machine import ConnectedMachine, CreepNote
from edmctl.jobs.corrections import Choice, DriftChoice, choose
from edmctl.jobs.plan import Plan, under
from edmctl.jobs.run_header import RunName, run_meta
from edmctl.jobs.runs.opening import on_machine
from edmctl.jobs.surroundings import Warn
from edmctl.jobs.tool import MachineTool, ToolIdentity, tool_identity
from edmctl.jsonout import render_json
from edmctl.labels import NOT_SHOWN_CODE, Verdict
from edmctl.procedures.job import CalibratedActuator, Job, JobTally
from edmctl.procedures.run import JobRun
from edmctl.procedures.session import running
from edmctl.process.rest_drift import CreepLeft
from edmctl.record.disk import DiskThread, locks_are_known, refuse_place
from edmctl.record.ledger import Entry, Ledger
from edmctl.record.rows import NullRecorder, Recorder, Summary
from edmctl.record.writer import BackgroundWriter
from edmctl.results.progress import Observer


@dataclass(slots=True, eq=False)
class RunContext:
    """The machine, plan and files of a run, and its results, also after an error.

    plan : under the setup in effect, which may be known only by the machine's serial number
    name : name of the run file; None if there is none
    ledger : job ledger next to the run file; None without one, and for a new virtual bench, whose workpiece and
        tool end with the command
    creep_left : remaining creep of the actuator, before this use and in the end after it; None if it was never used
    run_file : the run file as it is called now; None before it exists
    error : the expected error that ended the run
    """

    plan: Plan
    name: RunName | None
    observer: Observer
    warn: Warn
    bench: ConnectedMachine
    disk: DiskThread
    tally: JobTally = field(default_factory=JobTally)
    ledger: Ledger | None = None
    choice: Choice | None = None
    drift: DriftChoice = field(default_factory=DriftChoice)
    creep_left: CreepLeft | None = None
    recorder: Recorder = field(default_factory=NullRecorder)
    run_file: Path | None = None
    error: EdmError | None = None

    @property
    def actuator(self) -> CalibratedActuator | None:
        """The calibrated actuator; None if no calibration is used."""
        return self.choice.actuator if self.choice else None

    @property
    def tool_identity(self) -> ToolIdentity:
        """The machine, and the tool in it."""
        return tool_identity(self.bench)

    @property
    def tool(self) -> MachineTool:
        """The tool of the present plan by the ledger."""
        return MachineTool(self.plan, self.tool_identity, self.ledger)

    @property
    def file_name(self) -> str:
        """Name of the run file in the ledger; empty without one."""
        return self.name.path.name if self.name else ""

    def check_machine(self) -> None:
        """Take the machine's own setup, choose its calibration, read the use of its actuator and its ledger."""
        if self.bench.own_setup is not None:
            self.plan = under(self.plan, self.bench.own_setup)
            self.warn(self.plan.loaded.warnings)
        plan, is_lasting = self.plan, self.plan.where.lasting
        if plan.resumed is not None:
            plan.resumed.refuse_other_setup(plan.setup)
        calibrate = f"edmctl calibrate --seed {self.bench.seed}"
        if is_lasting:
            calibrate = on_machine("edmctl calibrate", plan.where.selector)
        self.choice = choose(
            plan.request.calibration,
            plan.surroundings.environ,
            plan.setup,
            plan.loaded.profile,
            self.bench.serial,
            calibrate,
            lasting=is_lasting,
        )
        self.warn(self.choice.warnings)
        self.creep_left = self._creep_note().read()
        if self.name is not None and is_lasting:
            self.ledger = Ledger.open(self.name.path.parent)

    @contextmanager
    def recording(self, procedure: str, summary: Callable[[], Mapping[str, object]]) -> Iterator[None]:
        """Create the run file and introduce the run; close the file however the block ends.

        `procedure` is the kind of procedure in the file, `summary` returns the result that is written at the end.
        From here on a virtual bench has the profile's tool.
        """
        bench, plan, tool = self.bench, self.plan, self.tool
        if bench.machine.hello.fault and (latched := bench.machine.latched_fault()):
            raise latched
        before, note = self.creep_left, self._creep_note()
        with self._run_file(tool.plan_as_found("measure-wear"), procedure, summary):
            into = f", into {self.name.path}" if self.name else ""
            recipe = f"; recipe of {plan.recipe_of}" if plan.recipe_of else ""
            self.observer.note(f"{introduction(plan.where, bench)}{into}; {plan.setup.in_words()}{recipe}")
            tool.name()
            note.take_away()
            bench.begin()
            if plan.new_tool and bench.virtual is not None:
                bench.virtual.new_tool()
            try:
                yield
            finally:
                if self.creep_left is not None and self.creep_left is not before:
                    note.leave(self.creep_left)

    @contextmanager
    def armed(self, job: Job, *, pulses: bool = False) -> Iterator[JobRun]:
        """Give the armed and conditioned machine for a procedure; it is retracted however the block ends."""
        job = replace(job, creep_left=self.creep_left)
        recorder, observer = self.recorder, self.observer
        try:
            with running(
                self.bench.machine, job, self.tally, recorder=recorder, observer=observer, pulses=pulses
            ) as job_run:
                yield job_run
        finally:
            self.note_creep()

    def note_creep(self) -> None:
        """Keep the remaining creep after this use; unknown if the use ended early."""
        self.creep_left = self.tally.creep_left or CreepLeft.none(0.0)

    def write_down(self, *entries: Entry) -> None:
        """Add entries to the ledger, if any; a bench in a file is written first and is never older."""
        ledger = self.ledger
        if ledger is None:
            return
        self.bench.keep_all()
        serial, bench_s = self.bench.serial, self.bench.kept_s()
        self.disk.run(ledger.path, lambda: ledger.append(serial, *entries, bench_s=bench_s))

    def _creep_note(self) -> CreepNote:
        return CreepNote(self.bench, self.plan.where, self.plan.surroundings.environ)

    @contextmanager
    def _run_file(
        self, plan: Plan, procedure: str, summary: Callable[[], Mapping[str, object]]
    ) -> Iterator[None]:
        name = self.name
        if name is None:
            yield
            return
        assert self.choice is not None
        identity = self.bench.machine.identity
        meta = run_meta(name, plan, self.bench.seed, identity, self.choice, procedure, self.drift.toml)
        # The time of a virtual machine stands still while a slow disk is waited for.
        writer = BackgroundWriter.create(name.path, meta, waits=self.plan.where.in_process)
        self.recorder = writer

        def summarize() -> None:
            writer.append(Summary(render_json(summary(), is_exact=True)))

        try:
            yield
        except BaseException as error:
            with suppress(RunFileError):
                summarize()
            self.run_file = writer.abandon(*ending(error))
            raise
        try:
            summarize()
            self.run_file = writer.finish("done", 0)
        except RunFileError:
            # The final name may be another run's now.
            self.run_file = name.partial if name.partial.exists() else None
            raise


@contextmanager
def connected_run(
    plan: Plan, seed: int, observer: Observer, name: RunName | None, warn: Warn | None
) -> Iterator[RunContext]:
    """Connect to the machine of `plan`; an expected error ends the block and is kept in the context.

    `seed` makes a virtual bench that does not exist yet. `warn` gets warnings before anything moves.

    Raises LinkLost, ProtocolMismatch and RunFileError if no machine was connected.
    """
    if name is not None:
        refuse_place(name.path)
        if warn is not None and not locks_are_known(name.path.parent):
            warn([failures.no_file_locks(folder=name.path.parent)])
    run: RunContext | None = None
    try:
        is_fitted = plan.names_tool or plan.where.bench_file is None  # else a bench keeps its tool
        loaded = plan.loaded if is_fitted else None
        with connected(loaded, plan.setup, seed, observer.note, plan.where, plan.surroundings) as bench:
            disk = DiskThread(bench.machine.attend if bench.machine.is_live else None)
            run = RunContext(plan, name, observer, warn or (lambda _: None), bench, disk)
            try:
                yield run
            except EdmError as expected:
                run.error = expected
            finally:
                disk.close()
    except RunFileError as unkept:
        if run is None:
            raise
        run.error = run.error or unkept


def ending(error: BaseException) -> tuple[str, int]:
    """Return status and exit code of a run file whose command ended with `error`."""
    if isinstance(error, KeyboardInterrupt):  # in a notebook, without a stop request
        return MEANING[ExitCode.INTERRUPT].partition(" (")[0], int(ExitCode.INTERRUPT)
    if not isinstance(error, EdmError):
        return "internal error", int(ExitCode.INTERNAL)
    code = error_exit_code(error)
    if error.code == NOT_SHOWN_CODE:
        return Verdict.NOT_SHOWN.value, code
    return MEANING[ExitCode(code)].partition(" (")[0], code
