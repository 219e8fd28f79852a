"""Division of the wear between two touches of the reference pad among the holes made meanwhile.

The expected wears have a common error (the wear ratio) and one of their own. The touched length contains the wear
of all holes and the drift of the sensor. All are jointly normal, so the touch conditions them at once, and the
remaining errors stay correlated: a tool that was shorter than expected made every later hole shallower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass

CONTRADICTION_SDS = 2.0
"""A touch further from the expectation than this widens its uncertainty by the excess."""
MOST_ALONE = 8  # of more holes than these it is unlikely that just one has changed
LEAST_WEAR_UM = 1e-3  # even a hole that is expected to have worn nothing may have


@dataclass(frozen=True, slots=True)
class WearShare:
    """Wear that a hole is expected to have taken, µm, and the moment at which it ended, s after the touch before.

    `common_u_um` is the part of its standard uncertainty that has the same sign in all holes, `own_u_um` the rest.
    """

    wear_um: float
    common_u_um: float
    own_u_um: float
    after_s: float


@dataclass(frozen=True, slots=True)
class SharedWear:
    """Wear of one hole after the touch, and how far the tip was from where it was taken to be at its end, µm.

    A positive `tip_um` is a tip that stood further back: the hole is as much shallower. `wear_u_um` and `tip_u_um`
    are standard uncertainties; `feed_u_um` is that of the tip without the wear of the hole itself, which takes from
    its depth what it adds to its wear.
    """

    wear_um: float
    wear_u_um: float
    tip_um: float
    tip_u_um: float
    feed_u_um: float


def share_wear(
    shares: Sequence[WearShare],
    found_um: float,
    after_s: float,
    *,
    touch_u_um: float,
    drift_u_um_per_s: float,
) -> tuple[SharedWear, ...]:
    """Divide what the tool has lost by a touch among the holes since the touch before; in their order.

    found_um, after_s : how much further and later the touch was than the one before
    touch_u_um : standard uncertainty of the difference of both touches without drift
    drift_u_um_per_s : standard uncertainty of a steady drift of the sensor

    A touch beyond `CONTRADICTION_SDS` of its expectation first widens the covariance to that ratio. What touches,
    drift and single holes do not explain may come from all holes, the last ones or one. So half of it is added to
    the own uncertainty of each hole, less among more than `MOST_ALONE` holes, and at most the expected wear.
    """
    count = len(shares)
    common = np.array([share.common_u_um for share in shares])
    prior = np.zeros((count + 1, count + 1))
    prior[:count, :count] = np.outer(common, common) + np.diag([share.own_u_um**2 for share in shares])
    prior[count, count] = drift_u_um_per_s**2
    seen = np.append(np.ones(count), after_s)
    error_um = found_um - math.fsum(share.wear_um for share in shares)
    expected = float(seen @ prior @ seen)
    allowed_um = CONTRADICTION_SDS * math.hypot(math.sqrt(expected), touch_u_um)
    widening = max(1.0, (error_um / allowed_um) ** 2)
    prior *= widening
    own = widening * math.fsum(share.own_u_um**2 for share in shares)
    unexplained = max(0.0, error_um**2 - own - prior[count, count] * after_s**2 - touch_u_um**2)
    squares = np.array([max(share.wear_um, LEAST_WEAR_UM) ** 2 for share in shares])
    alone = 0.25 * unexplained * min(count, MOST_ALONE) * squares / squares.sum()
    prior[np.diag_indices(count)] += np.minimum(alone, squares)
    gain = prior @ seen / (float(seen @ prior @ seen) + touch_u_um**2)
    mean, covariance = gain * error_um, prior - np.outer(gain, seen @ prior)

    def sd(way: Array) -> float:
        return math.sqrt(max(0.0, float(way @ covariance @ way)))

    found = []
    for i, (share, own_way) in enumerate(zip(shares, np.eye(count + 1), strict=False)):
        tip = np.concatenate([np.ones(i + 1), np.zeros(count - i - 1), [share.after_s]])
        wear_um, tip_um = share.wear_um + float(mean[i]), float(tip @ mean)
        found.append(SharedWear(wear_um, sd(own_way), tip_um, sd(tip), sd(tip - own_way)))
    return tuple(found)
