"""One job from an order to a result: what `machine` does once and `simulate` many times."""

from __future__ import annotations

import dataclasses
import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING

from edmctl.cli.bench import Where, where_is
from edmctl.cli.calibrated import look_at_named, refuse_unasked
from edmctl.cli.connected_run import connected_run
from edmctl.cli.recording import ending
from edmctl.errors import RunFileError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from edmctl.cli.calibrated import ModelUsed
    from edmctl.cli.channel_truth import ChannelTruth
    from edmctl.cli.connected_run import Held
    from edmctl.cli.job_ledger import JobLedger
    from edmctl.cli.journaling import Journaling
    from edmctl.cli.resume import Resumption
    from edmctl.cli.runfile import RunName
    from edmctl.cli.true_wear import TrueWear
    from edmctl.errors import Diagnostic, EdmError
    from edmctl.procedures.job import Job
    from edmctl.procedures.journal import Journal
    from edmctl.procedures.results import JobResult, Ledger, Observer, SiteResult
    from edmctl.profile.forecast import Forecast
    from edmctl.profile.load import LoadedProfile
    from edmctl.profile.setup import Setup
    from edmctl.record.recorder import Recorder
    from edmctl.simulator.bench import HoleTruth


SAME_HOLE_UM = 50.0
"""Farther away no hole is the site's: many times what the stages miss a place by, less than two holes lie apart."""


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
    new_tool: bool = False


@dataclass(frozen=True, slots=True)
class Plan:
    """A checked order. `simulated` is None where only the machine itself will tell, once it is connected.

    `new_tool` says that the electrode was changed. Without `names_tool` the machine's tool is taken as it is.
    """

    order: Order
    where: Where
    simulated: bool | None
    loaded: LoadedProfile
    setup: Setup
    setup_text: str
    forecast: Forecast
    calibration: Path | None = None
    new_tool: bool = False
    names_tool: bool = True
    resumed: Resumption | None = None

    def tool_for(self) -> LoadedProfile | None:
        """What goes onto a virtual bench; None where a bench that is kept stays as it is."""
        return self.loaded if self.names_tool or self.where.bench_file is None else None


@dataclass(frozen=True, slots=True)
class Truth:
    """A hole as the plant knows it; NaN where there is none."""

    depth_um: float = math.nan
    wear_um: float = math.nan


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
    channel_truth: ChannelTruth | None = None

    def as_mapping(self) -> dict[str, object]:
        """Return the `result` of the JSON object."""
        mapping = dataclasses.asdict(self.job)
        mapping["calibration"] = dataclasses.asdict(self.model) if self.model else None
        mapping["sites"] = [
            {**site, "truth": dataclasses.asdict(truth) if truth else None}
            for site, truth in zip_longest(mapping["sites"], self.truths)
        ]
        if mapping["channel"] is not None:
            mapping["channel"]["truth"] = (
                dataclasses.asdict(self.channel_truth) if self.channel_truth else None
            )
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
    from edmctl.profile.read import read_source

    setup = load_setup(order.setup)
    where = where_is(order.port, setup, order.wait_s)
    loaded = load_profile(order.profile, order.overrides, setup=setup)
    refuse_unasked(setup, allow_model=order.allow_model)
    look_at_named(order.calibration, setup, loaded.profile)
    return Plan(
        order=order,
        where=where,
        simulated=True if where.in_process else None,
        loaded=loaded,
        setup=setup,
        setup_text=read_source(order.setup).text if order.setup else "",
        forecast=forecast(loaded.profile, setup, loaded.places),
        calibration=order.calibration,
        new_tool=order.new_tool,
    )


def carry_out(
    plan: Plan,
    seed: int,
    observer: Observer,
    name: RunName | None,
    warn: Callable[[Sequence[Diagnostic]], None] | None = None,
) -> Report:
    """Run the job on the machine that the plan names, into the run file `name` where there is one.

    `seed` is that of a virtual bench that is not there yet.

    `warn` is told what is doubtful about calibration and tool before anything moves. Expected errors come back in
    the report, with what was reached until then.
    """
    from edmctl.cli.job_ledger import JobLedger
    from edmctl.cli.journaling import Journaling, tell_way_on
    from edmctl.cli.true_wear import TrueWear
    from edmctl.procedures.results import Ledger

    ledger = Ledger()
    true_wear: TrueWear | None = None

    def prepare(held: Held) -> Callable[[Recorder], None]:
        kept = Journaling(plan, held, name)
        entries = JobLedger(plan, held, name, kept, warn or (lambda _: None))
        kept.refuse()
        job = entries.job(plan.resumed.run_files if plan.resumed else ())
        return lambda recorder: act(held, entries, kept, job, recorder)

    def act(held: Held, entries: JobLedger, kept: Journaling, job: Job, recorder: Recorder) -> None:
        nonlocal true_wear
        journal: Journal = entries
        if held.bench.virtual:
            journal = true_wear = TrueWear(held.bench.virtual, entries)
            entries.truth = {"tool_wear_um": true_wear.before_um}
            kept.truth = true_wear.as_mapping
            if plan.resumed is not None and plan.resumed.journal.truth is not None:
                true_wear.go_on_from(plan.resumed.journal.truth)
                if plan.resumed.restart_hole:
                    true_wear.leave_hole()
        try:
            _run(held, entries, kept, job, recorder, observer, ledger, journal)
        finally:
            if held.bench.virtual and plan.loaded.profile.path is not None:
                from edmctl.cli.channel_truth import keep_truth_map

                keep_truth_map(recorder, held.bench.virtual)

    def summary(held: Held) -> dict[str, object]:
        return _report(plan, held, ledger, true_wear).as_mapping()

    held = connected_run(plan, seed, observer, name, warn, prepare, summary)
    if held.error is not None:
        tell_way_on(held.error, plan, name)
    return _report(plan, held, ledger, true_wear)


def _run(
    held: Held,
    entries: JobLedger,
    kept: Journaling,
    job: Job,
    recorder: Recorder,
    observer: Observer,
    ledger: Ledger,
    journal: Journal,
) -> None:
    """Run the job, and write down in the job ledger that it begins and what it came to.

    Its journal comes first: whoever finds a job in the ledger can go on with it.
    """
    from edmctl.cli.job_ledger import DONE
    from edmctl.procedures.machining import run_job

    job = kept.begin(job)
    entries.begin()
    try:
        run_job(held.bench.machine, job, recorder=recorder, observer=observer, ledger=ledger, journal=journal)
    except BaseException as error:
        with suppress(RunFileError):
            entries.close(ledger.result(), ending(error)[0])
        raise
    entries.close(ledger.result(), DONE)
    kept.end()


def _report(plan: Plan, held: Held, ledger: Ledger, true_wear: TrueWear | None) -> Report:
    virtual, job = held.bench.virtual, ledger.result()
    truths = truths_of(job.sites, virtual.truth(), true_wear) if virtual and true_wear else ()
    simulated = held.bench.machine.identity.simulated
    used = held.choice.used if held.choice else None
    channel = None
    if virtual and true_wear and job.channel is not None:
        from edmctl.cli.channel_truth import channel_truth

        channel = channel_truth(plan.loaded.profile, virtual, virtual.tool_wear_um - true_wear.before_um)
    return Report(simulated, job, truths, held.error, held.run_file, used, channel)


def truths_of(
    sites: Sequence[SiteResult], holes: Sequence[HoleTruth], true_wear: TrueWear
) -> tuple[Truth, ...]:
    """The true hole of each site, in µm: the nearest one, and what the tool lost while it was made.

    A hole through the sheet has no depth that a tip below the face could be compared with.
    """
    truths = []
    for site in sites:
        hole = min(holes, key=lambda hole: _apart_um(hole, site), default=None)
        is_it = hole is not None and _apart_um(hole, site) <= SAME_HOLE_UM and not site.through
        depth_um = hole.depth_um if hole is not None and is_it else math.nan
        truths.append(Truth(depth_um, true_wear.of_site(site.name)))
    return tuple(truths)


def _apart_um(hole: HoleTruth, site: SiteResult) -> float:
    return math.hypot(hole.x_um - site.x_um, hole.y_um - site.y_um)
