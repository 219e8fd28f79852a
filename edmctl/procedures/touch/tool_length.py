"""Where the tool would touch the reference pad now: touched, and worn since."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmctl.procedures.touch.reading import SurfaceReading

TOUCH_U_UM = 0.15
"""Standard uncertainty of a reading of three touches."""


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
        """Standard uncertainty of that, at a moment."""
        drift_um = drift_u_um_per_s * max(0.0, now_s - self.pad.time_s)
        return math.hypot(TOUCH_U_UM, self.pad.doubt_u_um, self.wear_u_um, drift_um)

    def worn(self, wear_um: float, wear_u_um: float) -> ToolLength:
        """Return the length after a hole that was not measured; the errors of such holes go the same way."""
        return ToolLength(self.pad, self.wear_um + wear_um, self.wear_u_um + wear_u_um)
