"""What a site's three readings say: depth, tool wear, volumes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.actuator.correction import GAIN_SD_BETWEEN_DAYS, ZERO_DRIFT_UM_PER_S
from edmctl.forecasts.measuring_stops import Displacement
from edmctl.process.discharge import hole_area_um2, mrr_mm3_min, tool_area_um2
from edmctl.process.wear import DepthAndWear, measure, tilt_uncertainty_um

if TYPE_CHECKING:
    from edmctl.procedures.job import Job
    from edmctl.procedures.touch.reading import SurfaceReading
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup


def displacement_uncertainty(job: Job) -> Displacement:
    """What is known of the displacements that a job goes by: the sensor's, or those of a calibrated actuator.

    A calibration inherits scale and linearity of the sensor that it was made with. Its gain may have moved by
    2.5 % since then, its zero walks by 1 µm in ten minutes, and a length is the difference of two estimates.
    """
    sensor = job.setup.sensor
    if sensor.fitted or job.calibration is None:
        return Displacement(sensor.gain_u_rel, sensor.linearity_u_um, sensor.drift_um_per_s)
    return Displacement(
        gain_u_rel=math.hypot(sensor.gain_u_rel, GAIN_SD_BETWEEN_DAYS),
        linearity_u_um=math.hypot(sensor.linearity_u_um, math.sqrt(2.0) * job.calibration.held_out_rms_um),
        drift_u_um_per_s=max(sensor.drift_um_per_s, ZERO_DRIFT_UM_PER_S),
    )


def pad_u_um(setup: Setup) -> float:
    """Standard uncertainty of meeting the pad again: repeatability of the stages, through its tilt."""
    return tilt_uncertainty_um(setup.surface.tilt_u_mrad, 0.0, setup.stage.repeatability_um)


def depth_and_wear(
    setup: Setup,
    known: Displacement,
    z1: SurfaceReading,
    z2: SurfaceReading,
    z3: SurfaceReading,
    *,
    face_um: float,
    face_u_um: float,
    z1_u_um: float,
) -> DepthAndWear:
    """Depth Z2 - Z3, wear Z3 - Z1 and feed Z2 - Z1, with the uncertainties of what measured them.

    `face_um` is how much further than the pad the face lies at the site, known within `face_u_um`; `z1_u_um` is of a
    Z1 that was not touched right before.
    """
    return measure(
        z1.reading,
        z2.reading,
        z3.reading,
        gain_u_rel=known.gain_u_rel,
        tilt_u_um=face_u_um,
        drift_u_um_per_s=known.drift_u_um_per_s,
        z1_to_z3_s=z3.time_s - z1.time_s,
        z2_to_z3_s=z3.time_s - z2.time_s,
        pad_u_um=pad_u_um(setup),
        linearity_u_um=known.linearity_u_um,
        height_um=face_um,
        z1_u_um=z1_u_um,
        doubts_u_um=(z1.doubt_u_um, z2.doubt_u_um, z3.doubt_u_um),
    )


@dataclass(frozen=True, slots=True)
class Erosion:
    """Volumes of a hole as ratios and a rate; NaN where there is no depth or no time to refer to."""

    wear_ratio_lin: float
    wear_ratio_vol: float
    mrr_mm3_min: float


def erosion_of(
    profile: Profile, found: DepthAndWear, machining_time_s: float, *, through: bool = False
) -> Erosion:
    """Relative wear, linear and volumetric, and material removal rate of a measured hole.

    Volumes are lengths times the tool's face and the hole's section, a side gap wider all round. A hole `through`
    the sheet is as long as that is thick, however far the tip came out of it.
    """
    length_um = profile.work.thickness_um if through else found.depth_um
    tool_um2 = tool_area_um2(profile.tool.diameter_um)
    hole_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
    ratio = found.wear_um / length_um if length_um > 0.0 else math.nan
    removed_um3 = length_um * hole_um2
    return Erosion(
        wear_ratio_lin=ratio,
        wear_ratio_vol=ratio * tool_um2 / hole_um2,
        mrr_mm3_min=mrr_mm3_min(removed_um3 / machining_time_s) if machining_time_s > 0.0 else math.nan,
    )
