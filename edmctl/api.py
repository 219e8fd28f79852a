"""The Python API: the jobs of the command line, for notebooks, studies and services.

    import edmctl

    with edmctl.connect("sim:", seed=1) as machine:
        report = machine.machine("cu270", overrides={"target.depth_um": 20})
    report.sites[0].depth_um

The API uses no terminal, signals or environment variables; every function may be called in any thread. Names of
`edmctl` itself are loaded when they are used.
"""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from operator import index
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Self, SupportsIndex, TypedDict, TypeVar, Unpack

from edmctl import failures
from edmctl.dataclasses import dataclass, field
from edmctl.errors import Diagnostic
from edmctl.files import user_path
from edmctl.jobs.connect import controller_warning, known_controller, seed_warning
from edmctl.jobs.plan import SIMULATOR, TOUCHES_LIKE, JobRequest, Plan, check, where_is
from edmctl.jobs.run_header import name_run, plain_name
from edmctl.jobs.surroundings import Surroundings, Unobserved, Warn, python_warnings
from edmctl.jobs.sweep import seed_to_use
from edmctl.machine.stop import StopRequest
from edmctl.profile.folders import HOME_VARIABLE, as_value
from edmctl.results.progress import Observer
from edmctl.results.result import Forecast
from edmctl.start_up import refuse_wrong_clock
from edmctl.toml_text import toml_value

__all__ = [
    "Machine",
    "StopRequest",
    "calibrate_files",
    "connect",
    "forecast",
    "load_profile",
    "open_run",
    "simulate",
]

if TYPE_CHECKING:
    from edmctl.jobs.calibrate import CalibrationReport, CalibrationRequest
    from edmctl.jobs.job import Report
    from edmctl.jobs.procedures import Procedure, ProcedureReport
    from edmctl.planning.rules.load import LoadedProfile
    from edmctl.record.reader import RunFile

    Overrides = Mapping[str, object] | Iterable[str]
    File = str | PathLike[str]

RUNS = "runs"
"""The folder of run files, as on the command line."""
F = TypeVar("F", bound=Callable[..., object])


class CallOptions(TypedDict, total=False):
    """Options of all calls.

    observer : gets progress and decisions in the calling thread, and in another one the note of a compilation
    stop : `stop.request(signal.SIGINT)` ends the call in order, from any thread
    warn : gets warnings before anything moves; default: an `edmctl.errors.EdmWarning` of Python for each
    """

    observer: Observer | None
    stop: StopRequest | None
    warn: Warn | None


class RunOptions(CallOptions, total=False):
    """Options of calls that make a run file.

    overrides : values by key (`{"target.depth_um": 20}`), or texts as `--set` takes them
    out, run_id : folder and name of the run file; default: a name with the time in the folder `runs`
    calibration : the calibration file; default: that of the setup or the machine's own
    allow_model : without a displacement sensor, use the calibrated actuator alone
    """

    overrides: Overrides
    out: File | None
    run_id: str | None
    calibration: File | None
    allow_model: bool


class FitOptions(CallOptions, total=False):
    """Options of a calibration.

    output : calibration file to write; default: the machine's own, none for files
    validate, refit : files to validate the model on, and what is fitted to each before: "zero" or "gain,zero"
    previous_v : held before the first sample, V: once, or once for each file, those to validate last
    delay_s : delay of the displacement; fitted by default
    """

    output: File | None
    validate: File | Sequence[File]
    refit: str
    previous_v: Sequence[float]
    delay_s: float | None


@dataclass(frozen=True, slots=True)
class _Options:
    """The options of a call, checked. Raises TypeError."""

    overrides: Overrides = ()
    out: File | None = None
    run_id: str | None = None
    calibration: File | None = None
    allow_model: bool = False
    output: File | None = None
    validate: File | Sequence[File] = ()
    refit: str = "zero"
    previous_v: Sequence[float] = ()
    delay_s: float | None = None
    observer: Observer | None = None
    stop: StopRequest | None = None
    warn: Warn | None = None
    new_tool: bool = False

    def __post_init__(self) -> None:
        observer, stop, warn = self.observer, self.stop, self.warn
        if observer is not None and not (hasattr(observer, "progress") and hasattr(observer, "note")):
            raise TypeError(f"observer has to have the methods progress and note; {observer!r} has not")
        if not isinstance(stop, StopRequest | None):
            raise TypeError(f"stop has to be an edmctl.StopRequest, not {type(stop).__name__}")
        if not (warn is None or callable(warn)):
            raise TypeError(f"warn has to be called with warnings, and {warn!r} cannot be")
        # Both let a machine do more than usual.
        for name, flag in (("allow_model", self.allow_model), ("new_tool", self.new_tool)):
            if not isinstance(flag, bool):
                raise TypeError(f"{name} has to be True or False, not {flag!r}")

    @property
    def watched(self) -> Observer:
        """The observer, or one that ignores everything."""
        return self.observer or Unobserved()

    def doubt(self, warnings: Sequence[Diagnostic]) -> None:
        """Pass warnings on, if there are any."""
        if warnings:
            (self.warn or python_warnings)(warnings)


def _with(options: type) -> Callable[[F], F]:
    """Show `options` one by one in the signature of a function, as help() and notebooks print it."""
    defaults = inspect.signature(_Options).parameters

    def shown(function: F) -> F:
        signature = inspect.signature(function)
        own = [one for one in signature.parameters.values() if one.kind is not one.VAR_KEYWORD]
        common = [
            defaults[name].replace(kind=inspect.Parameter.KEYWORD_ONLY) for name in options.__annotations__
        ]
        function.__signature__ = signature.replace(parameters=[*own, *common])  # type: ignore[attr-defined]
        return function

    return shown


@dataclass(frozen=True, slots=True)
class Machine:
    """A machine by the name of its port, as `connect` returns it.

    Each call is a session of its own, as a command is: every call makes a new virtual machine (`sim:`), and
    `sim:FILE` keeps its workpiece and tool. Expected errors of a job are in its report; errors before it starts
    are raised. `profile` is the name of a shipped profile, or a TOML file; `RunOptions` and `CallOptions` describe
    the options that calls have in common.
    """

    port: str
    """Selector of the port."""
    seed: int | None
    """Seed of a new virtual machine; None takes a new seed for each call."""
    _setup: Path | None = field(default=None, repr=False)
    _wait_s: float = field(default=0.0, repr=False)
    _home: Path | None = field(default=None, repr=False)
    _controller: str = field(default="", repr=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: no resource stays open between calls."""

    @_with(RunOptions)
    def machine(self, profile: File, *, new_tool: bool = False, **options: Unpack[RunOptions]) -> Report:
        """Machine a job, as `edmctl machine` does.

        Without `out`, a new virtual machine leaves no run file; any other machine has it in `runs`, with ledger and
        journal. `new_tool` means that the electrode was changed.

        Raises ProfileError, UsageError, RecordError, RunFileError, and LinkLost, ProtocolMismatch or
        PreconditionError if no machine was connected; an error on the machine is `report.error`.
        """
        from edmctl.jobs.job import carry_out

        call = _Options(new_tool=new_tool, **options)
        plan, name = self._plan(profile, call), None
        out = RUNS if call.out is None and plan.where.lasting else call.out
        if out is not None:
            name = name_run(_file("out", out), call.run_id, plan.loaded, datetime.now(UTC))
        elif call.run_id is not None:
            raise failures.run_id_without_folder(run_id=call.run_id)
        return carry_out(plan, seed_to_use(self.seed), call.watched, name, call.doubt)

    @_with(CallOptions)
    def resume(
        self,
        run: File,
        *,
        out: File = RUNS,
        homed: bool = False,
        restart_hole: bool = False,
        **options: Unpack[CallOptions],
    ) -> Report:
        """Resume the job of an interrupted run: its file, or its id in `out`.

        `homed`: the stages are where the restarted controller counts them. `restart_hole`: the interrupted hole is
        made from the start. Raises PreconditionError E8050 to E8062 if the run cannot be resumed, and as `machine`.
        """
        from edmctl.jobs.job import carry_out
        from edmctl.jobs.resume import checked, find_run, name_of_resumed
        from edmctl.jobs.runs.opening import recovered_before

        call = _Options(**options)
        resumption = find_run(str(run), _file("out", out), homed=homed, restart_hole=restart_hole)
        plan = checked(resumption, self.port, self._wait_s, self._surroundings(call))
        call.doubt(recovered_before(resumption))
        call.doubt(plan.loaded.warnings)
        name = name_of_resumed(resumption, None, datetime.now(UTC))
        return carry_out(plan, seed_to_use(self.seed), call.watched, name, call.doubt)

    @_with(RunOptions)
    def approach(
        self,
        profile: File,
        *,
        contact: bool = False,
        site_um: tuple[float, float] | None = None,
        **options: Unpack[RunOptions],
    ) -> ProcedureReport:
        """Feed the tool to the spark gap, or with `contact` to the surface, report its position, retract.

        `site_um` are stage coordinates; default: the place of the next hole of `machine`. Raises as `machine`; in
        the report, E8042 a hole is there, E8044 the tool does not reach the surface.
        """
        from edmctl.jobs.procedures import Approach

        call = _Options(**options)
        return self._perform(Approach(self._plan(profile, call), site_um, contact=contact), call)

    @_with(RunOptions)
    def jump_flush(self, profile: File, *, count: int = 10, **options: Unpack[RunOptions]) -> ProcedureReport:
        """Make electrode jumps next to the workpiece, without sparks, and measure them. Raises as `machine`."""
        from edmctl.jobs.procedures import JUMPS_ALONE, Jumps

        call = _Options(**options)
        plan, count = self._plan(profile, call, JUMPS_ALONE), index(count)
        if count < 1:
            raise failures.count_too_small(count=count)
        return self._perform(Jumps(plan, count), call)

    @_with(RunOptions)
    def measure_wear(
        self,
        profile: File | None = None,
        *,
        reference: bool = False,
        site: str | None = None,
        new_tool: bool = False,
        **options: Unpack[RunOptions],
    ) -> ProcedureReport:
        """Touch the pad and the last hole to measure wear since the reference; with `reference`, touch that.

        `site` names another hole of the ledger in `out`. Without a profile it measures the tool last in use, with
        the recipe of the run that made the hole. Raises as `machine`; in the report, E8041 there is no reference,
        E8045 no such hole.
        """
        from edmctl.jobs.measure_wear import ReferenceTouch, WearMeasurement

        if not isinstance(site, str | None):
            raise TypeError(f"site has to be the name of a hole, not {type(site).__name__}")
        call = _Options(new_tool=new_tool, **options)
        plan = self._plan(profile, call)
        return self._perform(ReferenceTouch(plan) if reference else WearMeasurement(plan, site), call)

    @_with(RunOptions)
    def measure_drift(
        self,
        profile: File | None = None,
        *,
        duration_s: float | None = None,
        output: File | None = None,
        **options: Unpack[RunOptions],
    ) -> ProcedureReport:
        """Measure sensor drift: touch the pad and hold zero voltage in turn for a quarter of an hour.

        Later jobs of the machine correct their wear with it. It is saved in `output`, else as the machine's own.
        Without a profile it measures with the tool last in use, with the recipe of its last run. Raises as
        `machine`, and UsageError E2064 if `duration_s` is too short; in the report, E7041 holds and touches are
        inconsistent.
        """
        from edmctl.jobs.procedures import DriftMeasurement

        call = _Options(**options)
        return self._perform(DriftMeasurement(self._plan(profile, call), duration_s, _path(output)), call)

    @_with(FitOptions)
    def calibrate(self, **options: Unpack[FitOptions]) -> CalibrationReport:
        """Drive the actuator for seven minutes next to the workpiece, measure it, fit a model, and save it.

        It is saved in `output`, else as the machine's own calibration, which all later calls use; a new `sim:` has
        no own calibration.

        Raises the errors that a report of `machine` would contain, such as Interrupted, and RecordError if the
        record allows no fit: then a warning names the file that keeps it.
        """
        from edmctl.jobs import calibrate

        call = _Options(**options)
        request = replace(_calibration((), call), setup=self._setup, port=self.port)
        request = replace(request, wait_s=self._wait_s, controller=self._controller)
        checked = calibrate.check(request, self._surroundings(call))
        call.doubt(checked.doubts)
        report = calibrate.calibrate_machine(checked, seed_to_use(self.seed), call.watched, call.doubt)
        call.doubt(report.warnings)
        return report

    def _plan(self, profile: File | None, call: _Options, changes: Sequence[str] = ()) -> Plan:
        """Return the checked plan; without a profile the machine's tool is used as it is."""
        driven = (f"sim.controller={self._controller}",) if self._controller else ()
        request = JobRequest(
            profile=_profile(TOUCHES_LIKE if profile is None else profile),
            overrides=(*_texts(call.overrides), *changes, *driven),
            setup=self._setup,
            port=self.port,
            calibration=_path(call.calibration),
            allow_model=call.allow_model,
            wait_s=self._wait_s,
            new_tool=call.new_tool,
        )
        plan = check(request, self._surroundings(call))
        call.doubt(plan.loaded.warnings)
        return replace(plan, names_tool=profile is not None)

    def _surroundings(self, call: _Options) -> Surroundings:
        environ = {} if self._home is None else {HOME_VARIABLE: str(self._home)}
        surroundings = Surroundings(command=("edmctl", "(Python)"), environ=environ)
        stop = call.stop
        return surroundings if stop is None else replace(surroundings, stop=lambda _: stop)

    def _perform(self, procedure: Procedure, call: _Options) -> ProcedureReport:
        from edmctl.jobs.procedures import name_of, perform

        out = _file("out", RUNS if call.out is None else call.out)
        name = name_of(procedure.plan, procedure.name, out, call.run_id)
        return perform(procedure, name, seed_to_use(self.seed), call.watched, call.doubt)


def connect(
    port: File = SIMULATOR,
    *,
    seed: SupportsIndex | None = None,
    setup: File | None = None,
    wait_s: float = 0.0,
    home: File | None = None,
    controller: str | None = None,
) -> Machine:
    """Return the machine at a port: `sim:`, `sim:FILE`, a serial port, `socket://HOST:PORT`, `serial:ID` or `auto`.

    seed : of a new virtual machine; default: a new one each time; EdmWarning W4101 if the machine exists already
    setup : TOML file of the machine's setup
    wait_s : how long to wait for a port in use
    home : folder of the machines' own calibrations; default: that of the user
    controller : drives a new virtual machine: "firmware", "firmware-float"; default: `sim.controller`; EdmWarning
        W4102 at a port, where it has no effect

    Raises UsageError E2006 for an empty name, E2005 for an invalid seed, E2049 for an unknown controller.
    """
    from edmctl.profile.setup import Setup

    seed = None if seed is None else seed_to_use(seed)
    refuse_wrong_clock()
    if not isinstance(port, str | PathLike):
        raise TypeError(f"port has to be a name or a path, not {type(port).__name__}")
    where, call = where_is(str(port), Setup()), _Options()
    call.doubt(seed_warning(where, seed))
    if controller is not None:
        call.doubt(controller_warning(where, known_controller(controller)))
    return Machine(where.selector, seed, _path(setup), wait_s, _path(home), controller or "")


def simulate(
    profile: File,
    seeds: Iterable[SupportsIndex],
    *,
    overrides: Overrides = (),
    sweep: Mapping[str, Sequence[object]] | None = None,
    setup: File | None = None,
    out: File | None = None,
    calibration: File | None = None,
    allow_model: bool = False,
    home: File | None = None,
    stop: StopRequest | None = None,
    warn: Warn | None = None,
) -> list[Report]:
    """Machine a job on new virtual machines: every combination of the sweep's values, with every seed.

    The reports are in the order of `itertools.product` of the values, the seeds innermost. Run files in `out` are
    named after profile or values, and seed. A failed run is a report with its error; a stop ends the series with the
    report of the run that it ended.

    Raises as `Machine.machine`, before anything runs.
    """
    from edmctl.jobs.batch import Task, check_names

    fresh = connect(setup=setup, home=home)
    machines = [connect(seed=seed, setup=setup, home=home) for seed in seeds]
    call = _Options(overrides, out, None, calibration, allow_model, stop=stop, warn=warn)
    texts, tasks = _texts(overrides), list[tuple[Machine, Task]]()
    for values in itertools.product(*_steps(sweep or {})):
        steps = _texts(dict(zip(sweep or {}, values, strict=True)))
        plan = fresh._plan(profile, replace(call, overrides=(*texts, *steps), warn=lambda _: None))
        name = plain_name("-".join(steps) or plan.loaded.path.stem)
        for machine in machines:
            assert machine.seed is not None
            task = Task(plan.request, machine.seed, _path(out), f"{name}-seed{machine.seed}")
            tasks.append((machine, task))
    check_names([task for _, task in tasks])
    reports: list[Report] = []
    for machine, task in tasks:
        if stop is not None and stop.signal_number is not None:
            break
        report = machine.machine(
            profile,
            overrides=task.request.overrides,
            out=out,
            run_id=task.run_id if out is not None else None,
            calibration=calibration,
            allow_model=allow_model,
            stop=stop,
            warn=call.doubt,
        )
        reports.append(report)
    return reports


@_with(FitOptions)
def calibrate_files(files: File | Sequence[File], **options: Unpack[FitOptions]) -> CalibrationReport:
    """Fit measured data: one file or several, CSV or HDF5 with t_s, u_V and y_um (s, V, µm, of one length), or runs.

    Raises UsageError, RecordError if a file cannot be used or allows no fit, RunFileError.
    """
    from edmctl.jobs import calibrate

    refuse_wrong_clock()
    call = _Options(**options)
    checked = calibrate.check(_calibration(files, call), Surroundings())
    call.doubt(checked.doubts)
    report = calibrate.calibrate_files(checked, call.watched)
    call.doubt(report.warnings)
    return report


def _calibration(files: File | Sequence[File], call: _Options) -> CalibrationRequest:
    from edmctl.jobs.calibrate import CalibrationRequest

    return CalibrationRequest(
        sources=_files("files", files),
        validation=_files("validate", call.validate),
        refit=call.refit,
        previous_v=tuple(call.previous_v),
        delay_s=call.delay_s,
        output=_path(call.output),
    )


def load_profile(profile: File, *, overrides: Overrides = ()) -> LoadedProfile:
    """Load and check a profile. Raises ProfileError with every diagnostic."""
    from edmctl.planning.rules.load import load_profile as load

    return load(_profile(profile), _texts(overrides))


def forecast(profile: File, *, overrides: Overrides = (), setup: File | None = None) -> Forecast:
    """Return time, feed, stroke and wear of a job. Raises ProfileError."""
    from edmctl.planning.rules.load import load_profile as load
    from edmctl.profile.setup import load_setup

    return load(_profile(profile), _texts(overrides), setup=load_setup(_path(setup))).forecast


def open_run(path: File) -> RunFile:
    """Open a run file to read, also one that is being written. Raises RunFileError."""
    from edmctl.record.reader import open_run as opened

    return opened(_file("path", path))


def _profile(given: File) -> str:
    """Return `given` as for --profile: a text is a name or a path, a `Path` is always a path."""
    if isinstance(given, str):
        return given
    if not isinstance(given, PathLike):
        raise TypeError(f"profile has to be a name or a path, not {type(given).__name__}")
    return as_value(Path(given))


def _texts(overrides: Overrides) -> tuple[str, ...]:
    if isinstance(overrides, str):
        return (overrides,)
    if isinstance(overrides, Mapping):
        for key, value in overrides.items():
            try:
                toml_value(value)
            except TypeError as error:
                raise TypeError(f"{key}: {error}") from None
        return tuple(f"{key}={toml_value(value)}" for key, value in overrides.items())
    texts = tuple(overrides)
    for text in texts:
        if not isinstance(text, str):
            raise TypeError(f"overrides have to be a mapping or texts like 'key=value', not {text!r}")
    return texts


def _steps(sweep: Mapping[str, Sequence[object]]) -> list[list[object]]:
    if not isinstance(sweep, Mapping):
        raise TypeError(f"sweep has to be a mapping of keys to values, not {type(sweep).__name__}")
    for key, values in sweep.items():
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise TypeError(f"sweep: {key} has to have several values, like [{values!r}]")
    return [list(values) for values in sweep.values()]


def _file(name: str, given: File) -> Path:
    if not isinstance(given, str | PathLike):
        raise TypeError(f"{name} has to be a path, not {type(given).__name__}")
    return user_path(given)


def _files(name: str, given: File | Sequence[File]) -> tuple[Path, ...]:
    """One path or several."""
    if isinstance(given, str | PathLike):
        return (user_path(given),)
    return tuple(_file(name, one) for one in given)


def _path(file: File | None) -> Path | None:
    return None if file is None else _file("a file", file)
