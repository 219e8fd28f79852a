"""The reference pad, and which spots of it are touched: those on the side away from the holes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.procedures.touch.spots import Spots, beside, read_at_spots
from edmctl.process.wear import tilt_uncertainty_um

if TYPE_CHECKING:
    from edmctl.procedures.job import Site
    from edmctl.procedures.run import Run
    from edmctl.procedures.touch.reading import SurfaceReading
    from edmctl.profile.setup import Setup

OFFSET_U_UM = 3.5
"""Standard uncertainty of the distance to the pad before the first touch."""
SPOT_TURNS_DEG = (0.0, 60.0, -60.0)
"""Directions of the further spots as seen from the pad, from that away from the holes: all are equally far apart."""


def read_pad(run: Run, kind: str, place: str, predicted_um: float, u_um: float) -> SurfaceReading:
    """Touch the pad at two spots, and at up to two more where they do not agree.

    Contact is expected at `predicted_um` with a standard uncertainty of `u_um`. Raises what `read_at_spots` raises.
    """
    return read_at_spots(run, kind, place, Spots("pad", pad_spots(run)), predicted_um, u_um)


def pad_middle_um(run: Run) -> tuple[float, float]:
    """Where a reading of the pad holds: x and y of the middle of its two spots, each by its touches, µm."""
    return Spots("pad", pad_spots(run)).middle_um(run.profile.measure.touches)


def pad_spots(run: Run) -> tuple[Site, ...]:
    """The pad's place, and those beside it on the side away from the holes."""
    pad, sites = run.job.pad, run.job.sites
    x_um = math.fsum(site.x_um for site in sites) / len(sites) - pad.x_um
    y_um = math.fsum(site.y_um for site in sites) / len(sites) - pad.y_um
    away = math.atan2(-y_um, -x_um)
    return (pad, *(beside(run, pad, away + math.radians(turn)) for turn in SPOT_TURNS_DEG))


def pad_u_um(setup: Setup) -> float:
    """Standard uncertainty of meeting the pad again: repeatability of the stages, through its tilt."""
    return tilt_uncertainty_um(setup.surface.tilt_u_mrad, 0.0, setup.stage.repeatability_um)
