"""The job ledger around one job: what earlier jobs left behind, and what this one adds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from edmctl.cli.places_taken import next_free_x_um, refuse_taken
from edmctl.cli.tool_left import on_worn_tool, refuse_unknown_length, refuse_worn_out
from edmctl.record.bookkeeping import UNFINISHED, ToolAccount, books_of
from edmctl.record.ledger_entries import (
    JobBegun,
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolChanged,
)
from edmctl.record.logbook import Logbook

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from edmctl.cli.connected_run import Held
    from edmctl.cli.job import Plan
    from edmctl.cli.places_taken import Place
    from edmctl.cli.runfile import RunName
    from edmctl.errors import Diagnostic
    from edmctl.procedures.channel_result import ChannelResult
    from edmctl.procedures.job import Job
    from edmctl.procedures.journal import JobState, Journal
    from edmctl.procedures.results import JobResult, SiteResult
    from edmctl.profile.model import Profile

    Warn = Callable[[Sequence[Diagnostic]], None]

DONE = "done"


def logbook_of(plan: Plan, name: RunName | None) -> Logbook | None:
    """Return the ledger beside the run file; None where there is neither.

    A fresh virtual bench has none either: its work and its tool are gone with the command, and what a ledger said
    of them would be about another bench of the same serial number.
    """
    return Logbook.open(name.path.parent) if name is not None and plan.where.lasting else None


def hole_radius_um(profile: Profile) -> float:
    """Radius of the holes that the profile's tool makes."""
    return profile.tool.diameter_um / 2.0 + profile.work.side_gap_um


@dataclass(frozen=True, slots=True)
class Prepared:
    """A job as it can be done now, the account of its tool, and the holes of other jobs."""

    job: Job
    account: ToolAccount
    holes: tuple[SiteMachined, ...] = ()


def prepared_job(plan: Plan, held: Held, logbook: Logbook | None, resuming: Collection[str] = ()) -> Prepared:
    """Return the job for the tool as earlier jobs have left it, its single hole clear of all others.

    `resuming` are the file names of the runs that are taken up again: their holes are those of this job.

    Raises PreconditionError E8044 where the tool has become too short.
    """
    from edmctl.procedures.job import job_of

    loaded, setup = plan.loaded, plan.setup
    actuator = held.choice.actuator if held.choice else None
    label = loaded.profile.tool.label
    if logbook is None:
        return Prepared(job_of(loaded.profile, setup, loaded.places, actuator), ToolAccount(label))
    books = books_of(logbook.lines, held.bench.machine.identity.serial)
    account = ToolAccount(label) if plan.new_tool else books.account(label)
    profile = on_worn_tool(loaded.profile, setup, loaded.places, account)
    own = [hole for hole in books.holes if hole.run_file in resuming]
    holes = tuple(hole for hole in books.holes if hole not in own)
    stage, radius_um = setup.stage, hole_radius_um(profile)
    x_um = next_free_x_um(
        stage.reference_x_um, stage.reference_y_um, profile.measure.site_dx_um, radius_um, holes
    )
    job = job_of(profile, setup, loaded.places, actuator, start_x_um=own[0].x_um if own else x_um)
    own_um = math.fsum(hole.wear_um for hole in own if not math.isnan(hole.wear_um))
    return Prepared(replace(job, tool_wear_before_um=account.lost_um - own_um), account, holes)


@dataclass(slots=True, eq=False)
class JobLedger:
    """One job in the ledger: a journal on the way to `journal`. It writes nothing where no ledger is kept.

    `truth` is what a virtual bench knows of its tool when the job begins.
    """

    plan: Plan
    held: Held
    name: RunName | None
    journal: Journal
    warn: Warn
    truth: Mapping[str, float] | None = None
    _logbook: Logbook | None = None
    _places: tuple[Place, ...] = ()
    _z1: JobState | None = None
    _wants_reference: bool = False
    _begun: set[str] = field(default_factory=set)

    def job(self, resuming: Collection[str] = ()) -> Job:
        """Return the job as it can be done now, and write down that it begins; `resuming` as in `prepared_job`.

        Raises PreconditionError E8042, E8043, E8044, E8048 where a place is taken, the tool worn out, too short, or
        of unknown length.
        """
        self._logbook = logbook_of(self.plan, self.name)
        prepared = prepared_job(self.plan, self.held, self._logbook, resuming)
        job, account = prepared.job, prepared.account
        if self._logbook is None:
            return job
        if not resuming:
            refuse_unknown_length(account, self._logbook.path.parent)
            self.warn(refuse_worn_out(job.profile, job.setup, self.plan.loaded.places, account))
        radius_um = hole_radius_um(job.profile)
        self._places = _places(job, radius_um)
        refuse_taken(self._places, radius_um, prepared.holes, self._logbook.path.parent)
        self._wants_reference = account.reference is None and not resuming
        self._begin(self._logbook, radius_um)
        return job

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Note the first Z1 and what was cut, and hand the state on."""
        if self._z1 is None and state.z1_touches and not state.begun:
            self._z1 = state
            self._keep_reference(state)
        if state.begun:
            self._begun.add(state.site)
        self.journal.keep(state, urgent=urgent)

    def close(self, result: JobResult, status: str) -> None:
        """Write down what was reached. Raises RunFileError where that is not possible."""
        if self._logbook is None or self.name is None or not self._places:
            return
        run_file = self.name.path.name
        ended = RunEnded(run_file, status, result.time_s)
        self._logbook.append(self._serial, *self._sites(result, run_file), ended)

    @property
    def _serial(self) -> str:
        return self.held.bench.machine.identity.serial

    @property
    def _tool(self) -> str:
        return self.plan.loaded.profile.tool.label

    def _begin(self, logbook: Logbook, radius_um: float) -> None:
        """Before the machine moves: a job that is killed leaves a word about its places."""
        assert self.name is not None
        if self.plan.new_tool:
            logbook.append(self._serial, ToolChanged(self._tool))
        wear_um = self.plan.forecast.tool_wear_um
        begun = JobBegun(self._tool, self.name.path.name, radius_um, self._places, wear_um)
        logbook.append(self._serial, begun)

    def _keep_reference(self, z1: JobState) -> None:
        """Write down the first touch where the tool has no reference yet: at once, as the job may be killed."""
        setup = self.plan.setup
        if self._logbook is None or self.name is None or not self._wants_reference:
            return
        reference = ReferenceTouched(
            tool=self._tool,
            run_file=self.name.path.name,
            z_um=z1.z1_um,
            sd_um=z1.z1_sd_um,
            touches=z1.z1_touches,
            model_um=z1.z1_model_um,
            sensor=setup.sensor.fitted,
            x_um=setup.stage.reference_x_um,
            y_um=setup.stage.reference_y_um,
            speed_um_s=self.plan.loaded.profile.measure.speed_um_s,
            time_s=z1.z1_time_s,
            truth=self.truth,
        )
        self._logbook.append(self._serial, reference)

    def _sites(self, result: JobResult, run_file: str) -> list[SiteMachined]:
        """Measured holes, and those that were begun and left; or the channel, place by place."""
        blank = SiteMachined(
            tool=self._tool,
            run_file=run_file,
            name="",
            x_um=math.nan,
            y_um=math.nan,
            radius_um=hole_radius_um(self.plan.loaded.profile),
            status=UNFINISHED,
            depth_um=math.nan,
            wear_um=math.nan,
        )
        places = [replace(blank, name=name, x_um=x_um, y_um=y_um) for name, x_um, y_um in self._places]
        if self.plan.loaded.profile.path is not None:
            return _channel(places, result)
        return self._holes(places, result)

    def _holes(self, places: Sequence[SiteMachined], result: JobResult) -> list[SiteMachined]:
        left = result.reached.site if result.reached else ""
        measured = {site.name: site for site in result.sites if site.name != left}
        ratio = self.plan.loaded.profile.wear.expected_ratio
        entries: list[SiteMachined] = []
        for place in places:
            if place.name in measured:
                entries.append(_machined(place, measured[place.name]))
            elif result.reached and place.name == left:
                depth_um = result.reached.depth_estimated_um
                entries.append(replace(place, depth_um=depth_um, wear_um=depth_um * ratio))
            elif place.name in self._begun:
                entries.append(place)
        return entries


def _machined(place: SiteMachined, found: SiteResult | ChannelResult) -> SiteMachined:
    return replace(
        place,
        status=DONE,
        depth_um=found.depth_um,
        wear_um=found.wear_um,
        wear_u95_um=found.wear_u95_um,
        z1_um=found.z1_um,
        z2_um=found.z3_um + found.depth_um,
        z3_um=found.z3_um,
    )


def _channel(places: Sequence[SiteMachined], result: JobResult) -> list[SiteMachined]:
    """A channel as a row of holes, the whole wear at the first; none where nothing was cut."""
    if not result.machining_time_s:
        return []
    first, *others = places if result.channel is None else [_machined(p, result.channel) for p in places]
    return [first, *(replace(place, wear_um=0.0, wear_u95_um=0.0) for place in others)]


def _places(job: Job, radius_um: float) -> tuple[Place, ...]:
    """Axes of all holes; of a channel, points on its way that lie so close that nothing fits between them."""
    if job.profile.path is None:
        return tuple((site.name, site.x_um, site.y_um) for site in job.sites)
    from edmctl.procedures.channel import PIECE_UM, way_of_path

    stride = max(1, int(radius_um // PIECE_UM))
    points = [*way_of_path(job.profile.path).points[::stride]]
    # A closed way ends where it began.
    return tuple(dict.fromkeys((job.profile.meta.name, float(x_um), float(y_um)) for x_um, y_um in points))
