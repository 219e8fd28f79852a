"""Depth and tool wear of a site from its three readings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.process.wear import DepthAndWear, measure, tilt_uncertainty_um

if TYPE_CHECKING:
    from edmctl.procedures.touch import SurfaceReading
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup


def depth_and_wear(
    profile: Profile, setup: Setup, z1: SurfaceReading, z2: SurfaceReading, z3: SurfaceReading
) -> DepthAndWear:
    """Depth Z2 - Z3, wear Z3 - Z1 and feed Z2 - Z1 by the sensor, with the setup's uncertainties."""
    sensor, tilt_u_mrad = setup.sensor, setup.surface.tilt_u_mrad
    repeatability_um = setup.stage.repeatability_um
    return measure(
        z1.reading,
        z2.reading,
        z3.reading,
        gain_u_rel=sensor.gain_u_rel,
        tilt_u_um=tilt_uncertainty_um(tilt_u_mrad, profile.measure.site_dx_um, repeatability_um),
        drift_u_um_per_s=sensor.drift_um_per_s,
        z1_to_z3_s=z3.time_s - z1.time_s,
        z2_to_z3_s=z3.time_s - z2.time_s,
        pad_u_um=tilt_uncertainty_um(tilt_u_mrad, 0.0, repeatability_um),
        linearity_u_um=sensor.linearity_u_um,
    )
