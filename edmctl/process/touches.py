"""Depth and tool wear from three touches, with their uncertainty, and checks for false readings.

Z counts towards the work. Z1 is the surface before the cut, Z2 the bottom of the hole, Z3 the surface after;
the surface is touched at a reference pad beside the hole. Then `wear = Z3 - Z1`, `depth = Z2 - Z3` and
`feed = Z2 - Z1 = depth + wear` (Muralidhara et al. 2009, section 4).

Every check compares a difference that should be zero with a multiple (`*_SIGMAS`) of its standard uncertainty. A
chip under the tool closes contact early: a false reading is too short, never too long, so the longer one of two is
nearer to the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

from edmctl.dataclasses import dataclass
from edmctl.quantity import Value, coverage_factor

TOUCH_SD_PRIOR_UM = 0.06
"""Repeatability of one touch expected before any was made: roughness of both faces, and sensor noise averaged while
the tool hunts at contact."""
TOUCH_U_UM = 0.06
"""Standard uncertainty of a reading of three touches, with what the zero walks between two readings."""
TOUCH_CHECK_SD_UM = 0.2
"""A touch is not doubted for a scatter of this much, which a rougher face than usual has."""
LINEARITY_LENGTH_UM = 200.0  # a length from which all of the nonlinearity counts [assumed]
TOUCH_PRIOR_DOF = 1.0  # weight of that expectation, as if it came from two earlier touches
LEAST_SCATTER_DOF = 3
"""Fewer degrees of freedom tell less of the scatter of the touches than what is expected of it beforehand."""
SPOT_SIGMAS = 3.0
"""Two spots of one surface differ by more in 0.3 % of cases; the third spot that is then touched takes seconds."""
SHORT_SIGMAS = 2.0
"""A bottom that is shorter than expected by more is touched again: 2.3 % of all good ones, one side only."""
LONG_SIGMAS = 3.0  # a bottom that is longer is not a chip, and its place is only looked at again: 0.13 %
GROWN_SIGMAS = 4.0  # a tool that is longer than before the cut by more is not what was touched: 0.003 %
SAME_TOUCHES = 3
"""So many touches that agree to the last digit are doubted. One touch scatters by 0.04 µm on the virtual machine;
with digits of d = 1 nm, n touches of a scatter s are equal by chance in (d/s√(2π))ⁿ⁻¹/√n of all cases: three in 6 of
10⁵ readings, which a long array meets. They are therefore touched again before that is believed: four are equal in 5
of 10⁷."""
SAME_WITHIN_UM = 5e-4


@dataclass(frozen=True, slots=True)
class Reading:
    """Mean of a set of touches at one place, and their sample standard deviation (n - 1); 0 of a single touch."""

    mean_um: float
    sd_um: float
    touches: int


@dataclass(frozen=True, slots=True)
class Displacement:
    """Standard uncertainties of the sensor, or of an actuator model without one; the walk is that of the zero."""

    gain_u_rel: float = 0.0
    linearity_u_um: float = 0.0
    drift_u_um_per_s: float = 0.0
    walk_um_per_sqrt_s: float = 0.0
    model_u_um: float = 0.0

    def length_u_um(self, length_um: float) -> float:
        """Return the standard uncertainty of a length, without drift."""
        return math.hypot(self.gain_u_rel * length_um, self.bend_u_um(length_um), self.model_u_um)

    def bend_u_um(self, length_um: float) -> float:
        """Return the part by the characteristic, which bends over hundreds of micrometres."""
        return self.linearity_u_um * min(abs(length_um) / LINEARITY_LENGTH_UM, 1.0)

    def drifted_u_um(self, seconds: float) -> float:
        """Return the standard uncertainty of the zero after a time."""
        return math.hypot(self.drift_u_um_per_s * seconds, self.walk_um_per_sqrt_s * math.sqrt(abs(seconds)))


@dataclass(frozen=True, slots=True)
class Drift:
    """How far a touch of the same place drifted between two moments, and the standard uncertainty of that, µm."""

    um: float
    left_u_um: float


@dataclass(frozen=True, slots=True)
class DepthAndWear:
    """Depth, wear and total feed, µm.

    depth_noise_um : part of the depth's standard uncertainty from the scatter of its touches
    drift_um, drift_to_bottom_um : corrections of the pad after the cut, and of the bottom before it
    drift_left_u_um : standard uncertainty of the uncorrected drift in the wear; NaN if the wear was not touched
    drift_by_rests : whether the drift was measured
    """

    depth: Value
    wear: Value
    feed: Value
    depth_noise_um: float
    drift_um: float = 0.0
    drift_to_bottom_um: float = 0.0
    drift_left_u_um: float = math.nan
    drift_by_rests: bool = False

    @property
    def depth_um(self) -> float:
        """Estimate of the depth."""
        return self.depth.value

    @property
    def wear_um(self) -> float:
        """Estimate of the wear."""
        return self.wear.value

    @property
    def feed_um(self) -> float:
        """Estimate of the feed."""
        return self.feed.value

    def columns(self) -> dict[str, Any]:
        """Return the lengths by the names of a result's fields."""
        depth, wear = self.depth.columns("depth_{}um"), self.wear.columns("wear_{}um")
        return depth | wear | self.feed.columns("feed_{}um")

    @property
    def wear_ratio(self) -> float:
        """Wear length per depth; 0 while there is no depth."""
        return self.wear_um / self.depth_um if self.depth_um > 0.0 else 0.0


class Touched(Protocol):
    """A reading, when it was made, and the standard uncertainty that suspect touches add to it, µm."""

    @property
    def reading(self) -> Reading: ...
    @property
    def time_s(self) -> float: ...
    @property
    def doubt_u_um(self) -> float: ...


@dataclass(frozen=True, slots=True)
class Touch:
    """The plain form of that."""

    time_s: float
    reading: Reading
    doubt_u_um: float = 0.0


def reading_of(touches_um: tuple[float, ...]) -> Reading:
    """Mean and sample standard deviation of single touches, µm. Raises ValueError without any touch."""
    if not touches_um:
        raise ValueError("a reading needs at least one touch")
    return pooled_reading([Reading(z_um, 0.0, 1) for z_um in touches_um])


def pooled_reading(readings: Sequence[Reading]) -> Reading:
    """One reading of the touches of several: their mean, and their scatter about it."""
    n = sum(reading.touches for reading in readings)
    mean_um = math.fsum(reading.touches * reading.mean_um for reading in readings) / n
    squares = math.fsum(
        (reading.touches - 1) * reading.sd_um**2 + reading.touches * (reading.mean_um - mean_um) ** 2
        for reading in readings
    )
    return Reading(mean_um, math.sqrt(squares / (n - 1)) if n > 1 else 0.0, n)


@dataclass(slots=True)
class TouchScatter:
    """Repeatability of one touch, pooled over the readings of a run."""

    dof: int = 0
    squares_um2: float = 0.0

    def add(self, reading: Reading) -> None:
        """Take a reading."""
        self.dof += reading.touches - 1
        self.squares_um2 += (reading.touches - 1) * reading.sd_um**2

    @property
    def u_um(self) -> float:
        """Standard uncertainty of one touch: the wider the fewer there are, as Student's t is; before, the prior."""
        if self.dof < LEAST_SCATTER_DOF:
            return TOUCH_CHECK_SD_UM
        return (
            math.sqrt(self.squares_um2 / self.dof) * coverage_factor(0.95, self.dof) / coverage_factor(0.95)
        )


def share_u(most: float) -> float:
    """Return the standard uncertainty of an uncorrected error between 0 and `most`, RMS (JCGM 100:2008, §4.3.7)."""
    return abs(most) / math.sqrt(3.0)


def tilt_uncertainty_um(tilt_u_mrad: float, distance_um: float, stage_repeatability_um: float = 0.0) -> float:
    """Standard uncertainty of the height between two places on a surface of unknown slope, µm."""
    return 1e-3 * tilt_u_mrad * math.sqrt(distance_um**2 + 2.0 * stage_repeatability_um**2)


def _repeatability(readings: tuple[Reading, ...]) -> Value:
    """Return the standard deviation of one touch, pooled over readings, with its degrees of freedom."""
    dof = TOUCH_PRIOR_DOF + sum(r.touches - 1 for r in readings)
    squares = TOUCH_PRIOR_DOF * TOUCH_SD_PRIOR_UM**2
    squares += math.fsum((r.touches - 1) * r.sd_um**2 for r in readings)
    return Value(0.0, math.sqrt(squares / dof), dof)


def _difference_u_um(touch_u_um: float, a: Reading, b: Reading) -> float:
    return touch_u_um * math.sqrt(1.0 / a.touches + 1.0 / b.touches)


def measure(
    z1: Touched,
    z2: Touched,
    z3: Touched,
    sensor: Displacement,
    *,
    tilt_u_um: float,
    pad_u_um: float = 0.0,
    height_um: float = 0.0,
    z1_u_um: float = 0.0,
    drift: Drift | None = None,
) -> DepthAndWear:
    """Return depth, wear and feed with their uncertainties; degrees of freedom after Welch and Satterthwaite.

    A known `drift` from Z1 to Z3 is subtracted from the pad after the cut, and from the bottom in proportion to the
    time; its residual counts in place of the drift of the sensor, except between the last two touches.

    z1, z2, z3 : touches of the pad before the cut, of the bottom, and of the pad after it
    tilt_u_um : standard uncertainty of the height between pad and site, which enters depth and feed but not wear
    pad_u_um : of meeting the same pad again (stage repeatability through tilt)
    height_um : how much further than the pad the workpiece surface at the site lies
    z1_u_um : what a Z1 that was not touched right before adds
    """
    z1_to_z3_s, z2_to_z3_s = z3.time_s - z1.time_s, z3.time_s - z2.time_s
    by_bottom = 1.0 - z2_to_z3_s / z1_to_z3_s if z1_to_z3_s > 0.0 else 1.0
    drift_um = drift.um if drift else 0.0
    drift_to_bottom_um = by_bottom * drift_um
    first, bottom, last = z1.reading, z2.reading, z3.reading
    bottom_um, pad_um = bottom.mean_um - height_um - drift_to_bottom_um, last.mean_um - drift_um
    depth_um, wear_um, feed_um = bottom_um - pad_um, pad_um - first.mean_um, bottom_um - first.mean_um
    touch = _repeatability((first, bottom, last))

    def length(um: float, start: Reading, end: Reading, *parts_u_um: float) -> Value:
        noise_u_um = _difference_u_um(touch.u, start, end)
        return Value(um, noise_u_um, touch.dof).widened(math.hypot(*parts_u_um))

    left_u_um = drift.left_u_um if drift else sensor.drifted_u_um(z1_to_z3_s)
    last_u_um = sensor.drifted_u_um(z2_to_z3_s)
    to_bottom_u_um = sensor.drifted_u_um(z1_to_z3_s - z2_to_z3_s)
    if drift:
        to_bottom_u_um = math.hypot(by_bottom * drift.left_u_um, last_u_um)
    doubt1, doubt2, doubt3 = z1.doubt_u_um, z2.doubt_u_um, z3.doubt_u_um
    depth_u_um, wear_u_um, feed_u_um = map(sensor.length_u_um, (depth_um, wear_um, feed_um))
    return DepthAndWear(
        length(depth_um, bottom, last, depth_u_um, last_u_um, tilt_u_um, doubt2, doubt3),
        length(wear_um, last, first, wear_u_um, left_u_um, pad_u_um, z1_u_um, doubt1, doubt3),
        length(feed_um, bottom, first, feed_u_um, to_bottom_u_um, tilt_u_um, z1_u_um, doubt1, doubt2),
        _difference_u_um(touch.u, bottom, last),
        drift_um=drift_um,
        drift_to_bottom_um=drift_to_bottom_um,
        drift_left_u_um=left_u_um,
        drift_by_rests=drift is not None,
    )


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
    """Return how much longer the reading at one spot of a surface is than at another.

    `place_u_um` is the standard uncertainty of a real difference: tilt between the spots, and drift meanwhile.
    """
    noise_u_um = _difference_u_um(TOUCH_CHECK_SD_UM, a, b)
    return Deviation(a.mean_um - b.mean_um, math.hypot(noise_u_um, place_u_um))


def agreeing_spots(spots: Sequence[Reading], place_u_um: float) -> tuple[int, ...]:
    """Return which spots agree with the longest one, itself included. `place_u_um` as in `between_spots`."""
    longest = max(spots, key=lambda spot: spot.mean_um)
    return tuple(
        i for i, spot in enumerate(spots) if between_spots(longest, spot, place_u_um).sigmas <= SPOT_SIGMAS
    )


def against_sparks(bottom_um: float, end_um: float, gap_um: float, gap_u_um: float) -> Deviation:
    """Compare a touched bottom with the last sparks, at `end_um` and a gap of `gap_um` ± `gap_u_um` before it."""
    return Deviation(bottom_um - (end_um + gap_um), math.hypot(gap_u_um, TOUCH_CHECK_SD_UM))


def is_short(bottom: Deviation, gap_um: float) -> bool:
    """Whether something lies on the bottom: the reading is too short, or short of the last sparks."""
    return bottom.sigmas < -SHORT_SIGMAS or gap_um + bottom.um < -SPOT_SIGMAS * TOUCH_CHECK_SD_UM


def is_long(bottom: Deviation) -> bool:
    """Whether a bottom is deeper than the assumed gap allows."""
    return bottom.sigmas > LONG_SIGMAS


def between(touch_um: float, end_um: float, gap_um: float, gap_u_um: float) -> tuple[float, float]:
    """Return the best estimate of a bottom whose touch stays short, and its standard uncertainty.

    A chip can only shorten a touch, and the tool has sparked at `end_um` without a short. So the bottom has a
    rectangular distribution (JCGM 100:2008, §4.3.7) from the deeper of these two to the depth by the sparks, which
    has an uncertainty of its own.
    """
    highest_um, deepest_um = max(touch_um, end_um), end_um + gap_um
    way_um = max(0.0, deepest_um - highest_um)
    return deepest_um - 0.5 * way_um, math.hypot(way_um / math.sqrt(12.0), gap_u_um)


def has_grown(wear: Deviation) -> bool:
    """Whether the tool appears longer than drift and touches explain."""
    return wear.sigmas < -GROWN_SIGMAS
