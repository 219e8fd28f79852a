"""The job ledger during one job: reads what earlier jobs left, adds what this job does."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from edmctl import failures
from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import Diagnostic
from edmctl.jobs.corrections import choose_drift, doubts_of_use
from edmctl.jobs.ledger.prepared_job import Place, hole_radius_um, prepared_job
from edmctl.jobs.ledger.tool import reference_setup, tool_identity
from edmctl.jobs.run_context import RunContext
from edmctl.procedures.job import Job, JobState, StateStore
from edmctl.quantity import half_width
from edmctl.record.ledger import (
    UNFINISHED,
    JobBegun,
    Ledger,
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolChanged,
)
from edmctl.results.job import ChannelResult, JobResult, SiteResult

DONE = "done"


@dataclass(slots=True, eq=False)
class JobLedger:
    """Ledger entries of one job. It receives job states and passes them to `journal`; it may have no ledger.

    `truth` contains true values of a virtual bench's tool at the start of the job.
    """

    run: RunContext
    journal: StateStore
    truth: Mapping[str, float] | None = None
    _places: tuple[Place, ...] = ()
    _z1: JobState | None = None
    _wants_reference: bool = False
    _begun: dict[str, JobState] = field(default_factory=dict)

    def job(self, resuming: Collection[str] = ()) -> Job:
        """Return the job for the present tool; `resuming` as in `prepared_job`. Writes nothing.

        Raises PreconditionError as `prepared_job` and `PreparedJob.refuse` do.
        """
        run, plan = self.run, self.run.plan
        ledger = run.ledger
        if ledger is not None and run.bench.seed is not None:
            run.warn(_of_another_bench(ledger, run.bench.serial))
        prepared = prepared_job(plan, tool_identity(run.bench), run.actuator, ledger, resuming)
        run.drift = choose_drift(
            plan.surroundings.environ, plan.setup, run.bench.serial, lasting=plan.where.lasting
        )
        job = replace(prepared.job, drift=run.drift.model, creep_left=run.creep_left)
        run.warn([*run.drift.warnings, *doubts_of_use(run.drift, job.unknown_use_s)])
        if ledger is not None:
            run.warn(prepared.refuse(plan, ledger.path.parent, resuming))
            self._places = prepared.places
            left = plan.resumed.state if plan.resumed else None
            is_first = left is None or not (left.z1_touches or left.done)
            self._wants_reference = prepared.account.reference is None and is_first
        return job

    def begin(self) -> None:
        """Before the machine moves: a job that is killed leaves a word about its places."""
        changed = [ToolChanged(self._tool)] if self.run.plan.new_tool else []
        radius_um, wear_um = hole_radius_um(self.run.plan.loaded.profile), self.run.plan.forecast.tool_wear_um
        begun = JobBegun(
            self._tool, self.run.file_name, radius_um, self._places, wear_um, self.run.plan.setup.sha256
        )
        self.run.write_down(*changed, begun)

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Keep the first Z1 and the holes that were started, and pass the state on."""
        if self._z1 is None and state.z1_touches and not state.begun:
            self._z1 = state
            self._keep_reference(state)
        if state.begun:
            self._begun[state.site] = state
        self.journal.keep(state, urgent=urgent)

    def close(self, result: JobResult, status: str) -> None:
        """Write the results. Raises RunFileError if that fails."""
        if self._places:
            ended = RunEnded(self.run.file_name, status, result.time_s - result.earlier_time_s)
            self.run.write_down(*self._sites(result), ended)

    @property
    def _tool(self) -> str:
        return self.run.plan.loaded.profile.tool.label

    def _keep_reference(self, z1: JobState) -> None:
        """Write the first touch as the tool's reference, at once because the job may be killed."""
        if not self._wants_reference:
            return
        reference = ReferenceTouched(
            tool=self._tool,
            run_file=self.run.file_name,
            z_um=z1.z1_um,
            sd_um=z1.z1_sd_um,
            touches=z1.z1_touches,
            model_um=z1.z1_model_um,
            speed_um_s=self.run.plan.loaded.profile.measure.speed_um_s,
            time_s=z1.z1_time_s,
            home_um=z1.home_um,
            truth=self.truth,
            **reference_setup(self.run.plan.setup),
        )
        self.run.write_down(reference)

    def _sites(self, result: JobResult) -> list[SiteMachined]:
        """Measured holes, and those that were begun and left; or the channel, place by place."""
        blank = SiteMachined(
            tool=self._tool,
            run_file=self.run.file_name,
            name="",
            x_um=math.nan,
            y_um=math.nan,
            radius_um=hole_radius_um(self.run.plan.loaded.profile),
            status=UNFINISHED,
            depth_um=math.nan,
            wear_um=math.nan,
            home_um=result.home_um,
        )
        places = [replace(blank, name=name, x_um=x_um, y_um=y_um) for name, x_um, y_um in self._places]
        if self.run.plan.loaded.profile.path is not None:
            return _channel(places, result, next(iter(self._begun.values()), None))
        return self._holes(places, result)

    def _holes(self, places: Sequence[SiteMachined], result: JobResult) -> list[SiteMachined]:
        """Return the holes in the order of machining: the last one determines the length of the tool."""
        begun = {place.name: place for place in places}
        entries = []
        for site in result.sites:
            if site.name in begun:
                found = _machined(begun.pop(site.name), site)
                entries.append(found if site.finished else replace(found, status=UNFINISHED))
        left = (_left(place, self._begun[name]) for name, place in begun.items() if name in self._begun)
        return [*entries, *left]


def _of_another_bench(ledger: Ledger, serial: str) -> list[Diagnostic]:
    """Return a warning if the ledger contains a machine with the number of this new bench."""
    if all(line.serial != serial for line in ledger.lines):
        return []
    return [failures.bench_new_for_ledger(ledger=ledger.path, serial=serial)]


def _left(place: SiteMachined, state: JobState) -> SiteMachined:
    """Return a hole that this run has not measured, with the values of the journal."""
    return replace(
        place,
        depth_um=state.depth_um,
        depth_u95_um=half_width(state.depth_u_um),
        depth_u_um=state.depth_u_um,
        wear_um=state.wear_um,
        wear_u95_um=half_width(state.wear_u_um),
    )


def _machined(place: SiteMachined, found: SiteResult | ChannelResult) -> SiteMachined:
    return replace(
        place,
        status=DONE,
        depth_um=found.depth_um,
        depth_u95_um=found.depth_u95_um,
        depth_u_um=found.depth_u_um,
        wear_um=found.wear_um,
        wear_u95_um=found.wear_u95_um,
        z1_um=found.z1_um,
        z2_um=found.z3_um + found.drift_correction_um + found.depth_um,
        z3_um=found.z3_um + found.drift_correction_um,
        through=isinstance(found, SiteResult) and found.through,
    )


def _floor_at(place: SiteMachined, found: ChannelResult) -> SiteMachined:
    """A place of a channel: its floor is as deep as that on average, and as uneven."""
    floor_sd_um = found.floor_sd_um if found.floor else 0.0
    return replace(
        _machined(place, found),
        depth_u95_um=math.hypot(found.depth_u95_um, half_width(floor_sd_um)),
        depth_u_um=math.hypot(found.depth_u_um, floor_sd_um),
        status=DONE if found.finished else UNFINISHED,
    )


def _channel(places: Sequence[SiteMachined], result: JobResult, left: JobState | None) -> list[SiteMachined]:
    """Return a channel as a row of holes, the whole wear at the first; empty if nothing was cut.

    Values of a channel that no run has measured come from the journal.
    """
    if not result.machining_time_s:
        return []
    found = result.channel
    if found is not None:
        first, *others = [_floor_at(place, found) for place in places]
    else:
        first, *others = [_left(place, left) for place in places] if left is not None else places
    return [first, *(replace(place, wear_um=0.0, wear_u95_um=0.0) for place in others)]
