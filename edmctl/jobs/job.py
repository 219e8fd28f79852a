"""The main job, from a checked plan to a report."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import zip_longest
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError, RunFileError
from edmctl.jobs.checkpoint import JobCheckpoint, tell_way_on
from edmctl.jobs.corrections import ModelUsed
from edmctl.jobs.ledger.job_ledger import DONE, JobLedger
from edmctl.jobs.plan import Plan
from edmctl.jobs.run_context import RunContext, connected_run, ending
from edmctl.jobs.run_header import RunName
from edmctl.jobs.surroundings import Warn
from edmctl.jobs.truth import TrueWear, channel_truth, keep_truth_map, truths_of
from edmctl.jsonout import JsonValue
from edmctl.labels import marked
from edmctl.procedures.job import StateStore
from edmctl.procedures.machining import run_job
from edmctl.results.job import ChannelResult, ChannelTruth, JobResult, SiteResult, SiteTruth
from edmctl.results.progress import Observer
from edmctl.results.result import Result, html_table
from edmctl.wording import length


@dataclass(frozen=True, slots=True, repr=False)
class Report(Result):
    """Result of a job, with the `error` that ended it, if any.

    truths : one entry per site on a virtual machine in this process, else empty
    model : source of estimated displacements; None if the job ended before that was known
    run_file : the file as it is called now; None without one
    """

    simulated: bool
    job: JobResult
    truths: tuple[SiteTruth, ...]
    error: EdmError | None
    run_file: Path | None
    model: ModelUsed | None
    channel_truth: ChannelTruth | None = None
    drift_file: str = ""
    """The drift file that corrected the wear, in words; empty without."""
    seed: int | None = None
    """Of the virtual machine, None on a real one and where another process served it."""
    setup: Mapping[str, object] | None = None
    """File, hash, reference pad and parking place of the setup in effect."""

    @property
    def sites(self) -> tuple[SiteResult, ...]:
        """The holes, in the order of machining."""
        return self.job.sites

    @property
    def channel(self) -> ChannelResult | None:
        """The channel, if the job makes one."""
        return self.job.channel

    @property
    def reached(self) -> bool:
        """Whether a hole or a channel was measured or left."""
        return bool(self.sites) or self.channel is not None

    def brief(self) -> list[str]:
        """Return how many holes there are, and how deep the first one is."""
        made = self.channel or (self.sites[0] if self.sites else None)
        found = [] if made is None else [f"depth {_depth(made)}"]
        return [*([f"{len(self.sites)} holes"] if len(self.sites) > 1 else []), *found]

    def rows(self) -> list[JsonValue]:
        """Return one row a hole, or the channel."""
        told = self.to_dict()
        sites = told["sites"] if self.channel is None else [told["channel"]]
        return sites if isinstance(sites, list) else []

    def _repr_html_(self) -> str:
        lines = [
            (
                one.name,
                _depth(one),
                marked(length(one.wear_um, one.wear_u95_um), one.wear_basis),
                str(one.depth_basis),
                str(one.verdict or ""),
            )
            for one in (self.sites if self.channel is None else [self.channel])
        ]
        return html_table(("site", "depth", "tool wear", "basis", "verdict"), lines, self.error)

    def as_mapping(self) -> dict[str, object]:
        """Return the `result` of the JSON object."""
        mapping = dataclasses.asdict(self.job)
        mapping["calibration"] = dataclasses.asdict(self.model) if self.model else None
        mapping["drift_file"] = self.drift_file or None
        mapping["setup"] = self.setup
        mapping["sites"] = [
            {**site, "truth": truth.as_mapping() if truth else None}
            for site, truth in zip_longest(mapping["sites"], self.truths)
        ]
        if mapping["channel"] is not None:
            mapping["channel"]["truth"] = self.channel_truth.as_mapping() if self.channel_truth else None
        return mapping


def carry_out(
    plan: Plan,
    seed: int,
    observer: Observer,
    name: RunName | None,
    warn: Warn | None = None,
    serial: str = "",
) -> Report:
    """Run the job on the machine of the plan, into the run file `name`, if any.

    `seed` makes a virtual bench that does not exist yet. `warn` gets warnings about calibration and tool before
    anything moves. If `serial` names a machine, another one is refused (E8214). The report contains an expected
    error.

    Raises LinkLost, ProtocolMismatch and RunFileError if no machine was connected.
    """
    true_wear: TrueWear | None = None
    with connected_run(plan, seed, observer, name, warn) as run:
        run.check_machine()
        _refuse_other_machine(run.bench.serial, serial)
        checkpoint = JobCheckpoint(run)
        ledger = JobLedger(run, checkpoint)
        checkpoint.refuse()
        job = ledger.job(plan.resumed.run_files if plan.resumed else ())
        with run.recording("machine", lambda: _report(run, true_wear).as_mapping()):
            store: StateStore = ledger
            if run.bench.virtual is not None:
                store = true_wear = TrueWear(run.bench.virtual, ledger)
                ledger.truth, checkpoint.truth = {"tool_wear_um": true_wear.before_um}, true_wear.as_mapping
                if plan.resumed is not None:
                    true_wear.resume(plan.resumed)
            job = checkpoint.begin(job)
            ledger.begin()
            with _kept(run, ledger, checkpoint):
                run_job(
                    run.bench.machine,
                    job,
                    recorder=run.recorder,
                    observer=observer,
                    tally=run.tally,
                    store=store,
                )
    if run.error is not None:
        tell_way_on(run.error, plan, name)
    return _report(run, true_wear)


def _refuse_other_machine(found: str, wanted: str) -> None:
    if wanted and found != wanted:
        raise failures.another_machine_answers(found=found, wanted=wanted)


@contextmanager
def _kept(run: RunContext, ledger: JobLedger, checkpoint: JobCheckpoint) -> Iterator[None]:
    """Write the result into ledger, journal and run file, however the block ends."""
    try:
        try:
            yield
        finally:
            run.note_creep()
    except BaseException as error:
        with suppress(RunFileError):
            ledger.close(run.tally.result(), ending(error)[0])
        with suppress(RunFileError):
            checkpoint.leave(error)
        raise
    else:
        ledger.close(run.tally.result(), DONE)
        checkpoint.end()
    finally:
        if run.bench.virtual and run.plan.loaded.profile.path is not None:
            keep_truth_map(run.recorder, run.bench.virtual)


def _report(run: RunContext, true_wear: TrueWear | None) -> Report:
    profile, virtual, job = run.plan.loaded.profile, run.bench.virtual, run.tally.result()
    truths: tuple[SiteTruth, ...] = ()
    channel = None
    if virtual and true_wear:
        truths = truths_of(job.sites, virtual.truth(), true_wear, profile.tool.diameter_um)
        if job.channel is not None:
            channel = channel_truth(profile, virtual, virtual.tool_wear_um - true_wear.before_um)
    return Report(
        simulated=run.bench.machine.identity.simulated,
        job=job,
        truths=truths,
        error=run.error,
        run_file=run.run_file,
        model=run.choice.used if run.choice else None,
        channel_truth=channel,
        drift_file=run.drift.text,
        seed=run.bench.seed,
        setup=run.plan.setup.as_mapping(),
    )


def _depth(made: SiteResult | ChannelResult) -> str:
    """Return the depth with its mark, or that the hole goes through the sheet."""
    if isinstance(made, SiteResult) and made.through:
        return "through"
    return marked(length(made.depth_um, made.depth_u95_um), made.depth_basis)
