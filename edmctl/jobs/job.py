"""The main job, from a checked plan to a report."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError, ObjectiveNotReached, PreconditionError, RunFileError
from edmctl.jobs.corrections import ModelUsed
from edmctl.jobs.job_keeper import JobKeeper
from edmctl.jobs.plan import Plan
from edmctl.jobs.resume import find_run, refuse_elsewhere, refuse_untouchable
from edmctl.jobs.run_context import RunContext, connected_run
from edmctl.jobs.run_header import RunName
from edmctl.jobs.runs.opening import resume_command
from edmctl.jobs.surroundings import Warn
from edmctl.jobs.truth import channel_truth, truths_of
from edmctl.jsonout import JsonValue
from edmctl.labels import marked
from edmctl.procedures.machining import run_job
from edmctl.results.job import ChannelResult, ChannelTruth, JobResult, SiteResult, SiteTruth
from edmctl.results.progress import Observer
from edmctl.results.result import Result
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

    @property
    def _made(self) -> Sequence[SiteResult | ChannelResult]:
        return self.sites if self.channel is None else [self.channel]

    def brief(self) -> list[str]:
        """Return how many holes there are, and how deep the first one is."""
        holes = [f"{len(self.sites)} holes"] if len(self.sites) > 1 else []
        return [*holes, *(f"depth {_depth(made)}" for made in self._made[:1])]

    def rows(self) -> list[JsonValue]:
        """Return one row a hole, or the channel."""
        values = self.to_dict()
        sites = values["sites"] if self.channel is None else [values["channel"]]
        return sites if isinstance(sites, list) else []

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
    keeper: JobKeeper | None = None
    with connected_run(plan, seed, observer, name, warn) as run:
        run.check_machine()
        if serial and run.bench.serial != serial:
            raise failures.another_machine_answers(found=run.bench.serial, wanted=serial)
        keeper = JobKeeper(run)
        if plan.resumed is not None:
            refuse_elsewhere(plan.resumed, run.bench, run.ledger.lines if run.ledger else ())
        job = keeper.job()
        with run.recording("machine", lambda: _report(run, keeper).as_mapping()):
            job = keeper.begin(job)
            with keeper.writing_result():
                run_job(
                    run.bench.machine,
                    job,
                    recorder=run.recorder,
                    observer=observer,
                    tally=run.tally,
                    store=keeper,
                )
    if run.error is not None:
        add_way_on(run.error, plan, name)
    return _report(run, keeper)


def _report(run: RunContext, keeper: JobKeeper | None) -> Report:
    true_wear = keeper.true_wear if keeper else None
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


RESTARTED = "E4005"
"""The stage positions have to be confirmed after a restart of the controller."""


def add_way_on(error: EdmError, plan: Plan, name: RunName | None) -> None:
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
