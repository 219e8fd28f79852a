"""What every procedure of a run works with, and the state of the job that the journal keeps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, field, replace
from edmctl.machine.interface import SLICE_S, Machine, TelemetryBlock
from edmctl.planning.removal import Recipe, recipes_of
from edmctl.procedures.job import (
    PERIOD_S,
    HoleTarget,
    Job,
    JobState,
    JobTally,
    NoStateStore,
    StateStore,
    SurfaceTouch,
    target_of,
)
from edmctl.procedures.monitoring.drift import counted_pause_s, uncertainty_now
from edmctl.procedures.monitoring.watch import Watch
from edmctl.procedures.settings import gap_reference_v
from edmctl.process.touches import Displacement
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.profile.setup import Setup
from edmctl.record.rows import EventLevel, EventRow, Recorder, RunEvent
from edmctl.results.job import SiteResult
from edmctl.results.progress import Observer, Phase, Progress
from edmctl.results.telemetry import PulseShares, pulse_shares

MACHINING, MEASURING, MOVING = "machining", "measuring", "moving"  # phases of a job
SAMPLES_LATE_S = 1.0  # a cut without samples is ended after this time at the latest

Args = Mapping[str, float | int | str | bool]

NO_PULSES = PulseShares(0.0, 0.0, 0.0, 0.0)


class UnderWay(Protocol):
    """The hole or channel under way, for the journal."""

    def add_to(self, state: JobState, now_s: float) -> JobState:
        """Return the state of the job with that of the hole at a time of the run."""

    def leave(self) -> None:
        """Report what is known of it when the job ends early."""


@dataclass(slots=True, eq=False)
class JobStateKeeper:
    """Keeps the state of a job, from its tally and the hole or channel under way.

    `time_s` is that of the newest sample or step. After `stop`, `samples_late_s` is how long the line had been
    silent then. `surface` has the touches of the workpiece surface, with an additional standard uncertainty.
    """

    job: Job
    tally: JobTally
    store: StateStore = field(default_factory=NoStateStore)
    time_s: float = 0.0
    samples_late_s: float = 0.0
    phase: str = ""
    surface: tuple[SurfaceTouch, ...] = ()
    surface_doubt_u_um: float = 0.0
    _under_way: UnderWay | None = None
    _kept_s: float = 0.0
    _mappings: dict[str, tuple[SiteResult, Mapping[str, object]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.job.resumed is not None:
            self.surface, self.surface_doubt_u_um = self.job.resumed.face, self.job.resumed.face_doubt_u_um

    def keep(self, phase: str, under_way: UnderWay | None, time_s: float | None = None) -> None:
        """Keep the state in a phase of the hole or channel under way, None between two."""
        self._under_way = under_way
        if time_s is not None:
            self.time_s = time_s
        self._keep(phase)

    def on_telemetry(self, block: TelemetryBlock) -> None:
        self.time_s = float(block.time_s[-1])
        if self.phase == MACHINING and self.time_s - self._kept_s >= PERIOD_S:
            self._keep(MACHINING, urgent=False)

    def stop(self, time_s: float, *, linked: bool) -> None:
        """Keep the newest state of a job that ends early, at once if the line is alive."""
        late_s = min(max(0.0, time_s - self.time_s), SAMPLES_LATE_S)
        self.samples_late_s = late_s if linked else SAMPLES_LATE_S
        if not self.phase and self.job.resumed is not None:
            # Nothing was touched yet: the state of the run before remains.
            state = after_pause(self.job)
            age_s = state.home_age_s + time_s
            self.store.keep(replace(state, time_s=state.time_s + time_s, home_age_s=age_s), urgent=linked)
            return
        self.time_s = max(self.time_s, time_s)
        self._keep(self.phase or "starting", urgent=linked)

    def leave(self) -> None:
        """Report what is known of the hole or channel under way when the job ends early."""
        if self._under_way is not None:
            self._under_way.leave()

    def _keep(self, phase: str, *, urgent: bool = True) -> None:
        self._kept_s, self.phase, tally = self.time_s, phase, self.tally
        for name, result in tally.sites.items():  # each result is converted once, not at every step
            if name not in self._mappings or self._mappings[name][0] is not result:
                self._mappings[name] = result, asdict(result)
        state = JobState(
            phase=phase,
            time_s=tally.earlier_time_s + self.time_s,
            tool=self.job.profile.tool.label,
            face=self.surface,
            face_doubt_u_um=self.surface_doubt_u_um,
            done=tuple(self._mappings[name][1] for name in tally.sites),
            job_machining_time_s=tally.machining_time_s,
            pause_s=tally.pause_s,
            home_um=tally.home_um,
            home_age_s=self.time_s - tally.home_s,
        )
        if self._under_way is not None:
            state = self._under_way.add_to(state, self.time_s)
        self.store.keep(state, urgent=urgent)


def total_pause_s(job: Job) -> float:
    """Return all pauses of the job so far; NaN if the newest is unknown."""
    before_s = job.resumed.pause_s if job.resumed else 0.0
    return before_s + job.pause_s if math.isfinite(job.pause_s) else math.nan


def after_pause(job: Job) -> JobState:
    """Return the state that the run before left, with its times counted from now."""
    state = job.resumed
    assert state is not None
    return replace(
        state,
        z1_time_s=state.z1_time_s - counted_pause_s(job),
        pause_s=total_pause_s(job),
        home_age_s=state.home_age_s + job.pause_s,
    )


@dataclass(slots=True)
class JobRun:
    """The machine, the job, and where its progress is recorded; `regime` and `recipe` of a job with several."""

    machine: Machine
    job: Job
    watch: Watch
    recorder: Recorder
    observer: Observer
    tally: JobTally
    keeper: JobStateKeeper
    regime: int = 0
    recipe: Recipe | None = None

    @property
    def profile(self) -> Profile:
        """The recipe, of the regime in use if the job has several."""
        return self.recipe.profile if self.recipe else self.job.profile

    @property
    def setup(self) -> Setup:
        return self.job.setup

    def target_at(self, site: Place) -> HoleTarget:
        """Return the target of a hole in the regime in use."""
        return replace(target_of(self.profile, site), regime=self.recipe.name if self.recipe else "")

    @property
    def uncertainty(self) -> Displacement:
        """Standard uncertainties of a displacement as they are by now."""
        return uncertainty_now(self.job, self.watch.rests)

    def use_regime(self, number: int) -> None:
        """Use the recipe of a regime from now on; without effect if the job has none."""
        if self.job.profile.regimes:
            self.regime, self.recipe = number, recipes_of(self.job.profile)[number]
            self.watch.set_duty_voltage(self.profile.pulse.duty_voltage_v)

    def note(self, code: RunEvent, message: str, args: Args, level: EventLevel = EventLevel.INFO) -> None:
        self.recorder.append(EventRow(self.machine.time_s, code, level, message, args))

    def decide(
        self, code: RunEvent, message: str, args: Args, *, level: EventLevel = EventLevel.INFO
    ) -> None:
        """Write a decision or result to the run file and report it to the observer."""
        if level >= EventLevel.WARNING:
            self.tally.warning, self.tally.warned_s = message, self.machine.time_s
        self.note(code, message, args, level)
        self.observer.note(message)

    def warn(self, code: RunEvent, message: str, args: Args) -> None:
        """Do the same with a warning, which stays visible in the progress."""
        self.decide(code, message, args, level=EventLevel.WARNING)

    def refuse_contact(self, where: str, hint: str) -> None:
        """Raise PreconditionError E8021 if the contact sensor reads closed where nothing is to be touched."""
        if self.watch.in_contact:
            here_um = self.watch.displacement_um
            raise failures.contact_closed(here_um=here_um, where=where, remedy=hint)

    def begin(self, phase: Phase) -> None:
        self.tally.phase = phase
        time_s, here_um = self.machine.time_s, self.watch.displacement_um
        progress = self.progress(time_s=time_s, gap_v=0.0, ratios=NO_PULSES, displacement_um=here_um)
        self.observer.progress(progress)

    def on_telemetry(self, block: TelemetryBlock) -> None:
        """Report the samples of a block; while machining the follower of the cut or pass does so."""
        if self.tally.phase is not Phase.MACHINING:
            seen = block.summary
            shares, here_um = pulse_shares(*seen.counts), seen.mean_um
            progress = self.progress(
                time_s=seen.end_s, gap_v=seen.gap_mean_v, ratios=shares, displacement_um=here_um
            )
            self.observer.progress(progress)

    def progress(self, **values: Any) -> Progress:
        """Return a progress with the state of the job filled in where `values` have nothing else."""
        tally = self.tally
        known = {
            "phase": tally.phase,
            "reference_v": gap_reference_v(self.profile),
            "depth_um": tally.depth_um,
            "depth_target_um": tally.depth_target_um,
            "time_left_s": math.nan,
            # The name of the hole where the tool is: empty beside the holes, and if there is only one.
            "site": tally.here if len(self.job.sites) > 1 else "",
            "sites_done": tally.sites_done,
            "sites_total": len(self.job.sites),
            "warning": tally.warning,
            "warned_s": tally.warned_s,
        }
        return Progress(**{**known, **values})


def rest_and_look(run: JobRun, duration_s: float) -> None:
    """Rest, then wait for a sample from that time, so that no ramp is planned from an older place."""
    begin_s = run.machine.time_s
    run.machine.rest(duration_s)
    while run.watch.newest_s <= begin_s:
        run.machine.rest(SLICE_S)
