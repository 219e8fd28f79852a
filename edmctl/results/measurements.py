"""Results of single procedures: an approach, electrode jumps, a measurement of tool wear."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass
from edmctl.labels import Basis

if TYPE_CHECKING:
    from edmctl.results.job import Belief


@dataclass(frozen=True, slots=True)
class SurfaceFound:
    """Where an approach ended: by the sensor, by the actuator model, and the voltage there.

    `touches` and `sd_um` belong to contacts; an approach to the spark gap has 0 and NaN. `travel_s` is the time from
    the rest at 0 V.
    """

    kind: str
    x_um: float
    y_um: float
    displacement_um: float
    model_um: float
    actuator_v: float
    travel_s: float
    touches: int = 0
    sd_um: float = math.nan


@dataclass(frozen=True, slots=True)
class JumpMeasured:
    """One jump: its height, and where the tool is afterwards compared with before, by sensor and by actuator model.

    `residual_um` is the sensor's; the command came back to its own voltage, so all of it is the actuator's error.
    `residual_model_um` is what the model expects of it. `settling_s` counts from the end of the jump.
    """

    number: int
    time_s: float
    height_um: float
    height_model_um: float
    residual_um: float
    residual_model_um: float
    settling_s: float


@dataclass(frozen=True, slots=True)
class JumpSummary:
    """Mean and largest of a series; residuals by their size."""

    height_mean_um: float
    height_min_um: float
    height_max_um: float
    residual_mean_um: float
    residual_max_um: float
    model_error_mean_um: float
    model_error_max_um: float
    settling_mean_s: float
    settling_max_s: float


@dataclass(frozen=True, slots=True)
class JumpSeries:
    """Jumps of `wanted_um` from `start_um`, every `period_s`."""

    wanted_um: float
    speed_um_s: float
    dwell_s: float
    period_s: float
    start_um: float
    start_v: float
    jumps: tuple[JumpMeasured, ...]
    summary: JumpSummary
    time_s: float


@dataclass(frozen=True, slots=True)
class UncertaintyPart:
    """One source of uncertainty: standard uncertainties of wear, depth and feed, µm."""

    source: str
    wear_um: float
    depth_um: float
    feed_um: float


@dataclass(frozen=True, slots=True)
class DriftResult:
    """What rests at 0 V and touches of the pad have in common; `*_u_*` are standard uncertainties.

    `rest_um_per_s` is the drift of the rests without creep, `touch_um_per_s` that of the touches, `apart_um_per_s`
    what touches drift more than rests. `share` is how much of a drift of the rests a touch sees, their ratio; NaN
    where the rests have not drifted by more than a random walk does. `share_used` and `share_used_u` are what jobs
    go by. `creep_um` is by how much the hold at depth has held the tool lower at the first rest after it.
    `rest_rms_um` and `touch_rms_um` are the residuals, `misfit` is by how much they exceed what was expected, at
    least 1. `outliers` touches were left out.
    `beliefs` of the setup are judged by all that.
    """

    rest_um_per_s: float
    rest_u_um_per_s: float
    touch_um_per_s: float
    touch_u_um_per_s: float
    apart_um_per_s: float
    apart_u_um_per_s: float
    share: float
    share_u: float
    share_used: float
    share_used_u: float
    creep_um: float
    creep_u_um: float
    rests: int
    touches: int
    outliers: int
    misfit: float
    rest_rms_um: float
    touch_rms_um: float
    hold_um: float
    hold_s: float
    time_s: float
    beliefs: tuple[Belief, ...] = ()


@dataclass(frozen=True, slots=True)
class WearResult:
    """What the touches say, by the sensor and (`*_model_um`) by the actuator voltage; u95 are 95 % half-widths.

    Without a hole Z2, depth and feed are NaN, in the budget as well, and no depth has a basis. `drift_um` is Z3
    after the bottom less Z3 before it, `drift_correction_um` the drift since Z1 that was taken off wear and feed.
    `touches` is the least number of every Z; `sd_um` are the scatters of Z1, Z2, Z3 before and Z3 after. `budget`
    contains standard uncertainties.
    """

    z1_um: float
    z2_um: float
    z3_um: float
    z3_before_um: float
    z3_after_um: float
    drift_um: float
    drift_correction_um: float
    touches: int
    sd_um: tuple[float, float, float, float]
    wear_um: float
    wear_u95_um: float
    depth_um: float
    depth_u95_um: float
    feed_um: float
    feed_u95_um: float
    wear_model_um: float
    wear_model_u95_um: float
    depth_model_um: float
    depth_model_u95_um: float
    feed_model_um: float
    feed_model_u95_um: float
    budget: tuple[UncertaintyPart, ...]
    depth_basis: Basis | None
    wear_basis: Basis
    time_s: float
