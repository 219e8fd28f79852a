"""What is to be done, and on which machine: a recipe, a setup, the places of the holes, what is known already."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmctl.actuator.model import ActuatorModel
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup


@dataclass(frozen=True, slots=True)
class Site:
    """Where a hole goes, in stage coordinates, and how deep; NaN where the recipe's target says it."""

    name: str
    x_um: float
    y_um: float
    theta_deg: float = 0.0
    depth_um: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedActuator:
    """A calibration of this machine's actuator, and how well its model does on data that it did not see."""

    model: ActuatorModel
    held_out_rms_um: float
    held_out_max_um: float


@dataclass(frozen=True, slots=True)
class Job:
    """A recipe, the setup of the machine, the holes to make, and the actuator's calibration where there is one."""

    profile: Profile
    setup: Setup
    sites: tuple[Site, ...]
    calibration: CalibratedActuator | None = None

    @property
    def pad(self) -> Site:
        """Where the surface is touched before and after a cut."""
        return Site("the reference pad", self.setup.stage.reference_x_um, self.setup.stage.reference_y_um)

    @property
    def parking(self) -> Site:
        """Beside the work, where the actuator may use its whole stroke."""
        return Site("the parking place", self.setup.stage.park_x_um, self.setup.stage.park_y_um)


def single_hole(profile: Profile, setup: Setup, calibration: CalibratedActuator | None = None) -> Job:
    """One hole, `measure.site_dx_um` beside the reference pad."""
    stage = setup.stage
    site = Site(profile.meta.name, stage.reference_x_um + profile.measure.site_dx_um, stage.reference_y_um)
    return Job(profile, setup, (site,), calibration)
