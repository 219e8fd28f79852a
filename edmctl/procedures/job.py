"""A job: recipe, setup, places of the holes, what is known already; and how far it has come."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import add, sub
from typing import TYPE_CHECKING, Any, Protocol

from edmctl.dataclasses import dataclass, field, fields
from edmctl.labels import PAD, PARKING, Basis, Verdict
from edmctl.planning.removal import completion
from edmctl.process.touches import TouchScatter
from edmctl.profile.places import Place
from edmctl.record.json_rows import record_of
from edmctl.results.job import Belief, ChannelResult, JobResult, Reached, SiteResult
from edmctl.results.progress import Phase
from edmctl.results.telemetry import LinkReport, pulse_shares

if TYPE_CHECKING:
    from edmctl.actuator.model import ActuatorModel
    from edmctl.process.rest_drift import CreepLeft, DriftModel
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup


REPORT_DELAY_S = 600.0  # added to the age of a recorded home, which is recorded a while after it was seen
SPOT_MARGIN_UM = 30.0  # between the tool's edges at two spots: wider than debris that passes a gap of some µm
THROUGH_TOLERANCE_UM = 5.0  # of the sheet's thickness: a breakthrough may be this much earlier or later


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedActuator:
    """A calibration of this machine's actuator, and the error of its model on held-out data."""

    model: ActuatorModel
    held_out_rms_um: float


@dataclass(frozen=True, slots=True)
class Job:
    """A recipe, the setup of the machine, the holes to make, and what is known before.

    `resumed` is the state of an earlier run of this job, `pause_s` ago, infinity if unknown; `restart_hole` if its
    hole is to be made again from an untouched surface. `home_um` is the sensor reading of a tool at home
    `home_age_s` ago; NaN is since the controller started. `drift_seen_um_s` is the drift by which homes of earlier
    jobs contradict the setup, else 0; `drift` is the measured drift, `creep_left` the residual creep, None if the
    actuator was not used.
    """

    profile: Profile
    setup: Setup
    sites: tuple[Place, ...]
    calibration: CalibratedActuator | None = None
    resumed: JobState | None = None
    pause_s: float = 0.0
    restart_hole: bool = False
    tool_wear_before_um: float = 0.0
    home_um: float = 0.0
    home_age_s: float = math.nan
    drift_seen_um_s: float = 0.0
    drift: DriftModel | None = None
    creep_left: CreepLeft | None = None

    @property
    def unknown_use_s(self) -> float:
        """How long ago the actuator may have been used unrecorded; infinity: never."""
        return math.inf if self.creep_left is None else self.creep_left.unknown_s

    @property
    def touch_basis(self) -> Basis:
        """What a touch of this machine is based on."""
        return Basis.TOUCHED if self.setup.sensor.fitted else Basis.MODEL

    @property
    def touches_final(self) -> bool:
        """Whether the end of every hole is touched: no later hole would measure a single one."""
        return len(self.sites) == 1 and self.profile.wear.remeasure == "auto"

    @property
    def pad(self) -> Place:
        """Where the tool length is measured before and after a cut."""
        return Place(PAD, self.setup.stage.reference_x_um, self.setup.stage.reference_y_um)

    @property
    def spot_distance_um(self) -> float:
        """Distance between spots of one surface."""
        return self.profile.tool.diameter_um + SPOT_MARGIN_UM

    @property
    def parking(self) -> Place:
        """Beside the work, where the actuator may use its whole stroke."""
        return Place(PARKING, self.setup.stage.park_x_um, self.setup.stage.park_y_um)


def job_of(
    profile: Profile,
    setup: Setup,
    places: Sequence[Place] = (),
    calibration: CalibratedActuator | None = None,
    *,
    start_x_um: float | None = None,
) -> Job:
    """Return the job of a recipe: at its places, or at `start_x_um` or `measure.site_dx_um` from the pad."""
    if not places:
        stage = setup.stage
        x_um = stage.reference_x_um + profile.measure.site_dx_um if start_x_um is None else start_x_um
        places = (Place(profile.meta.name, x_um, stage.reference_y_um),)
    return Job(profile, setup, tuple(places), calibration)


@dataclass(frozen=True, slots=True)
class HoleTarget:
    """The target of a hole, in one of its regimes if it has several. Depth or feed is NaN.

    For a way through, `depth_um` is the sheet's thickness and `completion_um` the feed after the breakthrough.
    """

    kind: str
    depth_um: float
    feed_um: float
    tolerance_um: float
    completion_um: float = 0.0
    regime: str = ""

    def __str__(self) -> str:
        if self.kind == "feed":
            return f"a feed of {self.feed_um:g} µm"
        if self.kind == "through":
            return f"a hole through {self.depth_um:g} µm"
        return f"a depth of {self.depth_um:g} µm"

    def reached(self, depth_um: float, feed_um: float) -> str:
        """Return the reached part of it, in words."""
        if self.kind == "feed":
            return f"a feed of {feed_um:.2f} of {self.feed_um:g} µm"
        of_regime = f" of regime {self.regime}" if self.regime else ""
        return f"a depth of {depth_um:.2f} of {self.depth_um:g} µm{of_regime}"


def target_of(profile: Profile, place: Place | None = None) -> HoleTarget:
    """Return the target of a hole: the depth of its own place, or the recipe's."""
    target = profile.target
    if target.kind == "feed":
        return HoleTarget("feed", math.nan, target.feed_um, math.nan)
    if target.kind == "through":
        thickness_um = profile.work.thickness_um
        return HoleTarget("through", thickness_um, math.nan, THROUGH_TOLERANCE_UM, completion(profile))
    depth_um = target.depth_um if place is None or math.isnan(place.depth_um) else place.depth_um
    return HoleTarget("depth", depth_um, math.nan, target.tolerance_um)


def verdict_of(target: HoleTarget, depth_um: float, depth_u95_um: float, *, through: bool) -> Verdict | None:
    """Return the verdict of a depth with half its 95 % interval, or of a way `through`; None for a feed."""
    if target.kind == "feed":
        return None
    if target.kind == "through":
        return Verdict.SHOWN if through else Verdict.MISSED
    if not abs(depth_um - target.depth_um) <= target.tolerance_um:
        return Verdict.MISSED
    return Verdict.SHOWN if depth_u95_um <= target.tolerance_um else Verdict.NOT_SHOWN


PERIOD_S = 5.0  # period of the states of a cut: 1.5 µm at 0.3 µm/s, far less than the search for the bottom

Counts = tuple[int, int, int, int]
SurfaceTouch = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class JobState:
    """How far a job has come, in values that JSON can represent.

    `done` are the results of the finished sites, each a mapping of `SiteResult`'s fields. `site` is the hole under
    way, empty between two, `begun` whether it was cut. `z1_*` is the reading of the pad before its first cut
    (`z1_u_um` its standard uncertainty if not touched right before the hole, `z1_doubt_u_um` that of doubted
    touches); depth, wear and feed are the last estimates, `counts` pulses by class (open, normal, arc, short).
    `broken_cuts` of the `cuts` came to no end.

    `home_um` is the sensor reading with the tool at home, `home_age_s` before `time_s`, which counts from the start
    of the first run without the pauses; NaN is unknown. `face` are the touches of the untouched surface: x, y,
    height over the pad and its standard uncertainty, µm, to which `face_doubt_u_um` is added. `channel` is empty for
    holes.
    """

    phase: str
    time_s: float
    tool: str
    face: tuple[SurfaceTouch, ...] = ()
    done: tuple[Mapping[str, object], ...] = ()
    site: str = ""
    begun: bool = False
    z1_um: float = 0.0
    z1_sd_um: float = 0.0
    z1_touches: int = 0
    z1_u_um: float = 0.0
    z1_doubt_u_um: float = 0.0
    z1_time_s: float = 0.0
    z1_model_um: float = 0.0
    home_um: float = 0.0
    displacement_um: float = 0.0
    depth_um: float = 0.0
    depth_u_um: float = 0.0
    wear_um: float = 0.0
    wear_u_um: float = 0.0
    feed_u_um: float = 0.0
    cuts: int = 0
    broken_cuts: int = 0
    counts: Counts = (0, 0, 0, 0)
    energy_j: float = 0.0
    machining_time_s: float = 0.0
    job_machining_time_s: float = 0.0
    pause_s: float = 0.0
    home_age_s: float = math.nan
    face_doubt_u_um: float = 0.0
    regime: int = 0
    regime_depth_um: float = 0.0
    regime_wear_um: float = 0.0
    channel: Mapping[str, float] = field(default_factory=dict)

    @property
    def has_cut(self) -> bool:
        """Whether a hole or channel was begun or finished."""
        return self.begun or bool(self.done)

    def as_mapping(self) -> dict[str, object]:
        """Return the fields by name, as values that JSON can represent. Nested values are shared, not copied."""
        return {one.name: getattr(self, one.name) for one in fields(self)}


def job_state(mapping: Mapping[str, object]) -> JobState:
    """Return the state that `as_mapping` made. Raises TypeError or ValueError for another mapping."""
    missing = [one.name for one in fields(JobState) if one.name not in mapping]
    if missing:
        raise ValueError(f"it has no {', '.join(missing)}")
    return record_of(JobState, mapping)


class StateStore(Protocol):
    """Keeps the newest state of a job where it outlives the process."""

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Take a state; an urgent one is safe when the call returns, another one within some seconds."""


class NoStateStore:
    """Keeps nothing: for jobs that are never resumed."""

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Do nothing."""


class CutSums(Protocol):
    """Pulses by class (open, normal, arc, short), energy of their discharges, and time of one cut or pass."""

    @property
    def counts(self) -> Counts: ...
    @property
    def energy_j(self) -> float: ...
    @property
    def time_s(self) -> float: ...


@dataclass(frozen=True, slots=True)
class CutTotals:
    """Sums of cuts or passes: their number, pulses by class (open, normal, arc, short), J and s."""

    number: int = 0
    counts: Counts = (0, 0, 0, 0)
    energy_j: float = 0.0
    time_s: float = 0.0

    def since(self, before: CutTotals) -> CutTotals:
        opens, normals, arcs, shorts = map(sub, self.counts, before.counts)
        energy_j, time_s = self.energy_j - before.energy_j, self.time_s - before.time_s
        return CutTotals(self.number - before.number, (opens, normals, arcs, shorts), energy_j, time_s)

    def plus(self, cut: CutSums) -> CutTotals:
        """Return them with one more."""
        opens, normals, arcs, shorts = map(add, self.counts, cut.counts)
        energy_j, time_s = self.energy_j + cut.energy_j, self.time_s + cut.time_s
        return CutTotals(self.number + 1, (opens, normals, arcs, shorts), energy_j, time_s)

    def columns(self) -> dict[str, Any]:
        """Return time, pulses and energy by the names of a result's fields."""
        pulses, shares = sum(self.counts), pulse_shares(*self.counts)
        time_s, energy_j = self.time_s, self.energy_j
        return {"machining_time_s": time_s, "pulses": pulses, "ratios": shares, "energy_j": energy_j}


@dataclass(frozen=True, slots=True)
class RegimeBegun:
    """Depth, wear, cuts and measurement cycles of a hole when its regime began."""

    depth_um: float = 0.0
    wear_um: float = 0.0
    total: CutTotals = field(default_factory=CutTotals)
    stops: int = 0


@dataclass(slots=True)
class RunningCut:
    """Sums of the cut under way, pulses by class; `displacement_um` is where it last sparked."""

    counts: Counts = (0, 0, 0, 0)
    energy_j: float = 0.0
    time_s: float = 0.0
    displacement_um: float = math.nan


@dataclass(slots=True)
class JobTally:
    """What a job has reached so far, also when it ends with an error.

    `depth_um` is the depth of the hole under way: estimated while cutting, then measured. `open_site` names that
    hole until it is finished, `here` the hole where the tool is, `unmeasured_site` the hole from the begin of a cut
    until it is measured. `unwritten` are finished holes that later touches may still correct, `ordered` all holes
    that no earlier run has begun, in working order. `home_um` is the sensor reading with the tool at home, at the
    last rest, `home_s`. `time_s` and `machining_time_s` include earlier runs. `creep_left` is the residual creep
    after a complete run.
    """

    sites: dict[str, SiteResult] = field(default_factory=dict)
    depth_um: float = 0.0
    depth_target_um: float = math.nan
    open_site: str = ""
    here: str = ""
    unmeasured_site: str = ""
    unwritten: list[str] = field(default_factory=list)
    ordered: tuple[str, ...] = ()
    cut: RunningCut = field(default_factory=RunningCut)
    phase: Phase = Phase.MOVING
    warning: str = ""
    warned_s: float = math.nan
    time_s: float = 0.0
    machining_time_s: float = 0.0
    earlier_time_s: float = 0.0
    pause_s: float = 0.0
    link: LinkReport | None = None
    channel: ChannelResult | None = None
    home_um: float = 0.0
    home_s: float = math.nan
    scatter: TouchScatter = field(default_factory=TouchScatter)
    beliefs: tuple[Belief, ...] = ()
    creep_left: CreepLeft | None = None

    @property
    def sites_done(self) -> int:
        """Number of finished places; the one under way may have a first result."""
        return len(self.sites) - (self.open_site in self.sites)

    @property
    def not_begun(self) -> tuple[str, ...]:
        return tuple(name for name in self.ordered if name not in (*self.sites, self.unmeasured_site))

    @property
    def wear_um(self) -> float:
        """Wear of the tool at all sites so far."""
        return math.fsum(site.wear_um for site in self.sites.values())

    @property
    def reached(self) -> Reached | None:
        """The hole or channel whose last cut is not measured."""
        if not self.unmeasured_site:
            return None
        left = self.sites.get(self.unmeasured_site, self.channel)
        u95_um = math.nan if left is None else left.depth_u95_um
        return Reached(self.unmeasured_site, self.depth_um, self.depth_target_um, u95_um)

    def result(self) -> JobResult:
        """Return the measured sites and the times up to now."""
        wears_um = [site.wear_um for site in self.sites.values()]
        if self.channel is not None:
            wears_um.append(self.channel.wear_um)
        return JobResult(
            sites=tuple(self.sites.values()),
            time_s=self.time_s,
            machining_time_s=self.machining_time_s,
            measuring_time_s=self.time_s - self.machining_time_s,
            tool_wear_total_um=sum(wears_um) if wears_um else math.nan,
            reached=self.reached,
            not_begun=self.not_begun,
            beliefs=self.beliefs,
            link=self.link,
            channel=self.channel,
            home_um=self.home_um if math.isfinite(self.home_s) else math.nan,
            earlier_time_s=self.earlier_time_s,
            pause_s=self.pause_s,
        )
