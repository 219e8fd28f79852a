"""What one touch of the reference says about several holes: how the wear since the touch before divides among them.

Each hole is expected to have worn the tool by a share, known badly in the same direction for all (the wear ratio)
and a little for itself. The tool's length and the drift of the sensor since the touch before make up the one length
that was touched. All of them are jointly normal, so the touch conditions them at once, and the errors that remain
stay correlated: a tool that was shorter than expected left every later hole shallower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass

CONTRADICTION_SDS = 2.0
"""A touch further from the expectation than this makes the expectation as uncertain as it was wrong."""

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

    `shares` are the expectations, in order of time; the touch was `found_um` further than the one before it and
    `after_s` later. `touch_u_um` is the standard uncertainty of the difference of both touches, drift apart, and
    `drift_u_um_per_s` that of a steady drift of what measures.

    The wears and the rate of drift are normal with zero mean about their expectation. Where the touch lies beyond
    `CONTRADICTION_SDS` of what it was expected to be, their covariance is widened to that ratio before. And what
    touches, drift and single holes do not explain may be of all holes, of the last ones or of one: a tool may wear
    otherwise at any time. So half of it is added to what each hole does for itself: of `MOST_ALONE` holes at most,
    among more it is less, and never more than the wear that is expected.
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
    found = []
    for i, share in enumerate(shares):
        tip = np.concatenate([np.ones(i + 1), np.zeros(count - i - 1), [share.after_s]])
        without = tip - np.eye(count + 1)[i]
        found.append(
            SharedWear(
                wear_um=share.wear_um + float(mean[i]),
                wear_u_um=_sd(covariance[i, i]),
                tip_um=float(tip @ mean),
                tip_u_um=_sd(tip @ covariance @ tip),
                feed_u_um=_sd(without @ covariance @ without),
            )
        )
    return tuple(found)


def _sd(variance: float | Array) -> float:
    return math.sqrt(max(0.0, float(variance)))
