"""Single procedures of the main job, from a checked plan to a result: approach, jumps and drift."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import EdmError
from edmctl.jobs.connected_machine import with_home
from edmctl.jobs.corrections import ModelUsed
from edmctl.jobs.output_files import check_writable
from edmctl.jobs.plan import Plan
from edmctl.jobs.prepared_job import (
    PreparedJob,
    hole_radius_um,
    prepared_job,
    refuse_pad,
    refuse_taken,
    refuse_unreachable,
)
from edmctl.jobs.run_context import RunContext, connected_run
from edmctl.jobs.run_header import RunName, name_run
from edmctl.jobs.surroundings import Warn
from edmctl.jobs.tool import ToolIdentity
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
from edmctl.procedures.measure_drift import DriftPlan, drift_result, drift_time_s, measure_drift, plan_drift
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.approach import find_contact, find_gap
from edmctl.process.rest_drift import DriftModel, model_of
from edmctl.profile.drift_file import MadeBy, drift_file
from edmctl.profile.folders import kept_path
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.record.ledger import Ledger, RunEnded, ToolAccount, WearMeasured
from edmctl.results.measurements import DriftResult, JumpSeries, SurfaceFound
from edmctl.results.progress import Observer
from edmctl.results.result import Result
from edmctl.version import __version__
from edmctl.wording import facts

MOST_UM = 1e6
"""Stages and profiles know no place further off."""
JUMPS_ALONE = ('jump.mode="fixed"', "log.servo_hz=1000")
"""Jumps at a fixed period, with every sample recorded."""
_MAIN_VALUES = ("kind", "displacement", "height mean", "Z1", "wear", "depth")
"""Values of a short representation, by name."""


class Procedure:
    """The request of one command, checked as far as possible without a machine, and then its result.

    `name` is the first word of the run file's name.
    """

    plan: Plan
    name: str

    def carry_out(self, run: RunContext) -> None:
        """Refuse what the connected machine does not permit, move it, and keep data for later commands."""
        raise NotImplementedError

    def result(self, run: RunContext) -> Mapping[str, object] | None:
        """Return the result for scripts; None if there is none."""
        raise NotImplementedError

    def summary(self, run: RunContext) -> dict[str, object]:
        """Return the result with setup, calibration and times."""
        return {
            **(self.result(run) or {}),
            "setup": run.plan.setup.as_mapping(),
            "calibration": asdict(run.choice.used) if run.choice else None,
            "time_s": run.tally.time_s,
            "link": run.tally.link,
        }


@dataclass(frozen=True, slots=True, repr=False)
class ProcedureReport(Result):
    """Result of a procedure, with the `error` that ended it, if any.

    result : the `result` of the command's JSON
    reached : whether the result has more than times and calibration
    model : source of estimated displacements; None if the procedure ended before that was known
    run_file : the file as it is called now
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
    procedure: Procedure, name: RunName, seed: int, observer: Observer, warn: Warn
) -> ProcedureReport:
    """Perform it into the run file `name`; `seed` makes a virtual bench that does not exist yet.

    The report contains an expected error. Raises LinkLost, ProtocolMismatch and RunFileError if no machine was
    connected.
    """
    with connected_run(procedure.plan, seed, observer, name, warn) as run:
        run.check_machine()
        procedure.carry_out(run)
    return ProcedureReport(
        name=procedure.name,
        result=procedure.summary(run),
        reached=procedure.result(run) is not None,
        simulated=run.bench.machine.identity.simulated,
        run_file=run.run_file,
        model=run.choice.used if run.choice else None,
        error=run.error,
    )


def stage_place_um(place: Sequence[float]) -> tuple[float, float]:
    """Stage coordinates, µm. Raises UsageError E2000 where these are not two of them."""
    try:
        x_um, y_um = (float(value) for value in place)
    except (TypeError, ValueError):
        x_um = y_um = math.nan
    if not max(abs(x_um), abs(y_um)) <= MOST_UM:
        raise failures.place_not_finite(place=place, most_um=MOST_UM)
    return x_um, y_um


def job_with_home(run: RunContext, profile: Profile) -> Job:
    """Return the job of a procedure that has no holes, with the last home of the tool."""
    return with_home(job_of(profile, run.plan.setup, (), run.actuator), run.tool.history, run.bench.now)


def expected_pad_um(run: JobRun, account: ToolAccount) -> float:
    """Return the displacement where the tool should touch the pad."""
    known = not math.isnan(account.pad_um)
    return run.tally.home_um + (account.pad_um if known else run.profile.approach.offset_um)


class Approach(Procedure):
    """Find the spark gap, or with `contact` the workpiece surface, at a place or at the next hole."""

    name = "approach"

    def __init__(self, plan: Plan, place: Sequence[float] | None, *, contact: bool) -> None:
        """Raise UsageError E2000 for a place that no stage can reach."""
        self.plan, self._contact = plan, contact
        self._place = None if place is None else stage_place_um(place)
        self.found: SurfaceFound | None = None

    def forecast(self, identity: ToolIdentity | None, folder: Path) -> dict[str, float | str]:
        """Return place and duration, as far as machine and ledger are known. Raises as the approach would."""
        plan, place = self.plan, self._place
        profile, setup = plan.loaded.profile, plan.setup
        if place is not None:
            self._refuse(("the place", *place), job_of(profile, setup))
        if identity is not None:
            site = self._checked_site(prepared_job(plan, identity, None, Ledger.open(folder)))
            place = site.x_um, site.y_um
        x_um, y_um = place or beside_pad_um(profile, setup)
        return {
            "x_um": x_um,
            "y_um": y_um,
            "kind": "contact" if self._contact else "spark gap",
            "speed_um_s": profile.measure.speed_um_s if self._contact else approach_speed_um_s(profile),
            "expected_um": profile.approach.offset_um,
            "max_travel_um": profile.approach.max_travel_um,
            "time_s": touch_time_s(profile, setup) if self._contact else approach_time_s(profile, setup),
        }

    def carry_out(self, run: RunContext) -> None:
        """Approach with the present tool; some sparks leave no hole, so nothing is kept.

        Raises PreconditionError: E8042 a hole is there, or the pad where sparks would be made, E8044 the tool does
        not reach the surface.
        """
        prepared = prepared_job(run.plan, run.tool_identity, run.actuator, run.ledger)
        site = self._checked_site(prepared)
        kind = "contact touch" if self._contact else "approach"
        with (
            run.recording(kind, lambda: self.summary(run)),
            run.armed(prepared.job, pulses=not self._contact) as job_run,
        ):
            self.found = find_contact(job_run, site) if self._contact else find_gap(job_run, site)

    def result(self, run: RunContext) -> Mapping[str, object] | None:
        return asdict(self.found) if self.found else None

    def _checked_site(self, prepared: PreparedJob) -> Place:
        job, tool = prepared.job, prepared.tool
        site = replace(job.sites[0], name="the next place")
        if self._place:
            site = Place("the place", *self._place)
        if not math.isnan(tool.account.pad_um):
            tool.refuse_too_short(job.profile, job.profile.approach.offset_um + STROKE_RESERVE_UM)
        where = (site.name, site.x_um, site.y_um)
        self._refuse(where, job)
        refuse_taken([where], hole_radius_um(job.profile), prepared.holes, tool.folder)
        return site

    def _refuse(self, where: tuple[str, float, float], job: Job) -> None:
        refuse_unreachable(where, job)
        if not self._contact:
            refuse_pad(where, job)


class Jumps(Procedure):
    """A series of jumps, as deep as at the end of the profile's job."""

    name = "jump-flush"

    def __init__(self, plan: Plan, count: int) -> None:
        """Raise UsageError E2060 if the period is too short for the tool to come to rest."""
        self.plan, self._count = plan, count
        self.series: JumpSeries | None = None
        jump = plan.loaded.profile.jump
        least_s = least_period_s(jump.height_um, jump.speed_um_s, jump.dwell_s)
        if jump.period_s < least_s:
            raise failures.jump_period_too_short(period_s=jump.period_s, least_s=least_s)

    def forecast(self) -> dict[str, float]:
        """Return the values and the duration."""
        profile, jump = self.plan.loaded.profile, self.plan.loaded.profile.jump
        before_s = conditioning_time_s(profile, self.plan.setup) + SETTLE_AT_DEPTH_S
        return {
            "count": self._count,
            "height_um": jump.height_um,
            "speed_um_s": jump.speed_um_s,
            "dwell_s": jump.dwell_s,
            "period_s": jump.period_s,
            "from_um": _end_um(self.plan),
            "time_s": before_s + jumps_time_s(profile, self._count, jump.period_s),
        }

    def carry_out(self, run: RunContext) -> None:
        """Jump with the profile's job; nothing is kept. Raises PreconditionError E8059 for another setup."""
        if run.ledger is not None:
            run.tool.refuse_other_setup()
        job = job_with_home(run, run.plan.loaded.profile)
        with run.recording(self.name, lambda: self.summary(run)), run.armed(job) as job_run:
            self.series = run_jumps(job_run, _end_um(run.plan), self._count)

    def result(self, run: RunContext) -> Mapping[str, object] | None:
        return asdict(self.series) if self.series else None


def _end_um(plan: Plan) -> float:
    """Displacement at the end of the job."""
    return plan.loaded.profile.approach.offset_um + plan.forecast.feed_um


class DriftMeasurement(Procedure):
    """A measurement of drift, saved at `path`: the file `output`, else the machine's own.

    `replaced` if there was a file before; `use` says which jobs use it, as a sentence without its end. `truth` are
    the steady drifts of a virtual bench, None on other machines.
    """

    name = "measure-drift"
    path: Path
    _account: ToolAccount

    def __init__(self, plan: Plan, duration_s: float | None = None, output: Path | None = None) -> None:
        """Raise as `plan_drift`, before anything is connected."""
        self.plan, self._duration_s, self._output = plan, duration_s, output
        self.found: DriftResult | None = None
        self.replaced = False
        self.truth: dict[str, float] | None = None
        self.use = ""
        self._planned(plan)

    def _planned(self, plan: Plan) -> DriftPlan:
        return plan_drift(plan.loaded.profile, plan.setup, self._duration_s)

    def forecast(self) -> dict[str, Any]:
        """Return touches, hold and duration."""
        planned = self._planned(self.plan)
        return {
            "touches": planned.touches,
            "interval_s": planned.interval_s,
            "hold_um": planned.hold_um,
            "hold_s": planned.hold_s,
            "time_s": drift_time_s(planned, self.plan.loaded.profile, self.plan.setup),
        }

    def carry_out(self, run: RunContext) -> None:
        """Touch, hold and rest by the recipe of the tool's last run if no profile was named; save what is found.

        Raises PreconditionError: E8048 a tool whose job was killed, E8059 a reference under another setup, E8063 a
        run whose recipe is unknown; RunFileError E9012 if the file cannot be written.
        """
        environ, is_lasting = run.plan.surroundings.environ, run.plan.where.lasting
        self.path = self._output or kept_path("drift", run.bench.serial, environ, lasting=is_lasting)
        check_writable(self.path)
        tool = run.tool
        self._account = account = tool.account
        if run.ledger is not None:
            tool.refuse_other_setup()
            tool.refuse_unknown_length()
            run.plan = tool.plan_with_recipe_of(tool.last_run_file)
        planned, job = self._planned(run.plan), job_with_home(run, run.plan.loaded.profile)
        with run.recording(self.name, lambda: self.summary(run)):
            with run.armed(job) as job_run:
                self.truth = run.bench.virtual.true_drifts_um_per_s if run.bench.virtual else None
                record = measure_drift(job_run, planned, expected_pad_um(job_run, account))
                fit, self.found = drift_result(job_run, planned, record)
            self._save(run, self.found, model_of(fit))
            pad_um, home_um = record.touches[-1].reading.mean_um, run.tally.home_um
            worn = account.worn_um, account.worn_u95_um
            measured = WearMeasured(account.label, run.file_name, pad_um, *worn, home_um)
            run.write_down(measured, RunEnded(run.file_name, "done", run.tally.time_s))

    def result(self, run: RunContext) -> Mapping[str, object] | None:
        if self.found is None:
            return None
        return {
            "machine": run.bench.serial,
            "tool": self._account.label,
            **asdict(self.found),
            "drift_file": str(self.path),
            "truth": self.truth,
        }

    def _save(self, run: RunContext, found: DriftResult, model: DriftModel) -> None:
        identity, where = run.bench.machine.identity, run.plan.where
        made = MadeBy(
            utc=datetime.now(UTC).isoformat(timespec="seconds"),
            edmctl=__version__,
            serial=identity.serial,
            simulated=identity.simulated,
            run_file=run.file_name,
        )
        on = f"--port {where.selector}" if where.lasting else f"--seed {run.bench.seed}"
        self.use = (
            f"`EDMCTL_DRIFT={self.path} edmctl machine --profile PROFILE {on}` goes by it, as does a setup that "
            "names it (drift.file)"
        )
        if self._output is None and where.lasting:
            self.use = f"jobs on {identity.serial} go by it from now on"
        self.replaced = self.path.exists()
        run.plan.surroundings.settled()
        drift_file(made, found, model).save(self.path)
