"""The reference pad: its spots, the length of the tool that it tells, and a tool that cannot have grown."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.errors import ObjectiveNotReached
from edmctl.procedures.touch.spots import Spots, beside, read_at_spots
from edmctl.process.touch_check import Deviation, has_grown
from edmctl.process.wear import tilt_uncertainty_um

if TYPE_CHECKING:
    from edmctl.procedures.run import JobRun
    from edmctl.procedures.touch.reading import SurfaceReading
    from edmctl.profile.places import Place
    from edmctl.profile.setup import Setup

OFFSET_U_UM = 3.5
"""Return the standard uncertainty of the distance to the pad before the first touch."""
SPOT_TURNS_DEG = (0.0, 60.0, -60.0)
"""Directions of the further spots as seen from the pad, from that away from the holes: all are equally far apart."""
TOUCH_U_UM = 0.15
"""Return the standard uncertainty of a reading of three touches."""


def read_pad(run: JobRun, kind: str, place: str, predicted_um: float, u_um: float) -> SurfaceReading:
    """Touch the pad at two spots, and at up to two more where they do not agree.

    Contact is expected at `predicted_um` with a standard uncertainty of `u_um`. Raises what `read_at_spots` raises.
    """
    return read_at_spots(run, kind, place, Spots("pad", pad_spots(run)), predicted_um, u_um)


def pad_middle_um(run: JobRun) -> tuple[float, float]:
    """Return where a reading of the pad holds: x and y of the middle of its two spots, each by its touches, µm."""
    return Spots("pad", pad_spots(run)).middle_um(run.profile.measure.touches)


def pad_spots(run: JobRun) -> tuple[Place, ...]:
    """Return the pad's place, and those beside it on the side away from the holes."""
    pad, sites = run.job.pad, run.job.sites
    x_um = math.fsum(site.x_um for site in sites) / len(sites) - pad.x_um
    y_um = math.fsum(site.y_um for site in sites) / len(sites) - pad.y_um
    away = math.atan2(-y_um, -x_um)
    return (pad, *(beside(run, pad, away + math.radians(turn)) for turn in SPOT_TURNS_DEG))


def pad_u_um(setup: Setup) -> float:
    """Return the standard uncertainty of meeting the pad again: repeatability of the stages, through its tilt."""
    return tilt_uncertainty_um(setup.surface.tilt_u_mrad, 0.0, setup.stage.repeatability_um)


@dataclass(frozen=True, slots=True)
class ToolLength:
    """The last reading of the pad, and the wear estimated since, with its standard uncertainty."""

    pad: SurfaceReading
    wear_um: float = 0.0
    wear_u_um: float = 0.0

    @property
    def pad_um(self) -> float:
        """Displacement at which the tool would meet the pad."""
        return self.pad.z_um + self.wear_um

    def u_um(self, now_s: float, drift_u_um_per_s: float) -> float:
        """Return the standard uncertainty of that, at a moment."""
        drift_um = drift_u_um_per_s * max(0.0, now_s - self.pad.time_s)
        return math.hypot(TOUCH_U_UM, self.pad.doubt_u_um, self.wear_u_um, drift_um)

    def worn(self, wear_um: float, wear_u_um: float) -> ToolLength:
        """Return the length after a hole that was not measured; the errors of such holes go the same way."""
        return ToolLength(self.pad, self.wear_um + wear_um, self.wear_u_um + wear_u_um)


def refuse_grown_tool(
    run: JobRun, z1_um: float, z3: SurfaceReading, age_s: float, more_u_um: float = 0.0
) -> None:
    """Raise ObjectiveNotReached E7023 where the pad says that the tool has become longer.

    `z1_um` is the pad `age_s` ago, with a standard uncertainty of `more_u_um` besides drift and touches.
    """
    drift_um = run.uncertainty.drift_u_um_per_s * age_s
    u_um = math.hypot(TOUCH_U_UM, TOUCH_U_UM, more_u_um, z3.doubt_u_um, drift_um)
    wear = Deviation(z3.z_um - z1_um, u_um)
    if not has_grown(wear):
        return
    raise ObjectiveNotReached(
        f"Z3 = {z3.z_um:.2f} µm: the tool is {-wear.um:.2f} µm longer than before the cut (standard uncertainty "
        f"{u_um:.2f} µm), which it cannot be.",
        hint="Clean the face of the tool and the reference pad, and look whether the tool has slipped in its chuck.",
        code="E7023",
    )
