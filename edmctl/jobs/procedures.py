"""Single procedures of the main job: their way from a checked plan to a result; approach and jumps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import EdmError, UsageError
from edmctl.jobs.calibration.selection import ModelUsed
from edmctl.jobs.connected_run import connected_run
from edmctl.jobs.job_preparation import PreparedJob, hole_radius_um, ledger_of, prepared_job
from edmctl.jobs.ledger.elapsed import with_home
from edmctl.jobs.ledger.places_taken import refuse_pad, refuse_taken, refuse_unreachable
from edmctl.jobs.ledger.tool import (
    ToolIdentity,
    account_of,
    refuse_other_setup,
    refuse_too_short,
    tool_identity,
)
from edmctl.jobs.plan import Plan
from edmctl.jobs.run_header import RunName, name_run
from edmctl.jobs.session import MachineSession
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
from edmctl.procedures.job_state import JobTally
from edmctl.procedures.jump_series import SETTLE_AT_DEPTH_S, least_period_s, run_jumps
from edmctl.procedures.run import JobRun
from edmctl.procedures.session import running
from edmctl.procedures.touch.approach import find_contact, find_gap
from edmctl.profile.places import Place
from edmctl.record.ledger import Ledger
from edmctl.record.rows import Recorder
from edmctl.record.tool_account import history_of
from edmctl.results.measurements import JumpSeries, SurfaceFound
from edmctl.results.progress import Observer
from edmctl.results.result import Result
from edmctl.wording import facts

MOST_UM = 1e6
"""Stages and profiles know no place further off."""


class Procedure(Protocol):
    """What one command does on a machine that is connected. It keeps what it has reached."""

    plan: Plan
    """What is asked for, checked; under the setup and with the recipe in effect once the machine is connected."""

    @property
    def name(self) -> str:
        """First word of the run file's name."""

    @property
    def kind(self) -> str:
        """What its run file says was done."""

    @property
    def pulses(self) -> bool:
        """Whether it makes sparks."""

    def job(self, session: MachineSession, name: RunName, warn: Warn) -> Job:
        """Return what the machine is made ready for; refuse what cannot be done on it."""

    def act(self, run: JobRun) -> None:
        """Do it on an armed and conditioned machine."""

    def close(self, time_s: float) -> None:
        """Keep what is to be known by later commands; the machine is retracted and idle, after `time_s`."""

    def result(self) -> Mapping[str, object] | None:
        """What was reached, for scripts; None where there is nothing."""


_MAIN_VALUES = ("kind", "displacement", "height of the jumps, mean", "Z1", "wear", "depth")
"""By their names in words: what stands in a short representation."""


@dataclass(frozen=True, slots=True, repr=False)
class ProcedureReport(Result):
    """What a procedure came to, whether it ended well or with `error`.

    `result` holds what the command of that name tells with `--json`. `reached` says that there is more in it than
    times and calibration; `model` where its estimated displacements come from, None where it ended before that was
    known. `run_file` is the file as it is called now.
    """

    name: str
    result: Mapping[str, object]
    reached: bool
    simulated: bool
    run_file: Path | None
    model: ModelUsed | None
    error: EdmError | None

    def as_mapping(self) -> Mapping[str, object]:
        """Return the `result` of the JSON object."""
        return self.result

    def brief(self) -> list[str]:
        """Return the procedure's name and what it was made for."""
        known = dict(facts(self.result))
        return [self.name, *(f"{name} {known[name]}" for name in _MAIN_VALUES if name in known)]

    def rows(self) -> list[JsonValue]:
        """Return one row a jump of a series, else the one result."""
        jumps = self.to_dict().get("jumps")
        return jumps if isinstance(jumps, list) else Result.rows(self)


def name_of(plan: Plan, command: str, folder: Path, run_id: str | None) -> RunName:
    """Name the run; a profile that nobody named is not in it. Raises UsageError E2004."""
    loaded = plan.loaded if plan.names_tool else None
    return name_run(folder, run_id, loaded, datetime.now(UTC), command)


def perform(
    plan: Plan, procedure: Procedure, name: RunName, seed: int, observer: Observer, warn: Warn
) -> ProcedureReport:
    """Do it into the run file `name`; `seed` makes a virtual bench that is not there yet.

    Expected errors come back with what was reached. Raises LinkLost, ProtocolMismatch and RunFileError where there
    was no machine to act on.
    """
    tally = JobTally()

    def prepare(session: MachineSession) -> Callable[[Recorder], None]:
        procedure.plan = session.plan
        job = replace(procedure.job(session, name, warn), creep_left=session.creep_left)
        session.plan = procedure.plan
        return lambda recorder: act(session, job, recorder)

    def act(session: MachineSession, job: Job, recorder: Recorder) -> None:
        machine, pulses = session.bench.machine, procedure.pulses
        try:
            with running(machine, job, tally, recorder=recorder, observer=observer, pulses=pulses) as run:
                procedure.act(run)
        finally:
            session.leaves(tally.creep_left)
        procedure.close(tally.time_s)

    def summary(session: MachineSession) -> dict[str, object]:
        used = asdict(session.choice.used) if session.choice else None
        return {
            **(procedure.result() or {}),
            "setup": session.plan.setup.as_mapping(),
            "calibration": used,
            "time_s": tally.time_s,
            "link": tally.link,
        }

    session = connected_run(plan, seed, observer, name, warn, prepare, summary, procedure.kind)
    return ProcedureReport(
        name=procedure.name,
        result=summary(session),
        reached=procedure.result() is not None,
        simulated=session.bench.machine.identity.simulated,
        run_file=session.run_file,
        model=session.choice.used if session.choice else None,
        error=session.error,
    )


def stage_place_um(place: Sequence[float]) -> tuple[float, float]:
    """Stage coordinates, µm. Raises UsageError E2000 where these are not two of them."""
    try:
        x_um, y_um = (float(value) for value in place)
    except (TypeError, ValueError):
        x_um = y_um = math.nan
    if not max(abs(x_um), abs(y_um)) <= MOST_UM:
        raise UsageError(
            f"{place!r} is no place of the stages.", hint=f"Give x and y in µm, within ± {MOST_UM:.0f}."
        )
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
    """Return where the tool would go and how long it takes, as far as machine and ledger are known.

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
    """One approach."""

    plan: Plan
    place: tuple[float, float] | None
    contact: bool
    found: SurfaceFound | None = None
    _site: Place | None = None
    name: str = "approach"

    def __post_init__(self) -> None:
        """Raise UsageError E2000 for a place where no stage can be."""
        if self.place is not None:
            self.place = stage_place_um(self.place)

    @property
    def surface(self) -> SurfaceFound:
        """What was found."""
        assert self.found is not None
        return self.found

    @property
    def kind(self) -> str:
        """To the spark gap, or to the surface."""
        return "contact touch" if self.contact else "approach"

    @property
    def pulses(self) -> bool:
        """A touch makes none."""
        return not self.contact

    def job(self, session: MachineSession, name: RunName, warn: Warn) -> Job:
        """Return the job of the machine's tool as it is by now, at the place of its first hole."""
        prepared = prepared_job(
            self.plan, tool_identity(session), session.actuator, ledger_of(self.plan, name)
        )
        self._site = checked_site(prepared, self.place, name.path.parent, self.plan, contact=self.contact)
        return prepared.job

    def act(self, run: JobRun) -> None:
        """Find gap or surface."""
        assert self._site is not None
        self.found = find_contact(run, self._site) if self.contact else find_gap(run, self._site)

    def close(self, time_s: float) -> None:
        """Some sparks leave no hole: there is nothing to keep."""

    def result(self) -> Mapping[str, object] | None:
        """Where it is."""
        return asdict(self.found) if self.found else None


JUMPS_ALONE = ('jump.mode="fixed"', "log.servo_hz=1000")
"""Jumps at a fixed period, whatever a job does about them, and every sample of them."""


def refuse_hurry(plan: Plan) -> None:
    """Raise UsageError E2060 where the jumps follow so fast that the tool is never seen at rest."""
    jump = plan.loaded.profile.jump
    least_s = least_period_s(jump.height_um, jump.speed_um_s, jump.dwell_s)
    if jump.period_s < least_s:
        raise UsageError(
            f"A jump every {jump.period_s:g} s leaves no time to see the tool come to rest.",
            hint=f"Take --period-s {least_s:.1f} or more.",
            code="E2060",
        )


def end_um(plan: Plan) -> float:
    """Displacement at the end of the job."""
    return plan.loaded.profile.approach.offset_um + plan.forecast.feed_um


def jumps_forecast(plan: Plan, count: int) -> dict[str, float]:
    """Return what a series of jumps is, and how long it takes."""
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
    """One series of jumps."""

    plan: Plan
    count: int
    series: JumpSeries | None = None
    name: str = "jump-flush"
    kind: str = "jump-flush"
    pulses: bool = False

    @property
    def measured(self) -> JumpSeries:
        """What was measured."""
        assert self.series is not None
        return self.series

    def job(self, session: MachineSession, name: RunName, warn: Warn) -> Job:
        """Return the profile's job; nothing of it is done but its jumps."""
        ledger = ledger_of(self.plan, name)
        job = job_of(self.plan.loaded.profile, self.plan.setup, (), session.actuator)
        if ledger is None:
            return job
        history = history_of(ledger.lines, session.bench.machine.identity.serial)
        account = account_of(self.plan, tool_identity(session), history)
        refuse_other_setup(account, history, self.plan, name.path.parent)
        return with_home(job, history, session.bench.now)

    def act(self, run: JobRun) -> None:
        """Jump."""
        self.series = run_jumps(run, end_um(self.plan), self.count)

    def close(self, time_s: float) -> None:
        """Nothing was touched: there is nothing to keep."""

    def result(self) -> Mapping[str, object] | None:
        """Every jump, and the summary."""
        return asdict(self.series) if self.series else None
