"""One job from an order to a result: what `machine` does once and `simulate` many times."""

from __future__ import annotations

import dataclasses
import math
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING

from edmctl.cli.bench import Where, connected, introduction, where_is
from edmctl.cli.calibrated import choose, look_at_named, refuse_unasked
from edmctl.cli.exitcodes import MEANING, ExitCode, error_exit_code
from edmctl.cli.runfile import run_meta
from edmctl.console.jsonout import render_json
from edmctl.errors import EdmError, RunFileError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from edmctl.cli.bench import Bench
    from edmctl.cli.calibrated import Choice, ModelUsed
    from edmctl.cli.runfile import RunName
    from edmctl.errors import Diagnostic
    from edmctl.procedures.results import JobResult, Ledger, Observer
    from edmctl.profile.forecast import Forecast
    from edmctl.profile.load import LoadedProfile
    from edmctl.profile.setup import Setup
    from edmctl.record.recorder import Recorder
    from edmctl.simulator.bench import HoleTruth


@dataclass(frozen=True, slots=True)
class Order:
    """What the command line asks for, in plain values that travel to worker processes."""

    profile: str | None
    overrides: tuple[str, ...]
    setup: Path | None
    port: str | None
    calibration: Path | None = None
    allow_model: bool = False
    wait_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Plan:
    """A checked order. `simulated` is None where only the machine itself will tell, once it is connected."""

    where: Where
    simulated: bool | None
    loaded: LoadedProfile
    setup: Setup
    setup_text: str
    forecast: Forecast
    calibration: Path | None = None


@dataclass(frozen=True, slots=True)
class Truth:
    """A hole as the plant knows it; NaN where there is none."""

    depth_um: float = math.nan
    wear_um: float = math.nan


@dataclass(slots=True)
class Written:
    """What the run file is called once it is closed."""

    path: Path | None = None


@dataclass(frozen=True, slots=True)
class Report:
    """What a job reached, whether it ended well or with `error`.

    `truths` has one entry per site, and none on any machine but a virtual one in this process.

    `model` says where its estimated displacements come from, None where the job ended before that was known.
    `run_file` is the run's own file as it is called now, if it has one.
    """

    simulated: bool
    job: JobResult
    truths: tuple[Truth, ...]
    error: EdmError | None
    run_file: Path | None
    model: ModelUsed | None

    def as_mapping(self) -> dict[str, object]:
        """Return the `result` of the JSON object."""
        mapping = dataclasses.asdict(self.job)
        mapping["calibration"] = dataclasses.asdict(self.model) if self.model else None
        mapping["sites"] = [
            {**site, "truth": dataclasses.asdict(truth) if truth else None}
            for site, truth in zip_longest(mapping["sites"], self.truths)
        ]
        return mapping


def check(order: Order) -> Plan:
    """Load and check everything the order names.

    Raises ProfileError, RecordError, UsageError, LinkLost, PreconditionError.
    """
    if order.profile is None:
        raise UsageError(
            "No profile was named.",
            hint="Say --profile NAME|FILE or set EDMCTL_PROFILE; `--profile cu270` takes a shipped one.",
            code="E2002",
        )
    from edmctl.profile.forecast import forecast
    from edmctl.profile.load import load_profile, load_setup

    setup = load_setup(order.setup)
    where = where_is(order.port, setup, order.wait_s)
    loaded = load_profile(order.profile, order.overrides, setup=setup)
    refuse_unasked(setup, allow_model=order.allow_model)
    look_at_named(order.calibration, setup, loaded.profile)
    return Plan(
        where=where,
        simulated=True if where.in_process else None,
        loaded=loaded,
        setup=setup,
        setup_text=order.setup.read_text(encoding="utf-8") if order.setup else "",
        forecast=forecast(loaded.profile, setup),
        calibration=order.calibration,
    )


def carry_out(
    plan: Plan,
    seed: int,
    observer: Observer,
    name: RunName | None,
    warn: Callable[[Sequence[Diagnostic]], None] | None = None,
) -> Report:
    """Run the job on the machine that the plan names, into the run file `name` where there is one.

    `seed` is that of a fresh virtual bench.

    `warn` is told what is doubtful about the calibration before anything moves. Expected errors come back in the
    report, with what was reached until then.
    """
    from edmctl.procedures.job import single_hole
    from edmctl.procedures.machining import run_job
    from edmctl.procedures.results import Ledger

    ledger = Ledger()
    error: EdmError | None = None
    written = Written()
    choice: Choice | None = None
    with connected(plan.loaded, plan.setup, seed, observer.note, plan.where) as bench:
        try:
            identity = bench.machine.identity
            choice = choose(plan.calibration, plan.setup, plan.loaded.profile, identity.serial)
            if warn is not None:
                warn(choice.warnings)
            with _recorder(plan, seed, bench, name, ledger, written, choice) as recorder:
                observer.note(f"{introduction(plan.where, identity, seed)}{_into(name)}")
                run_job(
                    bench.machine,
                    single_hole(plan.loaded.profile, plan.setup, choice.actuator),
                    recorder=recorder,
                    observer=observer,
                    ledger=ledger,
                )
        except EdmError as expected:
            error = expected
        return _report(bench, ledger, choice, error, written.path)


@contextmanager
def _recorder(
    plan: Plan,
    seed: int,
    bench: Bench,
    name: RunName | None,
    ledger: Ledger,
    written: Written,
    choice: Choice,
) -> Iterator[Recorder]:
    """Record into the file `name`, which gets its summary, status and end however the job ends.

    `written` is told what the file is called then.
    """
    if name is None:
        from edmctl.record.recorder import NullRecorder

        yield NullRecorder()
        return
    from edmctl.record.writer import RunWriter

    def summarize() -> None:
        writer.summary(render_json(_report(bench, ledger, choice).as_mapping()))

    writer = RunWriter.create(
        name.path, run_meta(name, plan, seed if bench.virtual else None, bench.machine.identity, choice)
    )
    try:
        yield writer
    except BaseException as error:
        with suppress(RunFileError):
            summarize()
        written.path = writer.abandon(*_ending(error))
        raise
    try:
        summarize()
        written.path = writer.finish("done", 0)
    except RunFileError:
        # The final name may be another run's now.
        written.path = name.partial if name.partial.exists() else None
        raise


def _ending(error: BaseException) -> tuple[str, int]:
    """Status and exit code of a run file whose job ended with `error`."""
    if not isinstance(error, EdmError):
        return "internal error", int(ExitCode.INTERNAL)
    code = error_exit_code(error)
    return MEANING[ExitCode(code)].partition(" (")[0], code


def _into(name: RunName | None) -> str:
    return f", into {name.path}" if name else ""


def _report(
    bench: Bench,
    ledger: Ledger,
    choice: Choice | None,
    error: EdmError | None = None,
    run_file: Path | None = None,
) -> Report:
    virtual, job = bench.virtual, ledger.result()
    places = [(site.x_um, site.y_um) for site in job.sites]
    truths = truths_of(places, virtual.truth(), virtual.tool_wear_um) if virtual else ()
    used = choice.used if choice else None
    return Report(bench.machine.identity.simulated, job, truths, error, run_file, used)


def truths_of(
    places: Sequence[tuple[float, float]], holes: Sequence[HoleTruth], tool_wear_um: float
) -> tuple[Truth, ...]:
    """The true hole of each place in µm: the nearest one.

    The wear is the tool's whole wear: the virtual tool is new at the first site, and there is one site.
    """
    if not holes:
        return tuple(Truth() for _ in places)
    nearest = (
        min(holes, key=lambda hole: math.hypot(hole.x_um - x_um, hole.y_um - y_um)) for x_um, y_um in places
    )
    return tuple(Truth(hole.depth_um, tool_wear_um) for hole in nearest)
