"""Results of single procedures (an approach, jumps, tool wear, drift), and of checks of what is connected."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass
from edmctl.labels import Basis

if TYPE_CHECKING:
    from edmctl.results.job import Belief


from enum import StrEnum


@dataclass(frozen=True, slots=True)
class SurfaceFound:
    """Where an approach ended: by the sensor, by the actuator model, and the voltage there.

    Only contacts have touches and a scatter. `travel_s` is the time from the zero-voltage hold.
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
    """One jump: its height, and the tool's position afterwards less that before, by sensor and by actuator model.

    The command returned to its own voltage, so the residual is the actuator's. `settling_s` is from the jump's end.
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
    """Drift of zero-voltage holds (rests) and of touches of the pad; `*_u_*` are standard uncertainties.

    `rest_um_per_s` is without creep; `apart_um_per_s` is by how much touches drift more than rests; `share` is how
    much of the rests' drift a touch sees, NaN if they drifted no more than a random walk; `share_used` corrects
    jobs. `creep_um` is by how much the hold at depth lowered the tool at the next rest. `misfit` is the residuals
    over those expected.
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
    """Lengths by the sensor and (`*_model_um`) by the actuator voltage; u95 are 95 % half-widths.

    Without a hole Z2, depth and feed are NaN. `drift_um` is Z3 after the bottom less Z3 before it,
    `drift_correction_um` the drift since Z1 that was taken off. `touches` is the least number of every Z; `sd_um`
    are the scatters of Z1, Z2, Z3 before and Z3 after. `budget` contains standard uncertainties.
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


class CheckStatus(StrEnum):
    """How a check came out."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, slots=True)
class Check:
    """One line of `doctor`; `fix` is empty where there is nothing to put right."""

    name: str
    status: CheckStatus
    message: str
    fix: str = ""


@dataclass(frozen=True, slots=True)
class Controller:
    """Who answered at a port. `fault` is the number of the latched fault, 0 for none."""

    serial: str
    firmware: str
    protocol: str
    state: str
    fault: int
    fault_name: str
    simulated: bool


@dataclass(frozen=True, slots=True)
class PortRow:
    """A port. `known`: `auto` may ask it; `controller` and `error` are None where it was not asked."""

    device: str
    description: str
    usb_id: str
    usb_serial: str
    held_by: str
    in_setup: bool
    known: bool
    controller: Controller | None
    error: str | None
