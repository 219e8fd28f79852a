"""Results of a job: its holes, or its channel with the touched floor, and its times."""

from __future__ import annotations

import math
from collections.abc import Mapping

from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import ObjectiveNotReached
from edmctl.labels import Basis, Seen, Verdict
from edmctl.quantity import half_width
from edmctl.results.telemetry import LinkReport, PulseShares
from edmctl.wording import to_its_u95


@dataclass(frozen=True, slots=True)
class FloorPlace:
    """One touch of the floor: where, at which length along the path, and how deep below the face, µm."""

    s_um: float
    x_um: float
    y_um: float
    depth_um: float


@dataclass(frozen=True, slots=True)
class ChannelResult:
    """One channel, measured by touches: `feed = depth + wear`, with standard uncertainties u and half intervals u95.

    `depth_um` is the mean over the places of `floor`, `floor_sd_um` their standard deviation; the touches cannot
    tell roughness below the tool's face. One that is not `finished` was under way when its job ended early; if it
    was cut on since its last stop, it is estimated and `floor` is empty. `verdict` is None until the channel is
    done. `width_um` is planned. `layers` are those cut, `passes` the times that the path was gone along. `energy_j`
    is the energy of all discharges; `working_gap_um` the gap between the held tool and the floor that it left.
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


@dataclass(frozen=True, slots=True)
class ChannelTruth:
    """Mean depth of the floor under the path, its scatter, its rms error against the target, the tool's wear, µm."""

    depth_um: float
    floor_sd_um: float
    floor_error_rms_um: float
    wear_um: float

    @property
    def feed_um(self) -> float:
        """Depth and wear together."""
        return self.depth_um + self.wear_um

    def as_mapping(self) -> dict[str, float]:
        """All of it, with the feed."""
        return {**asdict(self), "feed_um": self.feed_um}


@dataclass(frozen=True, slots=True)
class SiteResult:
    """One hole: `feed = depth + wear`, u is a standard uncertainty, u95 half a 95 % interval.

    `depth_basis` and `wear_basis` say what depth and wear rest on, None without a depth. `verdict` is None until
    the hole is judged, and if no depth was wanted of it. A hole that is not `finished` was open when its job ended
    early: it is not judged, and estimated unless it was touched after its last cut. `in_doubt`: the touches of its
    bottom or face may be wrong, and the interval is wider for that.

    `face_um` is how much further than the reference pad the face lies here. `measuring_stops` are the times that the
    bottom was touched, and the pad after it; `estimated_um` is the part of the depth that was cut after the last of
    them, known from feed, energy and wear ratio: then Z2 and Z3 are where contact would be.

    `through`: the hole goes through the sheet and has no depth (NaN). `z2_um` is where the tip ended, and
    `beyond_exit_um` how far it was fed beyond the other side of a sheet as thick as the profile states.

    `wear_ratio_lin` is wear per depth, `wear_ratio_vol` tool volume per hole volume, both NaN without a depth;
    `energy_j` is the energy of all discharges, arcs included; shorts burn nothing.

    The `*_model_um` values come from the actuator voltage through the actuator model, counted from the rest at 0 V
    before each touch, and never enter the others. `zero_drift_um` is how far that rest moved from Z1 to Z3 on the
    sensor beside the model: where it is the sensor that drifts, wears that are not corrected are too large by it.
    `drift_correction_um` is how much the pad drifted from Z1 to Z3 by the rests before them, where `measure-drift`
    has told what of it touches see: Z2, Z3 and the wear are less by it. `drift_left_u_um` is the standard
    uncertainty in the wear of the drift that is left, or of all of it; NaN where no touches of the pad tell it.
    `drift_by_rests` says that the rests told it, even where a touch sees nothing of what they show.
    `feed_model_error_*` is the estimate less the sensor while machining, in µm and in % of the feed; NaN without a
    sensor, when every value of the hole is the model's.
    """

    name: str
    x_um: float
    y_um: float
    theta_deg: float
    depth_um: float
    depth_u95_um: float
    wear_um: float
    wear_u95_um: float
    feed_um: float
    z1_um: float
    z2_um: float
    z3_um: float
    face_um: float
    measuring_stops: int
    estimated_um: float
    depth_model_um: float
    wear_model_um: float
    zero_drift_um: float
    feed_model_error_max_um: float
    feed_model_error_rms_um: float
    feed_model_error_max_pct: float
    feed_model_error_rms_pct: float
    machining_time_s: float
    cuts: int
    pulses: int
    ratios: PulseShares
    gap_ratio_mean: float
    working_gap_um: float
    energy_j: float
    wear_ratio_lin: float
    wear_ratio_vol: float
    mrr_mm3_min: float
    through: bool = False
    beyond_exit_um: float = math.nan
    beyond_exit_u95_um: float = math.nan
    depth_model_u95_um: float = math.nan
    wear_model_u95_um: float = math.nan
    depth_basis: Basis | None = Basis.TOUCHED
    wear_basis: Basis = Basis.TOUCHED
    verdict: Verdict | None = None
    finished: bool = True
    in_doubt: bool = False
    feed_u95_um: float = math.nan
    depth_u_um: float = math.nan
    wear_u_um: float = math.nan
    feed_u_um: float = math.nan
    drift_correction_um: float = 0.0
    drift_left_u_um: float = math.nan
    drift_by_rests: bool = False

    @property
    def depth_model_error_um(self) -> float:
        """Depth by the model minus depth by the sensor."""
        return self.depth_model_um - self.depth_um

    @property
    def wear_model_error_um(self) -> float:
        """Wear by the model minus wear by the sensor."""
        return self.wear_model_um - self.wear_um


@dataclass(frozen=True, slots=True)
class Reached:
    """How deep a hole or channel is that was left in the middle of a cut: estimated, not measured. No target is NaN.

    `depth_estimated_u95_um` is half its 95 % interval, NaN of a channel that was not touched before.
    """

    site: str
    depth_estimated_um: float
    depth_target_um: float
    depth_estimated_u95_um: float = math.nan

    def __str__(self) -> str:
        target = "" if math.isnan(self.depth_target_um) else f" of {self.depth_target_um:.0f} µm"
        return f"Stopped at about {self.depth_estimated_um:.0f} µm{target}, not measured."


@dataclass(frozen=True, slots=True)
class Belief:
    """A standard uncertainty of the setup, by its key, and what a run has shown of it, with its uncertainty.

    `found` and `found_u` are NaN where it has shown nothing.
    """

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

    `reached` is the hole that was left unmeasured, None in a job that ended in order; `tool_wear_total_um` is
    NaN when nothing was measured. `link` says how the line did, None where the job ended before it was used.
    `home_um` is what the sensor showed of the tool at home, at the last rest at 0 V. `beliefs` of the setup are
    judged by what a job with holes has shown. `not_begun` names the holes that the job did not come to.

    Of a job that was taken up again all times are those of its runs together, `earlier_time_s` of `time_s` in the
    runs before this one. The pauses between them are left out: they were `pause_s`, NaN where nobody knows.
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
class SiteTruth:
    """A hole as the plant knows it; NaN where there is none.

    `side_gap_um` is the widest gap at the wall, `taper_um` how much wider the mouth is on the radius, and
    `ra_um` and `rz_um` the roughness Ra and Rz of the floor. `corner_um` is the radius of the tool's corner when it
    left the hole, and so of the floor's edge.
    """

    depth_um: float = math.nan
    wear_um: float = math.nan
    side_gap_um: float = math.nan
    taper_um: float = math.nan
    ra_um: float = math.nan
    rz_um: float = math.nan
    corner_um: float = math.nan

    @property
    def feed_um(self) -> float:
        """Depth and wear together."""
        return self.depth_um + self.wear_um

    def as_mapping(self) -> dict[str, float]:
        """All of it, with the feed."""
        return {**asdict(self), "feed_um": self.feed_um}


def site_result_of(mapping: Mapping[str, object]) -> SiteResult:
    """Return the result whose fields a journal has kept. Raises TypeError where they are not those of a result.

    Without a basis in the journal a result is estimated; without standard uncertainties they are its 95 % half
    widths, which is too much.
    """
    values = {f"{name}_u_um": mapping.get(f"{name}_u95_um", math.nan) for name in ("depth", "wear", "feed")}
    values.update(mapping)
    ratios = values.pop("ratios")
    if not isinstance(ratios, Mapping):
        raise TypeError("ratios have to be a mapping")
    for name in ("depth_basis", "wear_basis"):
        basis = values.get(name, Basis.ESTIMATED)
        values[name] = Basis(str(basis)) if basis else None
    verdict = values.pop("verdict", None)
    judged = Verdict(verdict) if isinstance(verdict, str) else None
    return SiteResult(**values, ratios=PulseShares(**ratios), verdict=judged)  # type: ignore[arg-type]
