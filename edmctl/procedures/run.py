"""What every procedure of a run works with, and the state that is kept of it for a run that goes on with the job.

The state is kept at every step, and every few seconds of a cut.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from edmctl.dataclasses import asdict, dataclass, field, replace
from edmctl.machine.interface import Machine, TelemetryBlock
from edmctl.procedures.job import HoleTarget, Job, target_of
from edmctl.procedures.job_state import (
    PERIOD_S,
    JobState,
    JobTally,
    NoStateStore,
    StateStore,
    SurfaceTouch,
    UnderWay,
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
from edmctl.results.progress import Extremes, Observer, Phase, Progress
from edmctl.results.telemetry import PulseShares

MACHINING, MEASURING, MOVING = "machining", "measuring", "moving"
"""Phases of a job; while it is machining, the state is kept every few seconds too."""
SAMPLES_LATE_S = 1.0
"""A cut without samples is ended after so long at the latest."""

Args = Mapping[str, float | int | str | bool]

NO_PULSES = PulseShares(0.0, 0.0, 0.0, 0.0)
NOT_SAMPLED = Extremes(math.nan, math.nan, math.nan, math.nan, math.nan)
LOOK_S = 0.1


@dataclass(slots=True, eq=False)
class JobStateKeeper:
    """Puts the state of a job together from its tally and the hole or channel under way.

    `time_s` is that of the newest sample, or of the newest step. After `stop`, `samples_late_s` is how long the line
    had been silent then.
    """

    job: Job
    tally: JobTally
    store: StateStore = field(default_factory=NoStateStore)
    time_s: float = 0.0
    samples_late_s: float = 0.0
    phase: str = ""
    _under_way: UnderWay | None = None
    _surface: tuple[SurfaceTouch, ...] = ()
    _surface_doubt_u_um: float = 0.0
    _kept_s: float = 0.0
    _mappings: dict[str, tuple[SiteResult, Mapping[str, object]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.job.resumed is not None:
            self._surface = self.job.resumed.face
            self._surface_doubt_u_um = self.job.resumed.face_doubt_u_um

    def set_surface(self, touched: tuple[SurfaceTouch, ...], doubt_u_um: float) -> None:
        """Note what was touched of the untouched surface, and what is doubted of it."""
        self._surface, self._surface_doubt_u_um = touched, doubt_u_um

    def doubt_surface(self, u_um: float) -> None:
        """Take the surface to be less certain by a standard uncertainty."""
        self._surface_doubt_u_um = math.hypot(self._surface_doubt_u_um, u_um)

    def keep(self, phase: str, under_way: UnderWay | None, time_s: float | None = None) -> None:
        """Keep the state in a phase of the hole or channel under way, None between two."""
        self._under_way = under_way
        if time_s is not None:
            self.time_s = time_s
        self._keep(phase)

    def on_telemetry(self, block: TelemetryBlock) -> None:
        """Keep the state every few seconds of a cut."""
        self.time_s = float(block.time_s[-1])
        if self.phase == MACHINING and self.time_s - self._kept_s >= PERIOD_S:
            self._keep(MACHINING, urgent=False)

    def stop(self, time_s: float, *, linked: bool) -> None:
        """Keep the newest times and estimates of a job that ends early, at once where the line lives."""
        self.samples_late_s = (
            min(max(0.0, time_s - self.time_s), SAMPLES_LATE_S) if linked else SAMPLES_LATE_S
        )
        if not self.phase and self.job.resumed is not None:
            # Nothing was touched yet: what the run before knew stands.
            state = after_pause(self.job)
            age_s = state.home_age_s + time_s
            self.store.keep(replace(state, time_s=state.time_s + time_s, home_age_s=age_s), urgent=linked)
            return
        self.time_s = max(self.time_s, time_s)
        self._keep(self.phase or "starting", urgent=linked)

    def leave(self) -> None:
        """Report what is known of the hole or channel under way, where the job ends early."""
        if self._under_way is not None:
            self._under_way.leave()

    def _keep(self, phase: str, *, urgent: bool = True) -> None:
        self._kept_s, self.phase = self.time_s, phase
        tally = self.tally
        state = JobState(
            phase=phase,
            time_s=tally.earlier_time_s + self.time_s,
            tool=self.job.profile.tool.label,
            face=self._surface,
            face_doubt_u_um=self._surface_doubt_u_um,
            done=self._done(),
            job_machining_time_s=tally.machining_time_s,
            pause_s=tally.pause_s,
            home_um=tally.home_um,
            home_age_s=self.time_s - tally.home_s,
        )
        if self._under_way is not None:
            state = self._under_way.state(state, self.time_s)
        self.store.keep(state, urgent=urgent)

    def _done(self) -> tuple[Mapping[str, object], ...]:
        """Return the results of all sites as mappings. Each result is converted once, not at every step."""
        for name, result in self.tally.sites.items():
            if name not in self._mappings or self._mappings[name][0] is not result:
                self._mappings[name] = result, asdict(result)
        return tuple(self._mappings[name][1] for name in self.tally.sites)


def total_pause_s(job: Job) -> float:
    """Return all pauses of the job so far; NaN where the newest is unknown."""
    before_s = job.resumed.pause_s if job.resumed else 0.0
    return before_s + job.pause_s if math.isfinite(job.pause_s) else math.nan


def after_pause(job: Job) -> JobState:
    """Return what the run before left, as long ago as it is now: the pause is in it, for whoever goes on later."""
    state = job.resumed
    assert state is not None
    return replace(
        state,
        z1_time_s=state.z1_time_s - counted_pause_s(job),
        pause_s=total_pause_s(job),
        home_age_s=state.home_age_s + job.pause_s,
    )


@dataclass(slots=True)
class RegimeNow:
    """The regime in use by its number; no name and no profile of its own where the job has none."""

    number: int = 0
    name: str = ""
    profile: Profile | None = None


@dataclass(frozen=True, slots=True)
class JobRun:
    """The machine, the job, and everybody who is told about it."""

    machine: Machine
    job: Job
    watch: Watch
    recorder: Recorder
    observer: Observer
    tally: JobTally
    keeper: JobStateKeeper
    regime: RegimeNow = field(default_factory=RegimeNow)

    @property
    def profile(self) -> Profile:
        """The recipe, of the regime in use where the job has several."""
        return self.regime.profile or self.job.profile

    def target_at(self, site: Place) -> HoleTarget:
        """Return what a hole is to reach; with the regime in use, where the job has several."""
        return replace(target_of(self.profile, site), regime=self.regime.name)

    @property
    def regime_follows(self) -> bool:
        """Whether other pulses take over where those in use are done: they begin from a bottom that is touched."""
        return self.regime.number + 1 < len(self.job.profile.regimes)

    @property
    def setup(self) -> Setup:
        """The machine's own settings."""
        return self.job.setup

    @property
    def uncertainty(self) -> Displacement:
        """Standard uncertainties of a displacement as they are by now."""
        return uncertainty_now(self.job, self.watch.rests)

    def decide(
        self, code: RunEvent, message: str, args: Args, *, level: EventLevel = EventLevel.INFO
    ) -> None:
        """Write a decision or result to the run file and tell the observer."""
        if level >= EventLevel.WARNING:
            self.tally.warning, self.tally.warned_s = message, self.machine.time_s
        self.recorder.append(EventRow(self.machine.time_s, code, level, message, args))
        self.observer.note(message)

    def begin(self, phase: Phase) -> None:
        """Tell the observer what comes now."""
        self.tally.phase = phase
        self.report_idle(self.machine.time_s, 0.0, NO_PULSES, self.watch.displacement_um)

    def report_idle(
        self,
        time_s: float,
        gap_v: float,
        ratios: PulseShares,
        displacement_um: float,
        between: Extremes = NOT_SAMPLED,
    ) -> None:
        """Tell the observer what is known while nothing is machined; `between` are the extremes since last time."""
        tally = self.tally
        self.observer.progress(
            Progress(
                phase=tally.phase,
                time_s=time_s,
                gap_v=gap_v,
                reference_v=gap_reference_v(self.profile),
                ratios=ratios,
                depth_um=tally.depth_um,
                depth_target_um=tally.depth_target_um,
                displacement_um=displacement_um,
                time_left_s=math.nan,
                site=self.site_among_many,
                gap_low_v=between.gap_low_v,
                gap_high_v=between.gap_high_v,
                displacement_low_um=between.displacement_low_um,
                displacement_high_um=between.displacement_high_um,
                sites_done=tally.sites_done,
                sites_total=len(self.job.sites),
                warning=tally.warning,
                warned_s=tally.warned_s,
            )
        )

    @property
    def site_among_many(self) -> str:
        """Name of the hole where the tool is; empty beside the holes, and if there is only one."""
        return self.tally.here if len(self.job.sites) > 1 else ""


def rest_and_look(run: JobRun, duration_s: float) -> None:
    """Rest for a time, and on until a sample has come that was taken in it.

    Time passes on a host that is held up and on a line that loses frames too, but what the tool did meanwhile is not
    known then, and a ramp that is planned from an older place goes too far. Where no sample comes at all the rest
    raises LinkLost E4022, as every wait does.
    """
    begin_s = run.machine.time_s
    run.machine.rest(duration_s)
    while run.watch.newest_s <= begin_s:
        run.machine.rest(LOOK_S)
