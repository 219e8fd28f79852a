"""How far the zero of the displacement may drift: what the setup believes, and what the rests at 0 V have shown.

A rest does not tell drift from creep of the actuator, and a drift between tool and work does not show at rest. So
what was seen only widens what is believed, and no reading is corrected by it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.procedures.measuring import displacement_uncertainty
from edmctl.process.wear import share_u

if TYPE_CHECKING:
    from edmctl.procedures.run import Run
    from edmctl.profile.stops import Displacement

LEAST_SPAN_S = 120.0
"""Over less time than this the error of the actuator model after a deep cut, a few µm, would look like a drift."""
RECENT_S = 600.0
"""A drift that has set in lately is looked for over this much time."""
DRIFT_SDS = 4.0
"""A drift of more than so many standard deviations is none."""


class Rests:
    """Zeros of the displacement at every rest at 0 V: what the sensor showed beyond the actuator's own creep.

    Zeros count from wherever the actuator model does, so only their differences tell something. `first_um` is the
    rest before the actuator was conditioned, at `first_s`, NaN before there is one; `hidden_um` is by how much at
    most it is too far out.
    """

    def __init__(self) -> None:
        self._rests: list[tuple[float, float]] = []
        self.first_um = math.nan
        self.first_s = math.nan
        self.hidden_um = 0.0

    def note(self, time_s: float, zero_um: float) -> None:
        """Take a rest."""
        self._rests.append((time_s, zero_um))

    def home_um(self, zero_um: float) -> float:
        """What the sensor shows of a tool at home, by a rest with that zero."""
        return self.first_um + (zero_um - self._rests[0][1] if self._rests else 0.0)

    def ends(self) -> tuple[tuple[float, float], ...]:
        """Time and zero of the first and of the newest rest; none before the first."""
        return (self._rests[0], self._rests[-1]) if self._rests else ()

    def rate_um_s(self) -> float:
        """Fastest drift that the zeros allow, over the whole job or lately, µm/s; 0 before the second rest."""
        if len(self._rests) < 2:
            return 0.0
        last_s, last_um = self._rests[-1]
        recent = next(
            (rest for rest in reversed(self._rests) if last_s - rest[0] >= RECENT_S), self._rests[0]
        )
        return max(
            abs(last_um - zero_um) / max(LEAST_SPAN_S, last_s - time_s)
            for time_s, zero_um in (self._rests[0], recent)
        )


def first_home_um(rest_um: float, expected_um: float, drift_um: float) -> float:
    """What a first rest at 0 V says of home, expected at `expected_um` and perhaps drifted by `drift_um` since.

    A rest that reads less is believed: nothing pulls a tool beyond home. One that reads more is, as far as the
    sensor may have drifted since; what is left is a tool that stands out, by creep or by something that is broken.
    """
    return min(rest_um, expected_um + drift_um)


def uncertainty_now(run: Run) -> Displacement:
    """What is known of the displacements of a job, with the drift that its rests have shown where that is more."""
    known = displacement_uncertainty(run.job)
    seen_um_s = share_u(run.watch.rests.rate_um_s())
    return replace(known, drift_u_um_per_s=max(known.drift_u_um_per_s, seen_um_s))
