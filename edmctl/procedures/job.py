"""A job: recipe, setup, places of the holes, what is known already; and the target of one hole."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass
from edmctl.labels import PAD, PARKING, Basis, Verdict
from edmctl.planning.removal import completion
from edmctl.profile.places import Place

if TYPE_CHECKING:
    from edmctl.actuator.model import ActuatorModel
    from edmctl.procedures.job_state import JobState
    from edmctl.process.rest_drift import CreepLeft, DriftModel
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup

REPORT_DELAY_S = 600.0
"""Added to the age of a home in ledger and journal, which record it a while after it was seen."""
SPOT_MARGIN_UM = 30.0
"""Between the tool's edges at two spots: wider than debris that passes a gap of some µm."""
THROUGH_TOLERANCE_UM = 5.0
"""Of the sheet's thickness: a breakthrough may be this much earlier or later."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedActuator:
    """A calibration of this machine's actuator, and the error of its model on held-out data."""

    model: ActuatorModel
    held_out_rms_um: float


@dataclass(frozen=True, slots=True)
class Job:
    """A recipe, the setup of the machine, the holes to make, and the actuator's calibration if there is one.

    `resumed` is the state of an earlier run of this job, `pause_s` ago, infinity if unknown; `restart_hole` if its
    hole is to be made again from an untouched surface. `tool_wear_before_um` is the wear in earlier jobs.
    `home_um` is the sensor reading of a tool at home `home_age_s` ago; NaN is since the controller started.
    `drift_seen_um_s` is the drift by which homes of earlier jobs contradict the setup, else 0; `drift` is the common
    drift of rests and touches if measured, `creep_left` the residual creep, None if the actuator was not used.
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
    """Return the job of a recipe: at its places, or one hole at `start_x_um` or `measure.site_dx_um` from the
    pad.
    """
    if not places:
        stage = setup.stage
        x_um = stage.reference_x_um + profile.measure.site_dx_um if start_x_um is None else start_x_um
        places = (Place(profile.meta.name, x_um, stage.reference_y_um),)
    return Job(profile, setup, tuple(places), calibration)


@dataclass(frozen=True, slots=True)
class HoleTarget:
    """The target of a hole. `depth_um` is NaN for a feed, `feed_um` for a depth.

    For a way through, `depth_um` is the sheet's thickness and `completion_um` the feed after the breakthrough.
    `regime` is the regime in use if the hole has several.
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
