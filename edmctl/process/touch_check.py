"""Whether a touch can be believed: readings against each other and against what is expected.

Every check compares two numbers whose difference should be zero within a standard uncertainty, and doubts beyond
so many of them (`*_SIGMAS`); the chance that a good touch is doubted is that of the normal distribution. A chip
under the tool closes contact early: a wrong reading is too short, never too long, so of two readings that differ
the longer one is nearer to the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.process.wear import TOUCH_SD_PRIOR_UM, Reading

if TYPE_CHECKING:
    from collections.abc import Sequence

SPOT_SIGMAS = 3.0
"""Two spots of one surface differ by more in 0.3 % of cases; the third spot that is then touched takes seconds."""
SHORT_SIGMAS = 2.0
"""A bottom that is shorter than expected by more is touched again: 2.3 % of all good ones, one side only."""
LONG_SIGMAS = 3.0
"""A bottom that is longer is not a chip, and its place is only looked at again: 0.13 %."""
GROWN_SIGMAS = 4.0
"""A tool that is longer than before the cut by more is not what was touched: 0.003 %."""
SAME_TOUCHES = 3
"""So many touches that agree to the last digit are doubted. One touch scatters by 0.04 µm on the virtual machine;
with digits of d = 1 nm, n touches of a scatter s are equal by chance in (d/s√(2π))ⁿ⁻¹/√n of all cases: three in 6 of
10⁵ readings, which a long array meets. They are therefore touched again before that is believed: four are equal in 5
of 10⁷."""
SAME_WITHIN_UM = 5e-4


@dataclass(frozen=True, slots=True)
class Deviation:
    """A reading less what it should be, µm, and the standard uncertainty of that difference."""

    um: float
    u_um: float

    @property
    def sigmas(self) -> float:
        """In standard uncertainties; negative is too short."""
        return self.um / self.u_um


def is_constant(readings: Sequence[Reading]) -> bool:
    """Whether all touches repeat to the last digit, which those of a sensor with noise cannot."""
    means_um = [reading.mean_um for reading in readings]
    scatter_um = max(max(means_um) - min(means_um), *(reading.sd_um for reading in readings))
    return sum(reading.touches for reading in readings) >= SAME_TOUCHES and scatter_um < SAME_WITHIN_UM


def between_spots(a: Reading, b: Reading, place_u_um: float) -> Deviation:
    """How much longer the reading at one spot of a surface is than at another.

    Expected is zero. The touches scatter by TOUCH_SD_PRIOR_UM each, and `place_u_um` is how far the spots may really
    differ: tilt between them, and drift meanwhile.
    """
    noise_um = TOUCH_SD_PRIOR_UM * math.sqrt(1.0 / a.touches + 1.0 / b.touches)
    return Deviation(a.mean_um - b.mean_um, math.hypot(noise_um, place_u_um))


def agreeing_spots(spots: Sequence[Reading], place_u_um: float) -> tuple[int, ...]:
    """Which of the spots, in their order, agree with the longest one; a single one means that nothing confirms it.

    A shorter reading had a chip under the tool. `place_u_um` as in `between_spots`.
    """
    longest = max(spots, key=lambda spot: spot.mean_um)
    return tuple(
        i for i, spot in enumerate(spots) if between_spots(longest, spot, place_u_um).sigmas <= SPOT_SIGMAS
    )


def against_sparks(bottom_um: float, end_um: float, gap_um: float, gap_u_um: float) -> Deviation:
    """A touched bottom against where the tool sparked last: at `end_um`, a gap of `gap_um` ± `gap_u_um` before it.

    Drift between the two is seconds old and left out.
    """
    return Deviation(bottom_um - (end_um + gap_um), math.hypot(gap_u_um, TOUCH_SD_PRIOR_UM))


def is_short(bottom: Deviation, gap_um: float) -> bool:
    """Whether something lies on the bottom: it is too short, or not even where the tool has just sparked."""
    return bottom.sigmas < -SHORT_SIGMAS or gap_um + bottom.um < -SPOT_SIGMAS * TOUCH_SD_PRIOR_UM


def is_long(bottom: Deviation) -> bool:
    """Whether a bottom lies deeper than the gap that was believed allows."""
    return bottom.sigmas > LONG_SIGMAS


def between(touch_um: float, end_um: float, gap_um: float, gap_u_um: float) -> tuple[float, float]:
    """Where a bottom is whose touch stays short: the best estimate of it, and its standard uncertainty.

    A chip can only shorten a touch, and the tool has sparked at `end_um` without being shorted. So the bottom lies
    between the deeper of these two and what the sparks say, with the same chance anywhere (a rectangular
    distribution, JCGM 100:2008 §4.3.7), and what the sparks say has an uncertainty of its own.
    """
    highest_um, deepest_um = max(touch_um, end_um), end_um + gap_um
    way_um = max(0.0, deepest_um - highest_um)
    return deepest_um - 0.5 * way_um, math.hypot(way_um / math.sqrt(12.0), gap_u_um)


def has_grown(wear: Deviation) -> bool:
    """Whether the pad says that the tool has become longer, beyond what drift and touches explain."""
    return wear.sigmas < -GROWN_SIGMAS
