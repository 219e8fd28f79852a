"""What every command that moves the machine does around its procedure: connect, choose a calibration, record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic, EdmError, RunFileError
from edmctl.exitcodes import MEANING, ExitCode, error_exit_code
from edmctl.jobs.calibration.selection import choose
from edmctl.jobs.connect import connected, introduction
from edmctl.jobs.job_preparation import ledger_of
from edmctl.jobs.ledger.tool import as_found, name_tool
from edmctl.jobs.plan import Plan, under
from edmctl.jobs.resume.selection import refuse_other_setup_of_run
from edmctl.jobs.run_header import RunName, run_meta
from edmctl.jobs.runs.opening import on_machine
from edmctl.jobs.session import MachineSession
from edmctl.jobs.surroundings import Warn
from edmctl.jsonout import render_json
from edmctl.labels import NOT_SHOWN_CODE, Verdict
from edmctl.record.disk import refuse_place
from edmctl.record.disk_thread import DiskThread
from edmctl.record.locks import are_known
from edmctl.record.rows import NullRecorder, Recorder, Summary
from edmctl.record.run_meta import RunMeta
from edmctl.results.progress import Observer

if TYPE_CHECKING:
    Act = Callable[[Recorder], None]


def connected_run(
    plan: Plan,
    seed: int,
    observer: Observer,
    name: RunName | None,
    warn: Warn | None,
    prepare: Callable[[MachineSession], Act],
    summary: Callable[[MachineSession], Mapping[str, object]],
    procedure: str = "machine",
) -> MachineSession:
    """Connect to the machine of `plan`, and act on it with a recorder into the run file `name`.

    `prepare` refuses what cannot be done, or returns what does it; until then no file is made and no tool changed.
    `seed` makes a virtual bench that is not there yet. `warn` is told what is doubtful about the calibration before
    anything moves; `summary` becomes the result in the run file, `procedure` what it says was done. Expected errors
    come back with what was reached.

    Raises LinkLost, ProtocolMismatch and RunFileError where there was no machine to act on.
    """
    if name is not None:
        refuse_place(name.path)
        if warn is not None and not are_known(name.path.parent):
            warn([_no_locks(name.path.parent)])
    session: MachineSession | None = None

    def written(path: Path | None) -> None:
        assert session is not None
        session.run_file = path

    try:
        with connected(
            plan.tool_for(), plan.setup, seed, observer.note, plan.where, plan.surroundings
        ) as bench:
            disk = DiskThread(bench.machine.attend if bench.machine.is_live else None)
            session = MachineSession(bench, disk, plan)
            try:
                if bench.own_setup is not None:
                    session.plan = under(plan, bench.own_setup)
                    if warn is not None:
                        warn(session.plan.loaded.warnings)
                _record(observer, name, warn, prepare, summary, procedure, session, written)
            except EdmError as expected:
                session.error = expected
            finally:
                disk.close()
    except RunFileError as unkept:
        if session is None:
            raise
        session.error = session.error or unkept
    return session


def _record(
    observer: Observer,
    name: RunName | None,
    warn: Warn | None,
    prepare: Callable[[MachineSession], Act],
    summary: Callable[[MachineSession], Mapping[str, object]],
    procedure: str,
    session: MachineSession,
    written: Callable[[Path | None], None],
) -> None:
    from edmctl.jobs.creep_left import CreepNote

    bench, plan = session.bench, session.plan
    if plan.resumed is not None:
        refuse_other_setup_of_run(plan, plan.resumed)
    identity = bench.machine.identity
    calibrate = (
        on_machine("edmctl calibrate", plan.where.selector)
        if plan.where.lasting
        else f"edmctl calibrate --seed {bench.seed}"
    )
    choice = session.choice = choose(
        plan.calibration,
        plan.surroundings.environ,
        plan.setup,
        plan.loaded.profile,
        identity.serial,
        calibrate,
        lasting=plan.where.lasting,
    )
    if warn is not None:
        warn(choice.warnings)
    note = CreepNote(bench, plan.where, plan.surroundings.environ)
    before = session.creep_left = note.read()
    act = prepare(session)
    plan = session.plan
    if bench.machine.hello.fault and (latched := bench.machine.latched_fault()):
        raise latched
    ledger = ledger_of(plan, name)
    found = as_found(plan, session, ledger, "measure-wear")
    drift_toml = session.drift.toml if session.drift else ""
    with recorded(
        name,
        lambda run: run_meta(run, found, bench.seed, identity, choice, procedure, drift_toml),
        lambda: summary(session),
        written,
        waits=plan.where.in_process,
    ) as recorder:
        into = f", into {name.path}" if name else ""
        recipe = f"; recipe of {plan.recipe_of}" if plan.recipe_of else ""
        observer.note(f"{introduction(plan.where, bench)}{into}; {plan.setup.in_words()}{recipe}")
        name_tool(plan, session, ledger)
        note.take_away()
        bench.begin()
        if plan.new_tool and bench.virtual is not None:
            bench.virtual.new_tool()
        try:
            act(recorder)
        finally:
            if session.creep_left is not None and session.creep_left is not before:
                note.leave(session.creep_left)


def _no_locks(folder: Path) -> Diagnostic:
    return Diagnostic(
        "W9002",
        f"The file system of {folder} knows no locks: files that name host and process stand in their stead.",
        "One that a computer left behind when it went off has to be removed by hand (ls -a shows .*.lock); "
        "--out names a folder on another disk.",
        is_warning=True,
    )


@contextmanager
def recorded(
    name: RunName | None,
    meta: Callable[[RunName], RunMeta],
    summary: Callable[[], Mapping[str, object]],
    written: Callable[[Path | None], None],
    *,
    waits: bool,
) -> Iterator[Recorder]:
    """Record into the file `name`, into none where it is None.

    `meta` describes the run before its first row, `summary` is its result in the end, and `written` is told what the
    file is called then. `waits` says that the machine's time stands still while a slow disk is waited for.
    """
    if name is None:
        yield NullRecorder()
        return
    from edmctl.record.background import BackgroundWriter

    def summarize() -> None:
        writer.append(Summary(render_json(summary(), is_exact=True)))

    writer = BackgroundWriter.create(name.path, meta(name), waits=waits)
    try:
        yield writer
    except BaseException as error:
        with suppress(RunFileError):
            summarize()
        written(writer.abandon(*ending(error)))
        raise
    try:
        summarize()
        written(writer.finish("done", 0))
    except RunFileError:
        # The final name may be another run's now.
        written(name.partial if name.partial.exists() else None)
        raise


def ending(error: BaseException) -> tuple[str, int]:
    """Status and exit code of a run file whose command ended with `error`."""
    if isinstance(error, KeyboardInterrupt):  # a notebook's, where no stop request was handed in
        return MEANING[ExitCode.INTERRUPT].partition(" (")[0], int(ExitCode.INTERRUPT)
    if not isinstance(error, EdmError):
        return "internal error", int(ExitCode.INTERNAL)
    code = error_exit_code(error)
    if error.code == NOT_SHOWN_CODE:
        return Verdict.NOT_SHOWN.value, code
    return MEANING[ExitCode(code)].partition(" (")[0], code
