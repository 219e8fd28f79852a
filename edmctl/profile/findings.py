"""What a cross-field rule reports."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from edmctl.profile.forecast import forecast

if TYPE_CHECKING:
    from edmctl.errors import Location
    from edmctl.profile.codes import Code
    from edmctl.profile.forecast import Forecast
    from edmctl.profile.locate import KeyPath
    from edmctl.profile.model import Profile
    from edmctl.profile.places import Place
    from edmctl.profile.setup import Setup


PAD_MARGIN_UM = 50.0
"""Surface left between a hole and the reference pad, for the burr and the stages."""
WALL_UM = 20.0
"""Work left standing between two holes or two sides of a channel."""


@dataclass(frozen=True)
class Job:
    """Everything a rule may look at. The forecast needs nearly every value, so only rules that ask make one."""

    profile: Profile
    setup: Setup
    places: tuple[Place, ...] = ()

    @cached_property
    def forecast(self) -> Forecast:
        """Expected course of the job."""
        return forecast(self.profile, self.setup, self.places)


@dataclass(frozen=True, slots=True)
class Finding:
    """One violated rule, blamed on the value at `path`, or on a line of a file that it names (`where`)."""

    code: Code
    path: KeyPath
    message: str
    hint: str
    where: Location | None = None

    @property
    def is_warning(self) -> bool:
        """Codes of warnings begin with W."""
        return self.code.startswith("W")


def rounded_up(value: float) -> str:
    """A least value as a hint gives it: a tenth that is not below it."""
    return f"{math.ceil(10.0 * value - 1e-9) / 10.0:.6g}"


def rounded_down(value: float) -> str:
    """A largest value as a hint gives it: a tenth that is not above it."""
    return f"{math.floor(10.0 * value + 1e-9) / 10.0:.6g}"
