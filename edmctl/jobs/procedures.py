"""Single procedures of the main job: their way from a checked plan to a result; approach and jumps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import EdmError
from edmctl.jobs.calibration.selection import ModelUsed
from edmctl.jobs.connected_machine import with_home
from edmctl.jobs.ledger.prepared_job import (
    PreparedJob,
    hole_radius_um,
    prepared_job,
    refuse_pad,
    refuse_taken,
    refuse_unreachable,
)
from edmctl.jobs.ledger.tool import (
    ToolIdentity,
    account_of,
    refuse_other_setup,
    refuse_too_short,
    tool_identity,
)
from edmctl.jobs.plan import Plan
from edmctl.jobs.run_context import RunContext, connected_run
from edmctl.jobs.run_header import RunName, name_run
from edmctl.jobs.surroundings import Warn
from edmctl.jsonout import JsonValue
from edmctl.planning.forecast import STROKE_RESERVE_UM
from edmctl.planning.measuring import (
    approach_time_s,
    beside_pad_um,
    conditioning_time_s,
    jumps_time_s,
    touch_time_s,
)
from edmctl.planning.removal import approach_speed_um_s
from edmctl.procedures.job import Job, job_of
from edmctl.procedures.jump_series import SETTLE_AT_DEPTH_S, least_period_s, run_jumps
from edmctl.procedures.run import JobRun
from edmctl.procedures.session import running
from edmctl.procedures.touch.approach import find_contact, find_gap
from edmctl.profile.places import Place
from edmctl.record.ledger import Ledger
from edmctl.results.measurements import JumpSeries, SurfaceFound
from edmctl.results.progress import Observer
from edmctl.results.result import Result
from edmctl.wording import facts

MOST_UM = 1e6
"""Stages and profiles know no place further off."""


class Stage(Protocol):
    """A procedure that was checked on a connected machine."""

    @property
    def job(self) -> Job:
        """The job that the machine is prepared for."""

    def act(self, run: JobRun) -> None:
        """Do it on an armed and conditioned machine."""

    def close(self, time_s: float) -> None:
        """Keep data for later commands; the machine is retracted and idle after `time_s`."""

    def result(self) -> Mapping[str, object] | None:
        """Return the result for scripts; None if there is none."""


S = TypeVar("S", bound=Stage)
StageT_co = TypeVar("StageT_co", bound=Stage, covariant=True)


class Procedure(Protocol[StageT_co]):
    """The request of one command, checked as far as possible without a machine."""

    @property
    def plan(self) -> Plan:
        """The checked request."""

    @property
    def name(self) -> str:
        """First word of the run file's name."""

    @property
    def kind(self) -> str:
        """Kind of procedure in the run file."""

    @property
    def pulses(self) -> bool:
        """Whether it makes sparks."""

    def prepare(self, run: RunContext) -> StageT_co:
        """Return the next stage; refuse what the connected machine does not permit. May change `run.plan`."""


_MAIN_VALUES = ("kind", "displacement", "height of the jumps, mean", "Z1", "wear", "depth")
"""Values of a short representation, by name."""


@dataclass(frozen=True, slots=True, repr=False)
class ProcedureReport(Result, Generic[StageT_co]):
    """Result of a procedure, with the `error` that ended it, if any.

    result : the `result` of the command's JSON
    stage : the procedure on the machine; None if it was refused
    model : source of estimated displacements; None if the procedure ended before that was known
    run_file : the file as it is called now
    """

    name: str
    result: Mapping[str, object]
    stage: StageT_co | None
    simulated: bool
    run_file: Path | None
    model: ModelUsed | None
    error: EdmError | None

    @property
    def reached(self) -> bool:
        """Whether the result has more than times and calibration."""
        return self.stage is not None and self.stage.result() is not None

    def as_mapping(self) -> Mapping[str, object]:
        """Return the `result` of the JSON object."""
        return self.result

    def brief(self) -> list[str]:
        """Return the procedure's name and its main values."""
        known = dict(facts(self.result))
        return [self.name, *(f"{name} {known[name]}" for name in _MAIN_VALUES if name in known)]

    def rows(self) -> list[JsonValue]:
        """Return one row a jump of a series, else the one result."""
        jumps = self.to_dict().get("jumps")
        return jumps if isinstance(jumps, list) else Result.rows(self)


def name_of(plan: Plan, command: str, folder: Path, run_id: str | None) -> RunName:
    """Name the run, without a profile that was not named. Raises UsageError E2004."""
    loaded = plan.loaded if plan.names_tool else None
    return name_run(folder, run_id, loaded, datetime.now(UTC), command)


def perform(
    procedure: Procedure[S], name: RunName, seed: int, observer: Observer, warn: Warn
) -> ProcedureReport[S]:
    """Perform it into the run file `name`; `seed` makes a virtual bench that does not exist yet.

    The report contains an expected error. Raises LinkLost, ProtocolMismatch and RunFileError if no machine was
    connected.
    """
    stage: S | None = None
    with connected_run(procedure.plan, seed, observer, name, warn) as run:
        run.check_machine()
        stage = procedure.prepare(run)
        with run.recording(procedure.kind, lambda: _summary(run, stage)):
            job = replace(stage.job, creep_left=run.creep_left)
            try:
                with running(
                    run.bench.machine,
                    job,
                    run.tally,
                    recorder=run.recorder,
                    observer=observer,
                    pulses=procedure.pulses,
                ) as job_run:
                    stage.act(job_run)
            finally:
                run.note_creep()
            stage.close(run.tally.time_s)
    return ProcedureReport(
        name=procedure.name,
        result=_summary(run, stage),
        stage=stage,
        simulated=run.bench.machine.identity.simulated,
        run_file=run.run_file,
        model=run.choice.used if run.choice else None,
        error=run.error,
    )


def _summary(run: RunContext, stage: Stage | None) -> dict[str, object]:
    return {
        **((stage.result() if stage else None) or {}),
        "setup": run.plan.setup.as_mapping(),
        "calibration": asdict(run.choice.used) if run.choice else None,
        "time_s": run.tally.time_s,
        "link": run.tally.link,
    }


def stage_place_um(place: Sequence[float]) -> tuple[float, float]:
    """Stage coordinates, µm. Raises UsageError E2000 where these are not two of them."""
    try:
        x_um, y_um = (float(value) for value in place)
    except (TypeError, ValueError):
        x_um = y_um = math.nan
    if not max(abs(x_um), abs(y_um)) <= MOST_UM:
        raise failures.place_not_finite(place=place, most_um=MOST_UM)
    return x_um, y_um


def checked_site(
    prepared: PreparedJob, place: tuple[float, float] | None, folder: Path, plan: Plan, *, contact: bool
) -> Place:
    """Return the place to approach.

    Raises PreconditionError: E8042 a hole is there, or the pad where sparks would be made, E8044 the tool does not
    reach the surface.
    """
    job = prepared.job
    first = job.sites[0]
    site = Place("the place", *place) if place else replace(first, name="the next place")
    own_way_um = job.profile.approach.offset_um + STROKE_RESERVE_UM
    if not math.isnan(prepared.account.pad_um):
        refuse_too_short(job.profile, job.setup, own_way_um, prepared.account, plan)
    where = (site.name, site.x_um, site.y_um)
    refuse_unreachable(where, job)
    if not contact:
        refuse_pad(where, job)
    refuse_taken([where], hole_radius_um(job.profile), prepared.holes, folder)
    return site


def approach_forecast(
    plan: Plan,
    identity: ToolIdentity | None,
    place: tuple[float, float] | None,
    folder: Path,
    *,
    contact: bool,
) -> dict[str, float | str]:
    """Return place and duration of the approach, as far as machine and ledger are known.

    Raises PreconditionError as the approach would.
    """
    profile, setup = plan.loaded.profile, plan.setup
    if place is not None:
        refuse_unreachable(("the place", *place), job_of(profile, setup))
    if place is not None and not contact:
        refuse_pad(("the place", *place), job_of(profile, setup))
    if identity is not None:
        prepared = prepared_job(plan, identity, None, Ledger.open(folder))
        site = checked_site(prepared, place, folder, plan, contact=contact)
        place = site.x_um, site.y_um
    x_um, y_um = place or beside_pad_um(profile, setup)
    return {
        "x_um": x_um,
        "y_um": y_um,
        "kind": "contact" if contact else "spark gap",
        "speed_um_s": profile.measure.speed_um_s if contact else approach_speed_um_s(profile),
        "expected_um": profile.approach.offset_um,
        "max_travel_um": profile.approach.max_travel_um,
        "time_s": touch_time_s(profile, setup) if contact else approach_time_s(profile, setup),
    }


@dataclass(slots=True)
class Approach:
    """A request to find the spark gap, or with `contact` the workpiece surface, at a place or at the next hole."""

    plan: Plan
    place: tuple[float, float] | None
    contact: bool
    name: str = "approach"

    def __post_init__(self) -> None:
        """Raise UsageError E2000 for a place that no stage can reach."""
        if self.place is not None:
            self.place = stage_place_um(self.place)

    @property
    def kind(self) -> str:
        """Approach to the spark gap, or contact with the surface."""
        return "contact touch" if self.contact else "approach"

    @property
    def pulses(self) -> bool:
        """A touch makes none."""
        return not self.contact

    def prepare(self, run: RunContext) -> ApproachStage:
        """Return the approach with the present tool. Raises as `checked_site`."""
        assert run.name is not None
        prepared = prepared_job(run.plan, tool_identity(run.bench), run.actuator, run.ledger)
        site = checked_site(prepared, self.place, run.name.path.parent, run.plan, contact=self.contact)
        return ApproachStage(prepared.job, site, self.contact)


@dataclass(slots=True)
class ApproachStage:
    """An approach on the machine; `found` is the gap or the surface."""

    job: Job
    site: Place
    contact: bool
    found: SurfaceFound | None = None

    def act(self, run: JobRun) -> None:
        """Find gap or surface."""
        self.found = find_contact(run, self.site) if self.contact else find_gap(run, self.site)

    def close(self, time_s: float) -> None:
        """Keep nothing: some sparks leave no hole."""

    def result(self) -> Mapping[str, object] | None:
        """Return what was found."""
        return asdict(self.found) if self.found else None


JUMPS_ALONE = ('jump.mode="fixed"', "log.servo_hz=1000")
"""Jumps at a fixed period, with every sample recorded."""


def refuse_hurry(plan: Plan) -> None:
    """Raise UsageError E2060 if the period is too short for the tool to come to rest."""
    jump = plan.loaded.profile.jump
    least_s = least_period_s(jump.height_um, jump.speed_um_s, jump.dwell_s)
    if jump.period_s < least_s:
        raise failures.jump_period_too_short(period_s=jump.period_s, least_s=least_s)


def end_um(plan: Plan) -> float:
    """Displacement at the end of the job."""
    return plan.loaded.profile.approach.offset_um + plan.forecast.feed_um


def jumps_forecast(plan: Plan, count: int) -> dict[str, float]:
    """Return the values and the duration of a series of jumps."""
    profile, jump = plan.loaded.profile, plan.loaded.profile.jump
    before_s = conditioning_time_s(profile, plan.setup) + SETTLE_AT_DEPTH_S
    return {
        "count": count,
        "height_um": jump.height_um,
        "speed_um_s": jump.speed_um_s,
        "dwell_s": jump.dwell_s,
        "period_s": jump.period_s,
        "from_um": end_um(plan),
        "time_s": before_s + jumps_time_s(profile, count, jump.period_s),
    }


@dataclass(slots=True)
class Jumps:
    """A request for a series of jumps."""

    plan: Plan
    count: int
    name: str = "jump-flush"
    kind: str = "jump-flush"
    pulses: bool = False

    def prepare(self, run: RunContext) -> JumpsStage:
        """Return the jumps with the profile's job. Raises PreconditionError E8059 for another setup."""
        plan, history = run.plan, run.history
        if run.ledger is not None:
            account = account_of(plan, tool_identity(run.bench), history)
            refuse_other_setup(account, history, plan, run.ledger.path.parent)
        job = with_home(job_of(plan.loaded.profile, plan.setup, (), run.actuator), history, run.bench.now)
        return JumpsStage(job, end_um(plan), self.count)


@dataclass(slots=True)
class JumpsStage:
    """A series of jumps on the machine, from the displacement `from_um`; `series` is the result."""

    job: Job
    from_um: float
    count: int
    series: JumpSeries | None = None

    def act(self, run: JobRun) -> None:
        """Jump."""
        self.series = run_jumps(run, self.from_um, self.count)

    def close(self, time_s: float) -> None:
        """Keep nothing: nothing was touched."""

    def result(self) -> Mapping[str, object] | None:
        """Return every jump, and the summary."""
        return asdict(self.series) if self.series else None
