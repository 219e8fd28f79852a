"""The job ledger during one job: reads what earlier jobs left, adds what this job does."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from edmctl import failures
from edmctl.dataclasses import dataclass, field, replace
from edmctl.jobs.corrections import choose_drift, unknown_use_warning
from edmctl.jobs.prepared_job import Place, hole_radius_um, prepared_job
from edmctl.jobs.run_context import RunContext
from edmctl.jobs.tool import reference_setup
from edmctl.procedures.job import Job, JobState, StateStore
from edmctl.quantity import half_width
from edmctl.record.ledger import (
    UNFINISHED,
    JobBegun,
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
    _has_z1: bool = False
    _needs_reference: bool = False
    _begun: dict[str, JobState] = field(default_factory=dict)

    def job(self, resuming: Collection[str] = ()) -> Job:
        """Return the job for the present tool; `resuming` as in `prepared_job`. Writes nothing."""
        run, plan, ledger = self.run, self.run.plan, self.run.ledger
        serial = run.bench.serial
        is_known = ledger is not None and any(line.serial == serial for line in ledger.lines)
        if ledger is not None and is_known and run.bench.seed is not None:
            run.warn([failures.bench_new_for_ledger(ledger=ledger.path, serial=serial)])
        prepared = prepared_job(plan, run.tool_identity, run.actuator, ledger, resuming)
        run.drift = choose_drift(plan.surroundings.environ, plan.setup, serial, lasting=plan.where.lasting)
        job = replace(prepared.job, drift=run.drift.model, creep_left=run.creep_left)
        run.warn([*run.drift.warnings, *unknown_use_warning(run.drift, job.unknown_use_s)])
        if ledger is not None:
            run.warn(prepared.refuse(resuming))
            self._places = prepared.places
            state = plan.resumed.state if plan.resumed else None
            is_first = state is None or not (state.z1_touches or state.done)
            self._needs_reference = prepared.tool.account.reference is None and is_first
        return job

    def begin(self) -> None:
        """Write the places before the machine moves, for a job that is killed."""
        run, plan, tool = self.run, self.run.plan, self._tool
        radius_um, wear_um = hole_radius_um(plan.loaded.profile), plan.forecast.tool_wear_um
        begun = JobBegun(tool, run.file_name, radius_um, self._places, wear_um, plan.setup.sha256)
        run.write_down(*([ToolChanged(tool)] if plan.new_tool else []), begun)

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Keep the first Z1 and the holes that were started, and pass the state on."""
        if not self._has_z1 and state.z1_touches and not state.begun:
            self._has_z1 = True
            if self._needs_reference:  # at once because the job may be killed
                self._write_reference(state)
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

    def _write_reference(self, z1: JobState) -> None:
        """Write the first touch as the tool's reference."""
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
        """Return the holes in the order of machining, as the last one determines the length of the tool.

        These are measured holes and those that were begun and left; or the channel, place by place.
        """
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
        unmeasured, entries = {place.name: place for place in places}, []
        for site in result.sites:
            if site.name in unmeasured:
                found = _machined(unmeasured.pop(site.name), site)
                entries.append(found if site.finished else replace(found, status=UNFINISHED))
        for name, place in unmeasured.items():
            if name in self._begun:
                entries.append(_abandoned(place, self._begun[name]))
        return entries


def _abandoned(place: SiteMachined, state: JobState) -> SiteMachined:
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
    z3_um = found.z3_um + found.drift_correction_um
    return replace(
        place,
        status=DONE,
        depth_um=found.depth_um,
        depth_u95_um=found.depth_u95_um,
        depth_u_um=found.depth_u_um,
        wear_um=found.wear_um,
        wear_u95_um=found.wear_u95_um,
        z1_um=found.z1_um,
        z2_um=z3_um + found.depth_um,
        z3_um=z3_um,
        through=isinstance(found, SiteResult) and found.through,
    )


def _channel(places: Sequence[SiteMachined], result: JobResult, state: JobState | None) -> list[SiteMachined]:
    """Return a channel as a row of holes, the whole wear at the first; empty if nothing was cut.

    Everywhere its floor has the mean depth, and is uneven by its scatter. Values of a channel that no run has
    measured come from the journal.
    """
    if not result.machining_time_s:
        return []
    channel = result.channel
    if channel is not None:
        floor_sd_um = channel.floor_sd_um if channel.floor else 0.0
        floor: dict[str, Any] = {
            "depth_u95_um": math.hypot(channel.depth_u95_um, half_width(floor_sd_um)),
            "depth_u_um": math.hypot(channel.depth_u_um, floor_sd_um),
            "status": DONE if channel.finished else UNFINISHED,
        }
        places = [replace(_machined(place, channel), **floor) for place in places]
    elif state is not None:
        places = [_abandoned(place, state) for place in places]
    first, *others = places
    return [first, *(replace(place, wear_um=0.0, wear_u95_um=0.0) for place in others)]
