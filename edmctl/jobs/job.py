"""The main job, from a checked plan to a report, the journal by which it can be resumed, and the truth beside it.

True values of a virtual machine evaluate measurements and never make them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import takewhile, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import EdmError, MachineFault, ObjectiveNotReached, PreconditionError, RunFileError
from edmctl.jobs.corrections import ModelUsed
from edmctl.jobs.job_ledger import DONE, JobLedger
from edmctl.jobs.plan import Plan, Resumption
from edmctl.jobs.resume import find_run, refuse_elsewhere, refuse_untouchable, resumed_job
from edmctl.jobs.run_context import RunContext, connected_run, ending
from edmctl.jobs.run_header import RunName
from edmctl.jobs.runs.opening import resume_command
from edmctl.jobs.surroundings import Warn
from edmctl.jsonout import JsonValue
from edmctl.labels import marked
from edmctl.procedures.job import Job, JobState, StateStore
from edmctl.procedures.machining import run_job
from edmctl.procedures.run import after_pause
from edmctl.process.erosion import corner_radius_um, roughness_rz_um
from edmctl.profile.model import Profile
from edmctl.record.journal import JournalFile, JournalledJob, remove_journal
from edmctl.record.rows import TruthMap
from edmctl.results.job import ChannelResult, ChannelTruth, JobResult, SiteResult, SiteTruth
from edmctl.results.progress import Observer
from edmctl.results.result import Result
from edmctl.wording import length

if TYPE_CHECKING:  # a job on hardware loads no simulator
    from edmctl.simulator import VirtualBench
    from edmctl.simulator.bench import HoleTruth


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
    true_wear: TrueWear | None = None
    with connected_run(plan, seed, observer, name, warn) as run:
        run.check_machine()
        if serial and run.bench.serial != serial:
            raise failures.another_machine_answers(found=run.bench.serial, wanted=serial)
        checkpoint = JobCheckpoint(run)
        ledger = JobLedger(run, checkpoint)
        if plan.resumed is not None:
            refuse_elsewhere(plan.resumed, run.bench, run.ledger.lines if run.ledger else ())
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
        add_way_on(run.error, plan, name)
    return _report(run, true_wear)


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
            with suppress(RunFileError):  # a disk error is reported at the end of the file
                run.recorder.append(TruthMap(*run.bench.virtual.truth_map()))


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


PHASE_BEFORE = "starting"
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


@dataclass(slots=True, eq=False)
class JobCheckpoint:
    """Keeps the journal of a job next to its run file; keeps none on a machine that ends with the command.

    `truth` returns the true values of a virtual bench.
    """

    run: RunContext
    truth: Callable[[], Mapping[str, object] | None] = lambda: None
    _file: JournalFile | None = None
    _newest: JobState | None = None

    def begin(self, job: Job) -> Job:
        """Return the job with the progress of an earlier run, and write its first state.

        The journal of the earlier run is replaced.
        """
        run, resumption = self.run, self.run.plan.resumed
        if resumption is not None:
            job = resumed_job(resumption, job, run.bench.now)
        if run.name is None or not run.plan.where.lasting:
            return job

        def stages_um() -> tuple[float, float]:
            status = run.bench.machine.status()
            return status.x_um, status.y_um

        journalled = self._journalled(job, run.name)
        kept_s = run.bench.kept_s
        self._file = JournalFile(run.name.journal, journalled, stages_um, self.truth, kept_s, run.disk)
        tool = job.profile.tool.label
        self.keep(after_pause(job) if resumption else JobState(PHASE_BEFORE, 0.0, tool), urgent=True)
        if resumption is not None and resumption.path != run.name.journal:
            remove_journal(resumption.path)
        return job

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Pass a state on; a bench in a file is written first, so its work is never older than the journal."""
        if self._file is None:
            return
        if urgent:
            self.run.bench.keep_all()
        else:
            self.run.bench.keep()
        self._file.keep(state, urgent=urgent)
        self._newest = state

    def leave(self, error: BaseException) -> None:
        """Remove the journal of a job that was refused, or ended by a fault, before it touched or cut anything."""
        state = self._newest
        if state is None or state.has_cut or state.z1_touches:
            return
        if isinstance(error, MachineFault):
            error.hint = f"{error.hint} Nothing was cut: start the job again, without --resume."
        if isinstance(error, MachineFault | PreconditionError):
            self.end()

    def end(self) -> None:
        """Remove the journal of a finished job. Raises RunFileError E9040 if that fails."""
        if self._file is not None:
            self._file.remove()

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


SAME_HOLE_UM = 50.0
"""Larger than the stage error, smaller than the distance of two holes: a hole farther away is not the site's."""
STEP_UM = 5.0
"""The floor is looked at every so often along the path."""


def channel_truth(profile: Profile, bench: VirtualBench, wear_um: float) -> ChannelTruth | None:
    """Return the floor of the channel in the height map; None if the recipe has no path or nothing was cut."""
    import numpy as np

    from edmctl.planning.channel import way_of_path

    path, target = profile.path, profile.target
    x_um, y_um, depth_um = bench.truth_map()
    if path is None or target.kind != "depth" or len(x_um) < 2 or len(y_um) < 2:
        return None
    way = way_of_path(path)
    places = np.array([way.at(s_um) for s_um in np.arange(0.0, way.length_um, STEP_UM)])
    columns = np.rint((places[:, 0] - x_um[0]) / (x_um[1] - x_um[0])).astype(np.int64)
    rows = np.rint((places[:, 1] - y_um[0]) / (y_um[1] - y_um[0])).astype(np.int64)
    floor_um = depth_um[np.clip(rows, 0, len(y_um) - 1), np.clip(columns, 0, len(x_um) - 1)]
    error_um = math.sqrt(float(np.mean((floor_um - target.depth_um) ** 2)))
    return ChannelTruth(float(floor_um.mean()), float(floor_um.std()), error_um, wear_um)


ABANDONED = "left"
"""Name of an abandoned hole; with a number and a space it cannot be the name of a site."""


@dataclass(slots=True, eq=False)
class TrueWear:
    """Notes the true wear at each site, and passes job states to `journal`.

    `before_um` is the tool's wear when the job begins.
    """

    bench: VirtualBench
    journal: StateStore
    before_um: float = 0.0
    _at_end_um: dict[str, float] = field(default_factory=dict)
    _abandoned_um: float = math.inf

    def __post_init__(self) -> None:
        self.before_um = self.bench.tool_wear_um

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Note the wear at the end of every site that is done by now, and pass the state on."""
        self._note_abandoned()
        newest_first = (str(site["name"]) for site in reversed(state.done))
        finished = list(takewhile(lambda name: name not in self._at_end_um, newest_first))
        self._at_end_um |= dict.fromkeys(reversed(finished), self.bench.tool_wear_um)
        self.journal.keep(state, urgent=urgent)

    def as_mapping(self) -> dict[str, object]:
        """Return the state that a resumed run needs."""
        self._note_abandoned()
        return {"tool_wear_um": self.before_um, "at_end_um": dict(self._at_end_um)}

    def resume(self, resumed: Resumption) -> None:
        """Count from where the interrupted run began, with the sites that it finished.

        Wear since the last finished site belongs to no site if the interrupted hole is made from the start.
        """
        truth: Mapping[str, Any] | None = resumed.journal.truth
        if truth is None:
            return
        self.before_um = float(truth["tool_wear_um"])
        self._at_end_um = {str(name): float(wear_um) for name, wear_um in truth["at_end_um"].items()}
        if resumed.restart_hole:
            self._abandoned_um = self.bench.tool_wear_um

    def of_site(self, name: str) -> float:
        """Return the true wear at a site, up to now if the job has not left it."""
        self._note_abandoned()
        names = list(self._at_end_um)
        if name not in self._at_end_um:
            return self.bench.tool_wear_um - max([self.before_um, *self._at_end_um.values()])
        position = names.index(name)
        begin_um = self._at_end_um[names[position - 1]] if position else self.before_um
        return self._at_end_um[name] - begin_um

    def at_end_of(self, name: str) -> float:
        """Return the wear of the tool when it left a site, or by now."""
        return self._at_end_um.get(name, self.bench.tool_wear_um)

    def _note_abandoned(self) -> None:
        if self.bench.tool_wear_um > self._abandoned_um:
            self._at_end_um[f"{ABANDONED} {len(self._at_end_um)}"] = self._abandoned_um
            self._abandoned_um = math.inf


def truths_of(
    sites: Sequence[SiteResult], holes: Sequence[HoleTruth], true_wear: TrueWear, tool_um: float = math.nan
) -> tuple[SiteTruth, ...]:
    """Return the true hole of each site, in µm: the nearest hole, and the tool wear at the site.

    A hole through the foil has no depth. `tool_um` is the diameter of the tool.
    """

    def truth_of(site: SiteResult) -> SiteTruth:
        wear_um = true_wear.of_site(site.name)
        truth = SiteTruth(
            wear_um=wear_um, corner_um=corner_radius_um(true_wear.at_end_of(site.name), tool_um)
        )
        distances_um = [math.dist((site.x_um, site.y_um), (hole.x_um, hole.y_um)) for hole in holes]
        if min(distances_um, default=math.inf) > SAME_HOLE_UM:
            return truth
        hole = holes[distances_um.index(min(distances_um))]
        return replace(
            truth,
            depth_um=math.nan if site.through else hole.depth_um,
            side_gap_um=hole.side_gap_um,
            taper_um=hole.taper_um,
            ra_um=hole.ra_um,
            rz_um=roughness_rz_um(hole.ra_um),
        )

    return tuple(map(truth_of, sites))
