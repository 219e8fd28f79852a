"""One job from a request to a result: what `machine` does once and `simulate` many times."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError, PreconditionError, RunFileError
from edmctl.jobs.calibration.selection import ModelUsed
from edmctl.jobs.connected_run import connected_run, ending
from edmctl.jobs.ledger.job_ledger import DONE, JobLedger
from edmctl.jobs.plan import Plan
from edmctl.jobs.resume.checkpoint import JobCheckpoint, tell_way_on
from edmctl.jobs.run_header import RunName
from edmctl.jobs.session import MachineSession
from edmctl.jobs.surroundings import Warn
from edmctl.jobs.truth import TrueWear, channel_truth, keep_truth_map
from edmctl.jsonout import JsonValue
from edmctl.labels import marked
from edmctl.procedures.job import Job
from edmctl.procedures.job_state import JobTally, StateStore
from edmctl.process.erosion import corner_radius_um, roughness_rz_um
from edmctl.record.rows import Recorder
from edmctl.results.job import ChannelResult, ChannelTruth, JobResult, SiteResult, SiteTruth
from edmctl.results.progress import Observer
from edmctl.results.result import Result, html_table
from edmctl.wording import length

if TYPE_CHECKING:
    from edmctl.simulator.bench import HoleTruth


SAME_HOLE_UM = 50.0
"""Farther away no hole is the site's: many times what the stages miss a place by, less than two holes lie apart."""


@dataclass(frozen=True, slots=True, repr=False)
class Report(Result):
    """What a job reached, whether it ended well or with `error`.

    `truths` has one entry per site, and none on any machine but a virtual one in this process.

    `model` says where its estimated displacements come from, None where the job ended before that was known.
    `run_file` is the run's own file as it is called now, if it has one.
    """

    simulated: bool
    job: JobResult
    truths: tuple[SiteTruth, ...]
    error: EdmError | None
    run_file: Path | None
    model: ModelUsed | None
    channel_truth: ChannelTruth | None = None
    drift_file: str = ""
    """What the wear was corrected by, in words; empty without."""
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
    """Run the job on the machine that the plan names, into the run file `name` where there is one.

    `seed` is that of a virtual bench that is not there yet.

    `warn` is told what is doubtful about calibration and tool before anything moves. Where `serial` names the
    machine that the job is for, another one is refused (E8214). Expected errors come back in the report, with what
    was reached until then.
    """
    tally = JobTally()
    true_wear: TrueWear | None = None

    def prepare(session: MachineSession) -> Callable[[Recorder], None]:
        plan = session.plan
        _refuse_other_machine(session.bench.machine.identity.serial, serial)
        kept = JobCheckpoint(plan, session, name)
        entries = JobLedger(plan, session, name, kept, warn or (lambda _: None))
        kept.refuse()
        job = entries.job(plan.resumed.run_files if plan.resumed else ())
        return lambda recorder: act(session, entries, kept, job, recorder)

    def act(
        session: MachineSession, entries: JobLedger, kept: JobCheckpoint, job: Job, recorder: Recorder
    ) -> None:
        nonlocal true_wear
        journal: StateStore = entries
        if session.bench.virtual:
            journal = true_wear = TrueWear(session.bench.virtual, entries)
            entries.truth = {"tool_wear_um": true_wear.before_um}
            kept.truth = true_wear.as_mapping
            if plan.resumed is not None and plan.resumed.journal.truth is not None:
                true_wear.go_on_from(plan.resumed.journal.truth)
                if plan.resumed.restart_hole:
                    true_wear.leave_hole()
        try:
            _run(session, entries, kept, job, recorder, observer, tally, journal)
        finally:
            if session.bench.virtual and session.plan.loaded.profile.path is not None:
                keep_truth_map(recorder, session.bench.virtual)

    def summary(session: MachineSession) -> dict[str, object]:
        return _report(session, tally, true_wear).as_mapping()

    session = connected_run(plan, seed, observer, name, warn, prepare, summary)
    if session.error is not None:
        tell_way_on(session.error, plan, name)
    return _report(session, tally, true_wear)


def _refuse_other_machine(found: str, wanted: str) -> None:
    if wanted and found != wanted:
        raise PreconditionError(
            f"The machine that answers is {found}, and the runs before were made on {wanted}.",
            hint="Connect that one again: places and tool are known of it alone.",
            code="E8214",
        )


def _run(
    session: MachineSession,
    entries: JobLedger,
    kept: JobCheckpoint,
    job: Job,
    recorder: Recorder,
    observer: Observer,
    tally: JobTally,
    journal: StateStore,
) -> None:
    """Run the job, and write down in the job ledger that it begins and what it came to.

    Its journal comes first: whoever finds a job in the ledger can go on with it.
    """
    from edmctl.procedures.machining import run_job

    job = kept.begin(job)
    entries.begin()
    try:
        try:
            run_job(
                session.bench.machine, job, recorder=recorder, observer=observer, tally=tally, store=journal
            )
        finally:
            session.leaves(tally.creep_left)
    except BaseException as error:
        with suppress(RunFileError):
            entries.close(tally.result(), ending(error)[0])
        with suppress(RunFileError):
            kept.leave(error)
        raise
    entries.close(tally.result(), DONE)
    kept.end()


def _report(session: MachineSession, tally: JobTally, true_wear: TrueWear | None) -> Report:
    plan, virtual, job = session.plan, session.bench.virtual, tally.result()
    truths: tuple[SiteTruth, ...] = ()
    if virtual and true_wear:
        diameter_um = plan.loaded.profile.tool.diameter_um
        truths = tuple(
            dataclasses.replace(
                truth, corner_um=corner_radius_um(true_wear.at_end_of(site.name), diameter_um)
            )
            for site, truth in zip(job.sites, truths_of(job.sites, virtual.truth(), true_wear), strict=True)
        )
    simulated = session.bench.machine.identity.simulated
    used = session.choice.used if session.choice else None
    channel = None
    if virtual and true_wear and job.channel is not None:
        channel = channel_truth(plan.loaded.profile, virtual, virtual.tool_wear_um - true_wear.before_um)
    drift = session.drift.text if session.drift else ""
    seed = session.bench.seed
    return Report(
        simulated,
        job,
        truths,
        session.error,
        session.run_file,
        used,
        channel,
        drift,
        seed,
        plan.setup.as_mapping(),
    )


def truths_of(
    sites: Sequence[SiteResult], holes: Sequence[HoleTruth], true_wear: TrueWear
) -> tuple[SiteTruth, ...]:
    """The true hole of each site, in µm: the nearest one, and what the tool lost while it was made.

    A hole through the sheet has no depth.
    """
    truths = []
    for site in sites:
        hole = min(holes, key=lambda hole: _apart_um(hole, site), default=None)
        wear_um = true_wear.of_site(site.name)
        if hole is None or _apart_um(hole, site) > SAME_HOLE_UM:
            truths.append(SiteTruth(wear_um=wear_um))
            continue
        depth_um = math.nan if site.through else hole.depth_um
        rz_um = roughness_rz_um(hole.ra_um)
        truths.append(SiteTruth(depth_um, wear_um, hole.side_gap_um, hole.taper_um, hole.ra_um, rz_um))
    return tuple(truths)


def _depth(made: SiteResult | ChannelResult) -> str:
    """Return the depth with its mark, or that the hole goes through the sheet."""
    if isinstance(made, SiteResult) and made.through:
        return "through"
    return marked(length(made.depth_um, made.depth_u95_um), made.depth_basis)


def _apart_um(hole: HoleTruth, site: SiteResult) -> float:
    return math.hypot(hole.x_um - site.x_um, hole.y_um - site.y_um)
