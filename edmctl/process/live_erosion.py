"""Depth and wear between two touches, from feed and discharge energy.

The displacement gives the feed below a known bottom, `depth + wear`, to within the working gap. The wear ratio
divides it, and the energy of the discharges gives the depth by the volume removed per energy. The logarithms of
ratio and volume per energy have a joint normal distribution, which a cut updates by one Kalman step (feed) and a
touch by two (depth and wear). Depth by energy follows the outlook of Muralidhara et al. 2009, §5.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from copy import copy

from edmctl.dataclasses import dataclass, replace
from edmctl.process.erosion import ARC_V, GAP_LAW

ARC_REMOVAL = GAP_LAW.arc_work * ARC_V / 22.0
"""An arc removes this share of the work that a normal discharge of its energy does."""
ARC_WEAR = GAP_LAW.arc_tool / GAP_LAW.arc_work
"""And removes this many times as much of the tool in proportion."""
USUAL_ARCS = 0.04
"""Energy of arcs over that of normal discharges in a clean gap (1.5 % of the pulses): what a recipe's wear ratio
holds, until a hole has shown its own."""
SCATTER_BETWEEN_HOLES = 0.01  # standard deviation of the wear ratio's logarithm from hole to hole [assumed]
CHANGE_WITH_DEPTH = 0.03
"""Standard uncertainty of the ratio's logarithm where a hole is e times as deep as the one that told it [assumed]:
debris and arcs change with depth."""
REMOVAL_SCATTER = 0.03
"""The same of the volume per energy: more discharges burn at the wall the deeper the hole [assumed]."""
LEAST_U_REL = 0.005  # nothing is ever known better than this, however often it was measured
LEAST_RATIO = 1e-4  # a tool that does not wear at all has no logarithm
LEAST_BELIEVED = 0.02
"""Least prior ratio at a touch, because the uncertainty is relative."""
RECIPE_U_REL = 0.5
"""Of a ratio that no touch has confirmed: ×0.4 to ×2.7 (2 sd), whatever the recipe states. Touches cannot contradict
the ratio of a tool whose wear is as small as their error."""
WIDENING_SDS = 2.0
"""A touch further off than this widens the prior by the excess."""
_SHARES = tuple(i / 1000 for i in range(1001))
_NOTHING = 1e-12
CONTRADICTION_SDS = 3.0  # beyond this the belief is contradicted: one in 370 by chance


@dataclass(slots=True)
class Energy:
    """Energy of discharges by class, µJ."""

    normal_uj: float
    arc_uj: float

    def plus(self, other: Energy) -> Energy:
        """Both together."""
        return Energy(self.normal_uj + other.normal_uj, self.arc_uj + other.arc_uj)


@dataclass(slots=True)
class LiveErosion:
    """Estimated depth and wear since the last touch, µm, with standard uncertainties.

    That of the wear has a part from the wear ratio, common to the holes of one job, and one of its own.
    """

    depth_um: float
    depth_u_um: float
    wear_um: float
    wear_ratio_u_um: float
    wear_own_u_um: float

    @property
    def wear_u_um(self) -> float:
        """Standard uncertainty of the wear."""
        return math.hypot(self.wear_ratio_u_um, self.wear_own_u_um)


@dataclass(slots=True)
class _Known:
    """Joint normal distribution of two logarithms: volume per energy, wear per depth."""

    removal: float
    ratio: float
    var_removal: float
    var_ratio: float
    covariance: float

    def lengths_um(self, depth_log: float, arc_log: float) -> tuple[float, float]:
        """Depth and wear, from the logarithms of depth per removal and of the arcs' surplus of wear."""
        depth_um = math.exp(self.removal + depth_log)
        return depth_um, depth_um * math.exp(self.ratio + arc_log)

    def sds(self, error_um: float, per_removal: float, per_ratio: float, noise_u_um: float) -> float:
        """Return the distance of a length from its expectation in standard deviations."""
        variance = (
            self.var_removal * per_removal**2
            + 2.0 * self.covariance * per_removal * per_ratio
            + self.var_ratio * per_ratio**2
        )
        return abs(error_um) / math.sqrt(variance + noise_u_um**2)

    def widened(self, sds: float, *, removal: bool, ratio: bool) -> _Known:
        """Return the same, less certain in one or both after a contradiction of `sds`."""
        factor = max(1.0, sds / WIDENING_SDS)
        of_removal, of_ratio = factor if removal else 1.0, factor if ratio else 1.0
        return replace(
            self,
            var_removal=self.var_removal * of_removal**2,
            var_ratio=self.var_ratio * of_ratio**2,
            covariance=self.covariance * of_removal * of_ratio,
        )

    def seen(self, error_um: float, per_removal: float, per_ratio: float, noise_u_um: float) -> _Known:
        """One Kalman step: a length was `error_um` more than expected, and has these two derivatives."""
        with_removal = self.var_removal * per_removal + self.covariance * per_ratio
        with_ratio = self.covariance * per_removal + self.var_ratio * per_ratio
        variance = per_removal * with_removal + per_ratio * with_ratio + noise_u_um**2
        gain_removal, gain_ratio = with_removal / variance, with_ratio / variance
        return _Known(
            self.removal + gain_removal * error_um,
            self.ratio + gain_ratio * error_um,
            self.var_removal - gain_removal * with_removal,
            self.var_ratio - gain_ratio * with_ratio,
            self.covariance - gain_removal * with_ratio,
        )


class ErosionEstimate:
    """Estimate of removal and wear in one job, from its recipe and every touch so far.

    removal_um3_per_uj, removal_u_rel : volume of work per energy of normal discharges, and its relative uncertainty
    wear_ratio, ratio_u_rel : wear length per depth, likewise
    contradicted : the last touch was far from the expected wear ratio
    """

    def __init__(
        self,
        removal_um3_per_uj: float,
        removal_u_rel: float,
        wear_ratio: float,
        ratio_u_rel: float,
        hole_area_um2: float,
    ) -> None:
        self._arcs = USUAL_ARCS
        ratio = math.log(max(wear_ratio, LEAST_RATIO) / _arc_factor(USUAL_ARCS))
        self._known = _Known(math.log(removal_um3_per_uj), ratio, removal_u_rel**2, ratio_u_rel**2, 0.0)
        self._hole_area_um2 = hole_area_um2
        self.fits = 0  # touches that it has learned from
        self._learned_um = math.nan
        self._depth_u_rel = 0.0
        self.contradicted = False

    @property
    def wear_ratio(self) -> float:
        """Wear length per depth, with as many arcs as in the last hole that was measured."""
        return math.exp(self._known.ratio) * _arc_factor(self._arcs)

    @property
    def wear_ratio_u_rel(self) -> float:
        """Relative standard uncertainty of that."""
        return math.sqrt(self._known.var_ratio)

    @property
    def removal_um3_per_uj(self) -> float:
        """Work volume per energy of normal discharges, without what burns at the wall."""
        return math.exp(self._known.removal)

    def confirmed(self) -> ErosionEstimate:
        """Return the same after another touch has agreed with it."""
        other = copy(self)
        other.contradicted = False
        return other

    def next_hole(self, depth_um: float) -> ErosionEstimate:
        """Return the estimate for another hole of this depth, which erodes a little differently."""
        known, other = self._known, copy(self)
        other._known = replace(
            known,
            var_removal=known.var_removal + REMOVAL_SCATTER**2,
            var_ratio=known.var_ratio + SCATTER_BETWEEN_HOLES**2,
        )
        if depth_um > 0.0 and self._learned_um > 0.0:
            other._depth_u_rel = CHANGE_WITH_DEPTH * abs(math.log(depth_um / self._learned_um))
        return other

    def split(self, feed_um: float, feed_u_um: float, energy: Energy | None = None) -> LiveErosion:
        """Divide a feed into depth and wear, by energy and ratio; without energy by the ratio alone."""
        feed_um = max(0.0, feed_um)
        known = self._known
        if energy is None or energy.normal_uj <= 0.0:
            arc_log = math.log(_arc_factor(self._arcs))
        else:
            depth_log, arc_log = self._logs(energy)
            if feed_um > 0.0:
                step = self._feed_step(feed_um, feed_u_um, depth_log, arc_log)
                if known.sds(*step) <= CONTRADICTION_SDS:
                    known = known.seen(*step)
        ratio = math.exp(known.ratio + arc_log)
        share = 1.0 / (1.0 + ratio)
        per_ratio_um = feed_um * ratio * share**2
        split_u_um, by_depth_um = per_ratio_um * math.sqrt(known.var_ratio), per_ratio_um * self._depth_u_rel
        return LiveErosion(
            depth_um=feed_um * share,
            depth_u_um=math.hypot(split_u_um, by_depth_um, share * feed_u_um),
            wear_um=feed_um * ratio * share,
            wear_ratio_u_um=split_u_um,
            wear_own_u_um=math.hypot(by_depth_um, ratio * share * feed_u_um),
        )

    def contradicts(self, feed_um: float, feed_u_um: float, energy: Energy) -> bool:
        """Whether feed and energy contradict each other; then `split` uses the feed alone."""
        return self._sds_of_feed(feed_um, feed_u_um, energy) > CONTRADICTION_SDS

    def off_by_energy_um(self, feed_um: float, feed_u_um: float, energy: Energy) -> float:
        """Wear by feed and energy less that by the ratio; 0 where chance may make them so different."""
        if self._sds_of_feed(feed_um, feed_u_um, energy) <= WIDENING_SDS:
            return 0.0
        depth_um, wear_um = self._known.lengths_um(*self._logs(energy))
        return feed_um - depth_um - feed_um * wear_um / (depth_um + wear_um)

    def _sds_of_feed(self, feed_um: float, feed_u_um: float, energy: Energy) -> float:
        if feed_um <= 0.0 or energy.normal_uj <= 0.0:
            return 0.0
        return self._known.sds(*self._feed_step(feed_um, feed_u_um, *self._logs(energy)))

    def _feed_step(
        self, feed_um: float, feed_u_um: float, depth_log: float, arc_log: float
    ) -> tuple[float, float, float, float]:
        """Error of a feed against the energy of these logarithms, its derivatives, and its noise.

        Lengths are exponentials of the unknowns, so one step starts where the feed already fits.
        """
        depth_um, wear_um = self._known.lengths_um(depth_log, arc_log)
        expected_um = depth_um + wear_um
        error_um = expected_um * math.log(feed_um / expected_um)
        return error_um, expected_um, wear_um, feed_u_um * expected_um / feed_um

    def fitted(
        self, energy: Energy | None, depth_um: float, depth_u_um: float, wear_um: float, wear_u_um: float
    ) -> ErosionEstimate:
        """Return the estimate after a hole was measured; without its energy only the ratio changes."""
        if depth_um <= 0.0 or (energy is not None and energy.normal_uj <= 0.0):
            return self
        known, arcs = self._known, self._arcs
        arc_log = math.log(_arc_factor(arcs))
        if energy is not None:
            depth_log, arc_log = self._logs(energy)
            arcs = energy.arc_uj / energy.normal_uj
            expected_um, _ = known.lengths_um(depth_log, arc_log)
            error_um = expected_um * math.log(depth_um / expected_um)
            step = error_um, expected_um, 0.0, depth_u_um * expected_um / depth_um
            known = known.widened(known.sds(*step), removal=True, ratio=False).seen(*step)
        # The ratio is of two touched lengths, so the energy cannot pull it to where removal was believed to be.
        sds = _sds_of_wear(known, depth_um * math.exp(known.ratio + arc_log), wear_um, wear_u_um)
        if self.fits == 0:
            ratio = max(known.ratio, math.log(LEAST_BELIEVED))
            known = replace(known, ratio=ratio, var_ratio=max(known.var_ratio, RECIPE_U_REL**2))
        expected_um = depth_um * math.exp(known.ratio + arc_log)
        known = known.widened(_sds_of_wear(known, expected_um, wear_um, wear_u_um), removal=False, ratio=True)
        known = known.seen(*_wear_step(known, expected_um, wear_um, wear_u_um))
        learned = copy(self)
        learned._known = replace(
            known,
            ratio=max(known.ratio, math.log(LEAST_RATIO)),
            var_removal=max(known.var_removal, LEAST_U_REL**2),
            var_ratio=max(known.var_ratio, LEAST_U_REL**2),
        )
        learned.fits, learned._arcs, learned.contradicted = self.fits + 1, arcs, sds > CONTRADICTION_SDS
        learned._learned_um, learned._depth_u_rel = depth_um, 0.0
        return learned

    def _logs(self, energy: Energy) -> tuple[float, float]:
        arcs = energy.arc_uj / energy.normal_uj
        worked_uj = energy.normal_uj * (1.0 + ARC_REMOVAL * arcs)
        return math.log(worked_uj / self._hole_area_um2), math.log(_arc_factor(arcs))


def _sds_of_wear(known: _Known, expected_um: float, wear_um: float, u_um: float) -> float:
    """Return the distance of a measured wear from its expectation in standard deviations.

    It is that of the logarithms, unless the wear is uncertain and long, such as after hours of drift.
    """
    by_length = known.sds(wear_um - expected_um, 0.0, expected_um, u_um)
    if wear_um <= u_um:
        return by_length
    by_logarithm = known.sds(wear_um * math.log(wear_um / expected_um), 0.0, wear_um, u_um)
    return min(by_length, by_logarithm) if wear_um > expected_um else by_logarithm


def _wear_step(
    known: _Known, expected_um: float, wear_um: float, u_um: float
) -> tuple[float, float, float, float]:
    """Return error, derivatives and noise of a measured wear about the likeliest wear (iterated Kalman step)."""
    way, steps = math.log(max(wear_um, LEAST_RATIO * expected_um) / expected_um), range(len(_SHARES))

    def cost(step: int) -> float:
        tried = _SHARES[step] * way
        return tried * tried / known.var_ratio + ((wear_um - expected_um * math.exp(tried)) / u_um) ** 2

    if abs(way) < _NOTHING:
        step = 0
    elif 2.0 * expected_um >= wear_um:  # one minimum: where the cost begins to rise
        step = bisect_left(steps[:-1], True, key=lambda step: cost(step) <= cost(step + 1))
    else:
        step = min(steps, key=cost)
    log = _SHARES[step] * way
    likeliest_um = expected_um * math.exp(log)
    return wear_um - likeliest_um + likeliest_um * log, 0.0, likeliest_um, u_um


def _arc_factor(arcs: float) -> float:
    """How much arcs raise the wear ratio, from their energy over that of normal discharges."""
    removal = ARC_REMOVAL * arcs
    return (1.0 + ARC_WEAR * removal) / (1.0 + removal)
