"""What a job reports: results per site, results of the whole job, and its progress on the way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

from edmctl.errors import ObjectiveNotReached
from edmctl.labels import Basis, Verdict
from edmctl.process.pulses import PulseShares

if TYPE_CHECKING:
    from edmctl.machine.port import LinkReport
    from edmctl.procedures.channel.result import ChannelResult

PulseRatios = PulseShares
"""Share of the pulses in each class: open, normal, arc, short."""


class Phase(StrEnum):
    """What the job is doing."""

    CONDITIONING = "conditioning"
    CALIBRATING = "calibrating"
    MOVING = "moving"
    MEASURING = "measuring"
    APPROACHING = "approaching"
    MACHINING = "machining"
    JUMPING = "jumping"
    RETRACTING = "retracting"


@dataclass(frozen=True, slots=True)
class SiteResult:
    """One hole: `feed = depth + wear`, u95 are half-widths of 95 % intervals.

    `depth_basis` and `wear_basis` say what depth and wear rest on. `verdict` is None until the hole is judged, and
    where no depth was wanted of it. One that is not `finished` was under way when its job ended early: it is not
    judged, and estimated where nobody has touched it since its last cut. `in_doubt` says that the touches of its
    bottom or face were not believed outright: its interval is wider for that.

    `face_um` is how much further than the reference pad the face lies here. `measuring_stops` are the times that the
    bottom was touched, and the pad after it; `estimated_um` is the part of the depth that was cut after the last of
    them, known from feed, energy and wear ratio: then Z2 and Z3 are where contact would be.

    `through`: the hole goes through the sheet. Then `depth_um` is how far the tip went below the face, `z2_um` where
    it ended, and the hole is as long as the sheet is thick.

    `wear_ratio_lin` is wear per depth, `wear_ratio_vol` tool volume per hole volume, both NaN without a depth;
    `energy_j` is mean gap current × plateau voltage of a normal discharge × time, over all cuts.

    The `*_model_um` values come from the actuator voltage through the actuator model, counted from the rest at 0 V
    before each touch, and never enter the others. `zero_drift_um` is how far that rest moved from Z1 to Z3 on the
    sensor beside the model: where it is the sensor that drifts, both wears are too large by it.
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
    ratios: PulseRatios
    gap_ratio_mean: float
    working_gap_um: float
    energy_j: float
    wear_ratio_lin: float
    wear_ratio_vol: float
    mrr_mm3_min: float
    through: bool = False
    depth_basis: Basis = Basis.TOUCHED
    wear_basis: Basis = Basis.TOUCHED
    verdict: Verdict | None = None
    finished: bool = True
    in_doubt: bool = False


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
class JobResult:
    """All measured sites, or the channel, and the times of the job on the machine's clock.

    `reached` is the hole that was left unmeasured, None in a job that ended in order; `tool_wear_total_um` is
    NaN when nothing was measured. `link` says how the line did, None where the job ended before it was used.
    `home_um` is what the sensor showed of the tool at home, at the last rest at 0 V.

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


@dataclass(frozen=True, slots=True)
class Extremes:
    """Between what gap voltage and displacement were in a short time up to `time_s`; NaN is unknown."""

    time_s: float
    gap_low_v: float
    gap_high_v: float
    displacement_low_um: float
    displacement_high_um: float


@dataclass(frozen=True, slots=True)
class Progress:
    """The state of a job, ten times a second. Unknown values are NaN, unknown numbers 0, unknown words empty.

    `depth_um` is estimated while a cut runs, with the half-width `depth_u95_um` of its 95 % interval; so is the
    wear. `feed_um` is their sum; `feed_target_um` is what the job wants of it where it wants no depth. `step` is
    the cut or pass under way, and `jumps` were made in it, the last one at `last_jump_s`.

    Gap voltage and displacement have been between `…_low_…` and `…_high_…` since the last report; where that is
    more than a tenth of a second ago, since the last of `past`, which holds what was before. `sites_done` of
    `sites_total` places are finished. `warning` is the newest one, told at `warned_s`.
    """

    phase: Phase
    time_s: float
    gap_v: float
    reference_v: float
    ratios: PulseRatios
    depth_um: float
    depth_target_um: float
    displacement_um: float
    time_left_s: float
    depth_u95_um: float = math.nan
    site: str = ""
    step: str = ""
    feed_um: float = math.nan
    feed_target_um: float = math.nan
    feed_um_s: float = math.nan
    wear_um: float = math.nan
    wear_u95_um: float = math.nan
    gap_low_v: float = math.nan
    gap_high_v: float = math.nan
    displacement_low_um: float = math.nan
    displacement_high_um: float = math.nan
    past: tuple[Extremes, ...] = ()
    jumps: int = 0
    jump_period_s: float = math.nan
    last_jump_s: float = math.nan
    sites_done: int = 0
    sites_total: int = 0
    warning: str = ""
    warned_s: float = math.nan


class Observer(Protocol):
    """Who watches a job for a person."""

    def progress(self, p: Progress) -> None:
        """Take the newest state; called often, may drop."""

    def note(self, text: str) -> None:
        """Take one line about a decision or a result."""


def site_result_of(mapping: Mapping[str, object]) -> SiteResult:
    """Return the result whose fields a journal has kept. Raises TypeError where they are not those of a result.

    What an older journal does not say was touched counts as estimated.
    """
    values = dict(mapping)
    ratios = values.pop("ratios")
    if not isinstance(ratios, Mapping):
        raise TypeError("ratios have to be a mapping")
    values["depth_basis"], values["wear_basis"] = (
        Basis(str(values.get(name, Basis.ESTIMATED))) for name in ("depth_basis", "wear_basis")
    )
    verdict = values.pop("verdict", None)
    judged = Verdict(verdict) if isinstance(verdict, str) else None
    return SiteResult(**values, ratios=PulseRatios(**ratios), verdict=judged)  # type: ignore[arg-type]


class ObjectiveMissed(ObjectiveNotReached):
    """A job that ended in order, but short of (or beyond) its objective; `result` is what was reached."""

    def __init__(self, message: str, *, result: JobResult, hint: str = "", code: str = "") -> None:
        super().__init__(message, hint=hint, code=code)
        self.result = result


@dataclass(frozen=True, slots=True)
class RunningCut:
    """What the cut under way has done so far, pulses by class; `displacement_um` is where it last sparked."""

    counts: tuple[int, int, int, int] = (0, 0, 0, 0)
    energy_j: float = 0.0
    time_s: float = 0.0
    displacement_um: float = math.nan


@dataclass(slots=True)
class Ledger:
    """What a job has reached so far; still there when the job ends with an error.

    `depth_um` is the best present knowledge of the hole under way: estimated while cutting, then measured.
    `open_site` names that hole until it is finished, `unmeasured_site` from the begin of a cut
    until it is measured; `unwritten` names finished holes whose results later touches may still correct.
    `home_um` is what the sensor showed of the tool at home, at the last rest at 0 V, which was at `home_s`. `cut` is
    the cut under way, `phase` what is being done, `warning` what was last warned of, at `warned_s`.
    `time_s` and `machining_time_s` count those of the runs before this one too.
    """

    sites: dict[str, SiteResult] = field(default_factory=dict)
    depth_um: float = 0.0
    depth_target_um: float = math.nan
    open_site: str = ""
    unmeasured_site: str = ""
    unwritten: list[str] = field(default_factory=list)
    cut: RunningCut = field(default_factory=lambda: RunningCut())
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

    @property
    def sites_done(self) -> int:
        """How many places are finished: the one under way may have a first result."""
        return len(self.sites) - (self.open_site in self.sites)

    @property
    def wear_um(self) -> float:
        """What the tool has lost at all sites so far."""
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
        """The measured sites and the times up to now."""
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
            link=self.link,
            channel=self.channel,
            home_um=self.home_um if math.isfinite(self.home_s) else math.nan,
            earlier_time_s=self.earlier_time_s,
            pause_s=self.pause_s,
        )
