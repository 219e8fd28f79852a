"""Depth and tool wear from three touches, with their uncertainty.

Z counts towards the work. Z1 is the surface before the cut, Z2 the bottom of the hole, Z3 the surface after;
the surface is touched at a reference pad beside the hole. Then `wear = Z3 - Z1`, `depth = Z2 - Z3` and
`feed = Z2 - Z1 = depth + wear` (Muralidhara et al. 2009, section 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

_NORMAL_97_5 = 1.959963984540054
TOUCH_SD_PRIOR_UM = 0.2
"""Repeatability of one touch expected before any was made: sensor noise and contact hunting."""
TOUCH_PRIOR_DOF = 2.0
"""Weight of that expectation, as if it came from three earlier touches."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Mean of a set of touches at one place.

    `sd_um` is the sample standard deviation (n - 1) of the touches; of no meaning when `touches` is 1.
    """

    mean_um: float
    sd_um: float
    touches: int


@dataclass(frozen=True, slots=True)
class DepthAndWear:
    """Depth, wear and total feed, each with the half-width of its 95 % interval, µm.

    `depth_noise_um` is the part of the depth's standard uncertainty that another set of touches would redraw.
    """

    depth_um: float
    depth_u95_um: float
    wear_um: float
    wear_u95_um: float
    feed_um: float
    feed_u95_um: float
    depth_noise_um: float

    @property
    def wear_ratio(self) -> float:
        """Wear length per depth; 0 while there is no depth."""
        return self.wear_um / self.depth_um if self.depth_um > 0.0 else 0.0


def reading_of(touches_um: tuple[float, ...]) -> Reading:
    """Mean and sample standard deviation of single touches, µm. Raises ValueError without any touch."""
    n = len(touches_um)
    if n == 0:
        raise ValueError("a reading needs at least one touch")
    mean = math.fsum(touches_um) / n
    variance = math.fsum((z - mean) ** 2 for z in touches_um) / (n - 1) if n > 1 else 0.0
    return Reading(mean, math.sqrt(variance), n)


def pooled_reading(readings: Sequence[Reading]) -> Reading:
    """One reading of the touches of several: their mean, and their scatter about it."""
    n = sum(reading.touches for reading in readings)
    mean_um = math.fsum(reading.touches * reading.mean_um for reading in readings) / n
    squares = math.fsum(
        (reading.touches - 1) * reading.sd_um**2 + reading.touches * (reading.mean_um - mean_um) ** 2
        for reading in readings
    )
    return Reading(mean_um, math.sqrt(squares / (n - 1)) if n > 1 else 0.0, n)


def student_97_5(dof: float) -> float:
    """97.5 % quantile of Student's t, for dof >= 2 (Fisher's expansion in 1/dof, within 1 %)."""
    z = _NORMAL_97_5
    terms = (
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
        (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 92160.0,
    )
    return z + math.fsum(term / dof ** (k + 1) for k, term in enumerate(terms))


def share_u(most: float) -> float:
    """Standard uncertainty of an error that is some share of `most`, from nothing to all of it as likely.

    In the unit of `most`. The root of the mean square about the end where the error is nothing, because no share of
    it is corrected. It is the number of an error anywhere within ± `most` about the middle (JCGM 100:2008, §4.3.7).
    """
    return abs(most) / math.sqrt(3.0)


def tilt_uncertainty_um(tilt_u_mrad: float, distance_um: float, stage_repeatability_um: float = 0.0) -> float:
    """Standard uncertainty in µm of the height between two places on a surface of unknown slope.

    Each place is met within the stage's repeatability, so even a distance of 0 leaves a little.
    """
    return 1e-3 * tilt_u_mrad * math.sqrt(distance_um**2 + 2.0 * stage_repeatability_um**2)


@dataclass(frozen=True, slots=True)
class _Noise:
    """Repeatability of one touch, pooled over sets, and the degrees of freedom behind it."""

    sd_um: float
    dof: float

    def of_difference(self, a: Reading, b: Reading) -> float:
        return self.sd_um * math.sqrt(1.0 / a.touches + 1.0 / b.touches)

    def u95(self, noise_um: float, systematic_um: tuple[float, ...]) -> float:
        """Half-width of the 95 % interval; effective degrees of freedom after Welch and Satterthwaite."""
        combined = math.hypot(noise_um, *systematic_um)
        if noise_um == 0.0:
            return _NORMAL_97_5 * combined
        return student_97_5(self.dof * (combined / noise_um) ** 4) * combined


def _pooled(readings: tuple[Reading, ...], prior_sd_um: float) -> _Noise:
    dof = TOUCH_PRIOR_DOF + sum(r.touches - 1 for r in readings)
    squares = TOUCH_PRIOR_DOF * prior_sd_um**2 + math.fsum((r.touches - 1) * r.sd_um**2 for r in readings)
    return _Noise(math.sqrt(squares / dof), dof)


def measure(
    z1: Reading,
    z2: Reading,
    z3: Reading,
    *,
    gain_u_rel: float,
    tilt_u_um: float,
    drift_u_um_per_s: float,
    z1_to_z3_s: float,
    z2_to_z3_s: float,
    pad_u_um: float = 0.0,
    linearity_u_um: float = 0.0,
    height_um: float = 0.0,
    z1_u_um: float = 0.0,
    doubts_u_um: tuple[float, float, float] = (0.0, 0.0, 0.0),
    touch_sd_prior_um: float = TOUCH_SD_PRIOR_UM,
) -> DepthAndWear:
    """Depth, wear and feed with 95 % intervals.

    `z1`, `z2`, `z3` are the touches of the pad before, of the bottom and of the pad after the cut, with
    `z1_to_z3_s` and `z2_to_z3_s` between them. The rest are standard uncertainties: `gain_u_rel` of the
    sensor's gain, which grows with the length; `linearity_u_um` of its characteristic; `drift_u_um_per_s` of
    its drift; `tilt_u_um` of the height between pad and site, which enters depth and feed but not wear;
    `pad_u_um` of meeting the same pad again (stage repeatability through tilt). `touch_sd_prior_um` is the
    repeatability of one touch expected beforehand, because three touches alone know it badly. `height_um` is how
    much further than the pad the face at the site lies, `z1_u_um` what a Z1 that was not touched right before adds,
    `doubts_u_um` what each of the three adds where its touches were in doubt.
    """
    bottom_um = z2.mean_um - height_um
    depth_um, wear_um, feed_um = bottom_um - z3.mean_um, z3.mean_um - z1.mean_um, bottom_um - z1.mean_um
    noise = _pooled((z1, z2, z3), touch_sd_prior_um)
    depth_noise = noise.of_difference(z2, z3)

    def sensor_um(length_um: float, seconds: float) -> float:
        return math.hypot(gain_u_rel * length_um, linearity_u_um, drift_u_um_per_s * seconds)

    doubt1, doubt2, doubt3 = doubts_u_um
    depth_u95 = noise.u95(depth_noise, (sensor_um(depth_um, z2_to_z3_s), tilt_u_um, doubt2, doubt3))
    wear_parts = (sensor_um(wear_um, z1_to_z3_s), pad_u_um, z1_u_um, doubt1, doubt3)
    wear_u95 = noise.u95(noise.of_difference(z3, z1), wear_parts)
    feed_s = z1_to_z3_s - z2_to_z3_s
    feed_parts = (sensor_um(feed_um, feed_s), tilt_u_um, z1_u_um, doubt1, doubt2)
    feed_u95 = noise.u95(noise.of_difference(z2, z1), feed_parts)
    return DepthAndWear(depth_um, depth_u95, wear_um, wear_u95, feed_um, feed_u95, depth_noise)
