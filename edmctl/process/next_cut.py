"""Size of the next cut, and whether it has to be measured.

Tool wear takes an uncertain part of a feed. So a cut goes to the target only if the wear is known well enough;
otherwise it stays short of it by the uncertainty, and is measured.
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass
from edmctl.process.live_erosion import ErosionEstimate

CLEAR_SIGMAS = 2.0
"""Standard uncertainties by which a decision stays clear of a limit. The interval of a result has its own factor."""
GAP_U_UM = 0.09
"""Standard uncertainty of the working gap that a cut ends with, measured once: servo, sensor noise (0057)."""
NOISE_FLOOR_SIGMAS = 2.0
"""A rest below this many standard deviations of the depth is noise; chasing it only cuts too deep."""
FINISH_SHARE = 0.08
"""A finishing cut of at most this share of the depth need not be measured: what it adds is known well enough."""
LEAST_FINISH_UM = 3.0


@dataclass(frozen=True, slots=True)
class NextCut:
    """Depth that the next cut is to add, and its feed, µm; `depth_u_um` is what the cut will leave unknown of it.

    `measured` says whether a measuring stop has to follow.
    """

    depth_um: float
    feed_um: float
    depth_u_um: float
    measured: bool


def is_done(remaining_um: float, tolerance_um: float, depth_noise_um: float) -> bool:
    """Whether the rest is below half the tolerance, or the noise of the measurement where that is larger."""
    return remaining_um <= max(tolerance_um / 2.0, NOISE_FLOOR_SIGMAS * depth_noise_um)


def largest_first_um(target_um: float, first_fraction: float, estimate: ErosionEstimate) -> float:
    """Return the deepest first cut of a hole, µm.

    Without a touch, or after a contradicted one, the cut feeds no further than the target is deep, so that a tool
    that wears less than expected does not cut too deep.
    """
    if estimate.fits > 0 and not estimate.contradicted:
        return target_um
    return target_um * min(first_fraction, 1.0 / (1.0 + estimate.wear_ratio))


def next_cut(
    estimate: ErosionEstimate,
    *,
    target_um: float,
    remaining_um: float,
    tolerance_um: float,
    start_u_um: float,
    gap_u_um: float = GAP_U_UM,
    largest_um: float = math.inf,
    begun: bool,
) -> NextCut:
    """Size the next cut of a hole of `target_um` depth, of which `remaining_um` are left, within `tolerance_um`.

    start_u_um, gap_u_um : standard uncertainties of the start (surface or measured bottom) and of the final gap
    largest_um : deepest cut that the recipe allows
    begun : whether the hole has been measured before

    With a contradicted or unconfirmed ratio the cut feeds no further than the remaining depth.
    """
    if estimate.contradicted or (begun and estimate.fits == 0):
        largest_um = min(largest_um, remaining_um / (1.0 + estimate.wear_ratio))
    whole = _cut(estimate, remaining_um, start_u_um, gap_u_um)
    known = CLEAR_SIGMAS * whole.depth_u_um <= tolerance_um and remaining_um <= largest_um
    if known:
        small = begun and remaining_um <= max(LEAST_FINISH_UM, FINISH_SHARE * target_um)
        skip = small or (not begun and estimate.fits > 0 and not estimate.contradicted)
        return NextCut(whole.depth_um, whole.feed_um, whole.depth_u_um, measured=not skip)
    short_um = max(remaining_um - CLEAR_SIGMAS * whole.depth_u_um, 0.5 * remaining_um)
    return _cut(estimate, min(short_um, largest_um), start_u_um, gap_u_um)


def _cut(estimate: ErosionEstimate, depth_um: float, start_u_um: float, gap_u_um: float) -> NextCut:
    feed_um = depth_um * (1.0 + estimate.wear_ratio)
    split = estimate.split(feed_um, gap_u_um)
    return NextCut(depth_um, feed_um, math.hypot(start_u_um, split.depth_u_um), measured=True)
