"""Results of a job: its holes, or its channel with the touched floor, and its times; and of many simulated runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from edmctl.dataclasses import dataclass, field
from edmctl.errors import ObjectiveNotReached
from edmctl.labels import Basis, Seen, Verdict, basis_of, marked
from edmctl.quantity import half_width
from edmctl.results.declared import ONLY_JSON, PURE, TEXT, derived, flag, quantity, shared, um
from edmctl.results.telemetry import LinkReport, PulseShares
from edmctl.wording import to_its_u95, with_u95


@dataclass(frozen=True, slots=True)
class FloorPlace:
    """One touch of the floor: where, at which length along the path, and how deep below the face, µm."""

    s_um: float
    x_um: float
    y_um: float
    depth_um: float


@dataclass(frozen=True, slots=True)
class ChannelResult:
    """One channel, measured by touches: `feed = depth + wear`; u are standard uncertainties, u95 half intervals.

    `depth_um` is the mean over `floor`, `floor_sd_um` its standard deviation without roughness. A channel cut after
    its last measurement cycle is estimated and has no floor. `width_um` is planned; the working gap is below the
    tool.
    """

    name: str
    length_um: float
    width_um: float
    layers: int
    passes: int
    depth_um: float
    depth_u95_um: float
    floor_sd_um: float
    wear_um: float
    wear_u95_um: float
    feed_um: float
    z1_um: float
    z3_um: float
    machining_time_s: float
    pulses: int
    ratios: PulseShares
    energy_j: float
    working_gap_um: float
    measuring_stops: int
    floor: tuple[FloorPlace, ...]
    depth_basis: Basis
    wear_basis: Basis
    verdict: Verdict | None = None
    finished: bool = False
    feed_u95_um: float = math.nan
    depth_u_um: float = math.nan
    wear_u_um: float = math.nan
    feed_u_um: float = math.nan
    drift_correction_um: float = 0.0
    drift_left_u_um: float = math.nan
    drift_by_rests: bool = False

    def floor_rms_um(self, depth_um: float) -> float:
        """Root mean square of what the places of the floor differ from a depth."""
        squares = math.fsum((place.depth_um - depth_um) ** 2 for place in self.floor)
        return math.sqrt(squares / len(self.floor))


class _Truth:
    __slots__ = ()
    depth_um: float
    wear_um: float

    @property
    def feed_um(self) -> float:
        """Depth and wear together."""
        return self.depth_um + self.wear_um

    def as_mapping(self) -> dict[str, float]:
        """Return all of it, with the feed."""
        return shared(type(self), self) | {"feed_um": self.feed_um}


@dataclass(frozen=True, slots=True)
class ChannelTruth(_Truth):
    """Mean depth of the floor under the path, its scatter, its rms error against the target, the tool's wear, µm."""

    depth_um: float
    floor_sd_um: float
    floor_error_rms_um: float
    wear_um: float


def word(title: str, default: object) -> Any:
    """Declare a basis or verdict."""
    return quantity(TEXT, title, "measurement", dtype="S9", default=default)


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteResult:
    """One hole, or a row of the results for a channel: `feed = depth + wear`. Unknown values are NaN.

    u is a standard uncertainty, u95 half a 95 % interval. Z2 and Z3 of an untouched depth are where contact would
    be. The values by the actuator model are counted from the zero-voltage hold before each touch and enter no other
    value. If the sensor drifts, wears that are not corrected are too large by `zero_drift_um`.
    """

    name: str = quantity(TEXT, "site", "place", dtype="S128", column="site")
    x_um: float = um("x of the site", "place")
    y_um: float = um("y of the site", "place")
    theta_deg: float = quantity("deg", "angle of the tool at the site", ONLY_JSON, default=math.nan)
    depth_um: float = um("depth, z2 − z3; NaN where it goes through", "lengths")
    depth_u95_um: float = um("95 % uncertainty of the depth", "lengths")
    wear_um: float = um("tool wear, z3 − z1", "lengths")
    wear_u95_um: float = um("95 % uncertainty of the wear", "lengths")
    feed_um: float = um("total feed", "lengths")
    z1_um: float = um("surface before machining", "readings")
    z2_um: float = um("bottom of the hole; where it goes through, the tip at the end", "readings")
    z3_um: float = um("surface after machining", "readings")
    face_um: float = um("how much further than the pad the face lies at the site", "measurement")
    measuring_stops: int = quantity(
        PURE, "times that bottom and pad were touched", "measurement", dtype="u2", column="stops"
    )
    estimated_um: float = um("part of the depth cut after the last touch", "measurement")
    depth_model_um: float = um("depth by the estimated displacement", "lengths by voltage")
    wear_model_um: float = um("wear by the estimated displacement", "lengths by voltage")
    zero_drift_um: float = um("shift of the rest at 0 V from Z1 to Z3, sensor − model", "error of the model")
    feed_model_error_max_um: float = um(
        "z_model − z_sensor while machining, means over 0.1 s: largest",
        "error of the model",
        column="err_feed_max",
    )
    feed_model_error_rms_um: float = um("the same, rms", "error of the model", column="err_feed_rms")
    feed_model_error_max_pct: float = quantity(
        "%", "err_feed_max over feed", "error of the model", column="err_feed_max_pct"
    )
    feed_model_error_rms_pct: float = quantity(
        "%", "err_feed_rms over feed", "error of the model", column="err_feed_rms_pct"
    )
    machining_time_s: float = quantity("s", "time with the servo on", "machining")
    cuts: int = quantity(PURE, "cuts", "machining", dtype="u2")
    pulses: int = quantity(PURE, "pulses", "machining", dtype="u8")
    ratios: PulseShares = quantity(
        PURE, "shares of the pulses by class", "machining", column="r_", nested=PulseShares
    )
    gap_ratio_mean: float = quantity(
        PURE, "mean gap voltage over duty factor × open voltage", ONLY_JSON, default=math.nan
    )
    working_gap_um: float = um("gap between floor and tip where it sparks", ONLY_JSON, default=math.nan)
    energy_j: float = quantity("J", "energy of all discharges, arcs included", "machining")
    wear_ratio_lin: float = quantity(PURE, "wear over depth, or over the sheet's thickness", "machining")
    wear_ratio_vol: float = quantity(PURE, "tool volume lost over hole volume", "machining")
    mrr_mm3_min: float = quantity("mm3/min", "hole volume over machining time", "machining")
    through: bool = flag("1 when the hole goes through the sheet", "measurement")
    beyond_exit_um: float = um("feed beyond the exit of a hole through the sheet", default=math.nan)
    beyond_exit_u95_um: float = um("95 % uncertainty of that", default=math.nan)
    depth_model_u95_um: float = um("95 % uncertainty of depth_model", default=math.nan)
    wear_model_u95_um: float = um("95 % uncertainty of wear_model", default=math.nan)
    depth_basis: Basis | None = word(
        "`touched`, `estimated`, or `model` without a sensor; empty when through", Basis.TOUCHED
    )
    wear_basis: Basis = word("the same of the wear", Basis.TOUCHED)
    verdict: Verdict | None = word("`shown`, `missed` or `not shown`; empty for a feed", None)
    finished: bool = flag("false if the job ended while the hole was open", ONLY_JSON, default=True)
    in_doubt: bool = flag(
        "whether touches of bottom or face may be wrong, for which the interval is wider", ONLY_JSON
    )
    feed_u95_um: float = um("95 % uncertainty of the feed", "uncertainty", default=math.nan)
    depth_u_um: float = um("standard uncertainty of the depth", "uncertainty", default=math.nan)
    wear_u_um: float = um("standard uncertainty of the wear", "uncertainty", default=math.nan)
    feed_u_um: float = um("standard uncertainty of the feed", "uncertainty", default=math.nan)
    drift_correction_um: float = um(
        "drift of the pad from Z1 to Z3 by the rests, taken off z2, z3 and wear", "uncertainty", default=0.0
    )
    drift_left_u_um: float = um("standard uncertainty of what is left of it", "uncertainty", default=math.nan)
    drift_by_rests: bool = flag("1 when the rests tell it, by a drift file")

    @derived("um", "depth_model − depth", "error of the model")
    def depth_model_error_um(self) -> float:
        return self.depth_model_um - self.depth_um

    @derived("um", "wear_model − wear", "error of the model")
    def wear_model_error_um(self) -> float:
        return self.wear_model_um - self.wear_um


def length_text(made: SiteResult | ChannelResult, name: str, decimals: int = 2, head: str = "result") -> str:
    """Return depth, wear or feed with its 95 % half width and the mark of its basis, below a heading `head`."""
    text = with_u95(getattr(made, f"{name}_um"), getattr(made, f"{name}_u95_um"), decimals)
    return marked(text, basis_of(name, made.depth_basis, made.wear_basis), head)


@dataclass(frozen=True, slots=True)
class Reached:
    """Estimated depth of a hole or channel that was abandoned during a cut; unknown values are NaN."""

    site: str
    depth_estimated_um: float
    depth_target_um: float
    depth_estimated_u95_um: float = math.nan

    def __str__(self) -> str:
        target = "" if math.isnan(self.depth_target_um) else f" of {self.depth_target_um:.0f} µm"
        return f"Stopped at about {self.depth_estimated_um:.0f} µm{target}, not measured."


@dataclass(frozen=True, slots=True)
class Belief:
    """A standard uncertainty of the setup and what a run has shown of it, with its uncertainty; NaN if nothing."""

    name: str
    believed: float
    found: float
    found_u: float
    seen: Seen

    @property
    def message(self) -> str:
        """What was found, for people."""
        return (
            f"The setup believes {self.name} = {self.believed:g}, a standard uncertainty; this run has found "
            f"{to_its_u95(self.found, half_width(self.found_u))}."
        )


@dataclass(frozen=True, slots=True)
class JobResult:
    """All measured sites, or the channel, and the times of the job on the machine's clock.

    `reached` is the hole that was abandoned; `link` is None if the job ended before the line was used. `home_um` is
    the sensor at the last zero-voltage hold. `not_begun` names the holes that remain. Times of a resumed job are of
    all its runs, `earlier_time_s` of those before, without the pauses `pause_s` between them (NaN if unknown).
    """

    sites: tuple[SiteResult, ...]
    time_s: float
    machining_time_s: float
    measuring_time_s: float
    tool_wear_total_um: float
    reached: Reached | None = None
    link: LinkReport | None = None
    channel: ChannelResult | None = None
    home_um: float = 0.0
    earlier_time_s: float = 0.0
    pause_s: float = 0.0
    beliefs: tuple[Belief, ...] = ()
    not_begun: tuple[str, ...] = ()

    @property
    def contradicted(self) -> tuple[Belief, ...]:
        """The beliefs of the setup that the job contradicts."""
        return tuple(belief for belief in self.beliefs if belief.seen is Seen.CONTRADICTED)


class ObjectiveMissed(ObjectiveNotReached):
    """A job that ended in order, but short of (or beyond) its objective; `result` is what was reached."""

    def __init__(self, message: str, *, result: JobResult, hint: str = "", code: str = "") -> None:
        super().__init__(message, hint=hint, code=code)
        self.result = result


@dataclass(frozen=True, slots=True)
class SiteTruth(_Truth):
    """A hole as the virtual machine knows it; NaN where nothing is known. All lengths in µm."""

    depth_um: float = um("depth", default=math.nan)
    wear_um: float = um("wear", default=math.nan)
    side_gap_um: float = um("gap at the wall near the bottom", default=math.nan)
    taper_um: float = um("how much wider the mouth is on the radius", default=math.nan)
    ra_um: float = um("roughness Ra of the floor", default=math.nan)
    rz_um: float = um("roughness Rz of the floor", default=math.nan)
    corner_um: float = um("radius of the tool's corner and the floor's edge", default=math.nan)

    @property
    def is_known(self) -> bool:
        """Whether the machine was virtual and knows depth or wear."""
        return math.isfinite(self.depth_um) or math.isfinite(self.wear_um)


@dataclass(frozen=True, slots=True)
class SimulatedSite:
    """One hole or channel of a simulated run, as it was found and as it truly is."""

    name: str
    depth_um: float
    depth_u95_um: float
    wear_um: float
    wear_u95_um: float
    measuring_stops: int
    depth_basis: Basis | None
    wear_basis: Basis
    verdict: Verdict | None
    truth: SiteTruth

    @property
    def depth_error_um(self) -> float:
        """Depth as found less true depth."""
        return self.depth_um - self.truth.depth_um

    @property
    def wear_error_um(self) -> float:
        """Wear as found less true wear."""
        return self.wear_um - self.truth.wear_um


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """One simulated run; unknown values are NaN. `calibration` describes its actuator model.

    Depth, wear and feed are those of the first hole or of the channel, whose `cuts` are its passes.
    """

    seed: int
    ok: bool
    exit_code: int
    error: str | None
    depth_um: float = math.nan
    depth_u95_um: float = math.nan
    wear_um: float = math.nan
    wear_u95_um: float = math.nan
    feed_um: float = math.nan
    depth_basis: Basis | None = None
    wear_basis: Basis | None = None
    verdict: Verdict | None = None
    truth: SiteTruth = field(default_factory=SiteTruth)
    machining_time_s: float = math.nan
    time_s: float = math.nan
    mrr_mm3_min: float = math.nan
    wear_ratio_lin: float = math.nan
    arc_share: float = math.nan
    cuts: int = 0
    calibration: str = ""
    sites: tuple[SimulatedSite, ...] = ()


@dataclass(frozen=True, slots=True)
class Statistics:
    """Mean, standard deviation (NaN for one value) and range."""

    mean: float
    sd: float
    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True)
class Case:
    """Runs that differ in their seed only; `truth` has the statistics of the virtual machine's values.

    `spreads` holds depths and wears that were touched, `by_model` those touched without a sensor, `estimated`
    others.
    """

    label: str
    overrides: tuple[str, ...]
    runs: tuple[SimulatedRun, ...]
    failed: int
    spreads: Mapping[str, Statistics]
    by_model: Mapping[str, Statistics]
    estimated: Mapping[str, Statistics]
    truth: Mapping[str, Statistics]
    coverage: Mapping[str, float]
