"""What is found wrong with a profile or setup: a stable code, the value to blame, the remedy.

E30xx are about the file; E31nn and W31nn (a warning) are cross-field rule nn.
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass
from edmctl.errors import Location
from edmctl.failures import Code
from edmctl.profile.positions import KeyPath

PAD_MARGIN_UM = 50.0  # surface left between a hole and the reference pad, for the burr and the stages
REFERENCE_MARGIN, REFERENCE_MAX = 0.05, 0.95
"""Least servo reference above the level of a gap that sparks at every pulse, and the highest."""
WALL_UM = 20.0  # work left standing between two holes or two sides of a channel


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
