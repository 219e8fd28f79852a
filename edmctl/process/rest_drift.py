"""Sensor drift and actuator creep, from readings at a zero-voltage hold ("rest") and from touches of the pad.

A rest changes by the drift of the sensor and by creep; a touch changes by the drift of the sensor and by that
between tool and workpiece. Creep is a sum of first-order lags of the displacement with similar weights in every
decade of time (Jung and Gweon 2000; Kuhnen 2003).

A Gaussian regression of one run of rests and touches with a hold at depth gives the weights of creep, the drifts of
rests and touches, and the share of the first that touches see. A later job subtracts the creep of its own
displacement from its rests; the remaining change is drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.process.touches import Drift, Touch, TouchScatter, share_u
from edmctl.quantity import Value
from edmctl.start_up import one_blas_thread

TIME_CONSTANTS_S = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
"""Two a decade: a sum of such lags follows a logarithm of time within 1 % of it."""
_TAU_S = np.array(TIME_CONSTANTS_S)
_PER_DECADE = 0.5
CREEP_PRIOR_PER_DECADE = 0.05
"""Standard deviation of the creep in a decade of time, relative, before it was measured: 1 to 10 % is known of
piezo actuators."""
SCATTER_PRIOR_PER_DECADE = 0.006
"""By so much more or less than in the mean of all decades the weight in any one of them is expected to be."""
DRIFT_PRIOR_UM_PER_S = 0.1  # standard deviation of either drift before it was measured: as good as unknown
ZERO_PRIOR_UM = 30.0
LEAST_NOISE_UM = 1e-3  # the last digit of a sensor
MISFIT = 0.01  # standard deviation of creep that is no sum of these lags, over the creep that is
DRIFT_MISFIT = 0.1
"""Share of a drift that is taken for creep: lags of a displacement that drifts hold that drift, and only a steady
one is taken out of them again. On the virtual machine 3 to 13 % were seen."""
MEMORY_UM = 150.0  # way whose creep an earlier use of the actuator may have left, µm
MOST_LAG_UM = 1000.0
LEAST_SIGMAS = 3.0  # rests that have drifted by less than so many standard uncertainties tell no ratio
LEAST_TOUCHES = 5
PASSES = 2
REST_TO_TOUCH_S = 20.0  # from a rest to the touch that it stands for
OUTLIER_SIGMAS = 5.0
RESTS_S = (10.0, 20.0, 40.0, 80.0, 160.0)
"""What a rest before a touch may take: creep of a deep cut fades, and with it what is unknown of it."""
REST_SHARE = 0.05  # of the time since the first touch it takes at most
LEAST_GAIN = 0.05  # a rest that leaves so little less unknown does not pay
MOST_CREEP_PER_CONSTANT = 0.15
"""Of any one time constant: three times what piezo actuators creep in a decade of time."""
LEAST_CREEP = -0.05  # of all time constants together, and of each: noise may make it less than none
LEAST_CREEP_U = 1e-6  # of each: less than a sensor's last digit after a full stroke is not known of it
_GATHERED = 20  # blocks of samples that are followed together
REST_V = 0.5  # an actuator at less is at rest


@dataclass(frozen=True, slots=True, eq=False)
class CreepLeft:
    """Residual creep of earlier use: lags as in `CreepLags`; use before `unknown_s` ago was not followed."""

    um: Array
    unknown_s: float

    @classmethod
    def none(cls, unknown_s: float = math.inf) -> CreepLeft:
        """Return that of an actuator that was not used for so long."""
        return cls(np.zeros(len(TIME_CONSTANTS_S)), unknown_s)

    @classmethod
    def of(cls, lags_um: Sequence[float], unknown_s: float) -> CreepLeft:
        """Return it from stored values. Raises ValueError or TypeError for impossible ones."""
        um = np.array(lags_um, dtype=np.float64)
        possible = um.shape == (len(TIME_CONSTANTS_S),) and (np.abs(um) <= MOST_LAG_UM).all()
        if not (possible and unknown_s >= 0.0):
            raise ValueError("no creep of an actuator")
        return cls(um, unknown_s)

    def after(self, seconds: float) -> CreepLeft:
        """Return what is left of it after a rest at 0 V."""
        return CreepLeft(self.um * np.exp(-seconds / _TAU_S), self.unknown_s + seconds)


class CreepLags:
    """First-order lags of the displacement over home (`um`), by `TIME_CONSTANTS_S`, from earlier use on.

    The displacement includes the sensor's drift; `out_s` are the same lags of 1 µm/s while the tool is extended.
    """

    def __init__(self, left: CreepLeft | None = None) -> None:
        self._before = CreepLeft.none() if left is None else left
        self._um: Array = self._before.um.copy()
        self._out_s: Array = np.zeros(len(TIME_CONSTANTS_S))
        self._fresh: list[tuple[Array, Array, Array]] = []
        self._home_um = math.nan
        self._begin_s = self._time_s = math.nan

    def advance(self, time_s: Array, displacement_um: Array, actuator_v: Array) -> None:
        """Add consecutive samples, shape (n,) each, n > 0; the first one of all is home.

        A displacement counts from the sample before it until its own. At 0 V it is home by definition.
        """
        if math.isnan(self._time_s):
            self._home_um, self._begin_s = float(displacement_um[0]), float(time_s[0])
            self._time_s = self._begin_s
        self._fresh.append((time_s, displacement_um, actuator_v))
        if len(self._fresh) >= _GATHERED:
            self._follow()

    def _follow(self) -> None:
        if not self._fresh:
            return
        time_s, displacement_um, actuator_v = map(np.concatenate, zip(*self._fresh, strict=True))
        self._fresh.clear()
        end_s = float(time_s[-1])
        edges_s = np.concatenate(([self._time_s], time_s))
        kept = np.exp((edges_s[:, None] - end_s) / _TAU_S)
        is_out, gains = actuator_v > REST_V, np.diff(kept, axis=0)
        self._um = self._um * kept[0] + np.where(is_out, displacement_um - self._home_um, 0.0) @ gains
        self._out_s = self._out_s * kept[0] + np.where(is_out, time_s - self._begin_s, 0.0) @ gains
        self._time_s = end_s

    @property
    def um(self) -> Array:
        """Lags of the displacement, µm."""
        self._follow()
        return self._um

    @property
    def out_s(self) -> Array:
        """Lags of the time out, s."""
        self._follow()
        return self._out_s

    @property
    def left(self) -> CreepLeft:
        """Residual creep for the next use of the actuator."""
        self._follow()
        passed_s = 0.0 if math.isnan(self._time_s) else self._time_s - self._begin_s
        return CreepLeft(self.um.copy(), self._before.unknown_s + passed_s)


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """Sensor reading at 0 V, its standard uncertainty by the scatter of its samples, and the lags at that time."""

    time_s: float
    um: float
    u_um: float
    lags_um: Array
    lags_out_s: Array


def mean_rest(rests: Sequence[Rest | None], shares: Sequence[float]) -> Rest | None:
    """Return the weighted mean of rests; None if one of them is unknown. The shares add up to 1."""
    known = [(one.time_s, one.um, one.u_um, one.lags_um, one.lags_out_s) for one in rests if one is not None]
    if len(known) < len(rests):
        return None
    weights = np.array(shares)
    times_s, um, u_um, lags_um, lags_out_s = map(np.array, zip(*known, strict=True))
    means = float(weights @ times_s), float(weights @ um), math.hypot(*(weights * u_um))
    return Rest(*means, weights @ lags_um, weights @ lags_out_s)


@dataclass(frozen=True, slots=True, eq=False)
class DriftFit:
    """Drifts and creep by rests and touches.

    creep, creep_covariance : weights of the lags
    rest_um_per_s, touch_um_per_s : steady drifts without creep; uncertainties include the random walk of the sensor
    apart_um_per_s : drift of the touches less that of the rests: between tool and workpiece, or unseen by touches
    share : ratio of the drifts; None if the rests drift too little to determine it
    is_steady : the rests drift by more than their random walk of `walk_um_per_sqrt_s` explains
    misfit : factor by which residuals exceed the expected ones, at least 1; uncertainties include it
    outliers : number of touches left out
    """

    creep: Array
    creep_covariance: Array
    rest_um_per_s: Value
    touch_um_per_s: Value
    apart_um_per_s: Value
    share: Value | None
    is_steady: bool
    walk_um_per_sqrt_s: float
    misfit: float
    rest_rms_um: float
    touch_rms_um: float
    outliers: int


@one_blas_thread()
def fit_drift(
    rests: Sequence[Rest],
    touches: Sequence[Touch],
    walk_um_per_sqrt_s: float,
    memory_s: float = math.inf,
) -> DriftFit:
    """Regress rests and touches of the pad on time and creep.

    walk_um_per_sqrt_s : random walk of the sensor's zero besides its steady drift
    memory_s : time between earlier use of the actuator and the first of them; infinity: none

    Raises ValueError with fewer than `LEAST_TOUCHES` touches.
    """
    kept, outliers = list(touches), 0
    while True:
        if len(kept) < LEAST_TOUCHES:
            raise ValueError(f"{len(kept)} touches tell no drift; it takes {LEAST_TOUCHES}")
        fit = None
        for _ in range(PASSES):
            fit, off_sds = _fitted(rests, kept, walk_um_per_sqrt_s, memory_s, outliers, fit)
        assert fit is not None
        worst = int(np.argmax(np.abs(off_sds)))
        # A chip under the tool makes one touch too short; more than one in five is something else.
        if abs(off_sds[worst]) <= OUTLIER_SIGMAS or outliers >= len(touches) // 5:
            return fit
        del kept[worst]
        outliers += 1


def _fitted(
    rests: Sequence[Rest],
    touches: Sequence[Touch],
    walk_um_per_sqrt_s: float,
    memory_s: float,
    outliers: int,
    before: DriftFit | None,
) -> tuple[DriftFit, Array]:
    """Return the fit, and the distance of each touch from the line of the others in standard deviations.

    The lags include the drift itself, by the creep of the fit `before`.
    """
    n, a, b = len(TIME_CONSTANTS_S), len(rests), len(touches)
    times_s = np.array([*(rest.time_s for rest in rests), *(touch.time_s for touch in touches)])
    times_s -= rests[0].time_s
    design = _design(rests, times_s, None if before is None else before.creep)
    y_um = np.concatenate(([rest.um for rest in rests], [touch.reading.mean_um for touch in touches]))
    offset_um = np.concatenate((np.full(a, y_um[0]), np.full(b, y_um[a])))
    prior = _prior()
    walk = walk_um_per_sqrt_s**2 * np.minimum.outer(times_s, times_s)
    readings, sd_um = _noise(rests, touches, times_s[:a], memory_s)
    noise = walk + readings
    # Also estimated is the slope of the walk over the run, which rests and touches have in common.
    centred_s = times_s - times_s.mean()
    slope = centred_s / (centred_s @ centred_s)
    known = np.vstack((prior @ design.T, slope @ walk))
    total = design @ prior @ design.T + noise
    off_um = y_um - offset_um
    found = known @ np.linalg.solve(total, off_um)
    left_um = off_um - design @ found[:-1]
    misfit = math.sqrt(max(1.0, float(off_um @ np.linalg.solve(total, off_um)) / (a + b)))
    prior_of_all = np.zeros((5 + n, 5 + n))
    prior_of_all[:-1, :-1], prior_of_all[-1, -1] = prior, slope @ walk @ slope
    covariance = misfit**2 * (prior_of_all - known @ np.linalg.solve(total, known.T))
    covariance = 0.5 * (covariance + covariance.T)
    drifts = np.zeros((3, 5 + n))
    drifts[0, [2, 4 + n]], drifts[1, [3, 4 + n]] = 1.0, 1.0
    drifts[2, 2], drifts[2, 3] = -1.0, 1.0
    rest, touch, apart = (float(value) for value in drifts @ found)
    spread = drifts @ covariance @ drifts.T
    rest_u, touch_u, apart_u = (math.sqrt(max(0.0, float(spread[i, i]))) for i in range(3))
    walk_u = math.sqrt(prior_of_all[-1, -1])
    fit = DriftFit(
        creep=found[4:-1],
        creep_covariance=covariance[4:-1, 4:-1],
        rest_um_per_s=Value(rest, math.hypot(rest_u, walk_u)),
        touch_um_per_s=Value(touch, math.hypot(touch_u, walk_u)),
        apart_um_per_s=Value(apart, apart_u),
        share=_share(rest, touch, spread, walk_u),
        is_steady=abs(rest) >= LEAST_SIGMAS * math.hypot(rest_u, walk_u),
        walk_um_per_sqrt_s=walk_um_per_sqrt_s,
        misfit=misfit,
        rest_rms_um=float(np.sqrt(np.mean(left_um[:a] ** 2))),
        touch_rms_um=float(np.sqrt(np.mean(left_um[a:] ** 2))),
        outliers=outliers,
    )
    return fit, (left_um[a:] - np.median(left_um[a:])) / np.hypot(
        sd_um[a:], walk_um_per_sqrt_s * math.sqrt(times_s.max())
    )


def _prior() -> Array:
    n = len(TIME_CONSTANTS_S)
    scatter = SCATTER_PRIOR_PER_DECADE**2 * np.eye(n)
    prior = np.zeros((4 + n, 4 + n))
    prior[[0, 1], [0, 1]] = ZERO_PRIOR_UM**2
    prior[[2, 3], [2, 3]] = DRIFT_PRIOR_UM_PER_S**2
    prior[4:, 4:] = _PER_DECADE**2 * (CREEP_PRIOR_PER_DECADE**2 * np.ones((n, n)) + scatter)
    return prior


def _design(rests: Sequence[Rest], times_s: Array, creep: Array | None) -> Array:
    """Return the columns: zeros of rests and touches, their drifts, and the lags, less the drift in known creep."""
    a = len(rests)
    design = np.zeros((len(times_s), 4 + len(TIME_CONSTANTS_S)))
    design[:a, 0], design[:a, 2] = 1.0, times_s[:a]
    design[:a, 4:] = [rest.lags_um for rest in rests]
    if creep is not None:
        design[:a, 2] -= np.array([rest.lags_out_s for rest in rests]) @ creep
    design[a:, 1], design[a:, 3] = 1.0, times_s[a:]
    return design


def _noise(
    rests: Sequence[Rest], touches: Sequence[Touch], rest_times_s: Array, memory_s: float
) -> tuple[Array, Array]:
    """Return the covariance of all readings without the walk of the sensor, and their standard deviations alone."""
    usual = np.full(len(TIME_CONSTANTS_S), _PER_DECADE * 0.5 * CREEP_PRIOR_PER_DECADE)
    rest_u_um = max(LEAST_NOISE_UM, math.sqrt(math.fsum(rest.u_um**2 for rest in rests) / len(rests)))
    lags_um = np.abs(np.array([rest.lags_um for rest in rests]))
    scatter = TouchScatter()
    for touch in touches:
        scatter.add(touch.reading)
    touch_u_um = max(LEAST_NOISE_UM, scatter.u_um)
    touch_sd_um = [touch_u_um / math.sqrt(touch.reading.touches) for touch in touches]
    sd_um = np.concatenate((np.hypot(rest_u_um, MISFIT * (lags_um @ usual)), touch_sd_um))
    covariance = np.diag(sd_um**2)
    if math.isfinite(memory_s):
        left = usual * MEMORY_UM * np.exp(-(memory_s + rest_times_s[:, None]) / _TAU_S)
        covariance[: len(rests), : len(rests)] += left @ left.T
    return covariance, sd_um


def _share(rest: float, touch: float, spread: Array, walk_u: float) -> Value | None:
    """Return the ratio of the drifts with covariance `spread`; None if it is known no better than unmeasured."""
    rest_u, touch_u = (math.sqrt(max(0.0, float(spread[i, i]))) for i in range(2))
    if abs(rest) < LEAST_SIGMAS * rest_u:
        return None
    ratio = touch / rest
    variance = touch_u**2 - 2.0 * ratio * float(spread[0, 1]) + ratio**2 * rest_u**2
    # The walk is in both drifts alike, and draws the ratio of the steady ones towards 1.
    variance += (ratio - 1.0) ** 2 * walk_u**2
    ratio_u = math.sqrt(max(0.0, variance)) / abs(rest)
    return Value(ratio, ratio_u) if ratio_u <= share_u(1.0) else None


@dataclass(frozen=True, slots=True, eq=False)
class DriftModel:
    """Basis of the drift correction of later jobs.

    share, share_u : share of the rests' drift that a touch sees, 0 to 1, and its standard uncertainty
    apart_u_um_per_s : standard uncertainty of a drift that touches see and rests do not
    walk_um_per_sqrt_s : random walk of the sensor's zero
    """

    creep: Array
    creep_covariance: Array
    share: float
    share_u: float
    apart_u_um_per_s: float
    walk_um_per_sqrt_s: float

    def between(self, first: Rest, last: Rest, seconds: float, memory_s: float = math.inf) -> Drift:
        """Return the drift of a touch from one rest to another, with touches `seconds` apart."""
        moved = self.rest_moved(first, last, memory_s)
        left_u_um = math.hypot(
            self.share * moved.left_u_um,
            self.share_u * math.hypot(moved.um, moved.left_u_um),
            self.apart_u_um_per_s * seconds,
            self.walk_um_per_sqrt_s * math.sqrt(2.0 * REST_TO_TOUCH_S),
        )
        return Drift(self.share * moved.um, left_u_um)

    def rest_that_pays_s(
        self,
        first: Rest,
        last: Rest,
        seconds: float,
        memory_s: float = math.inf,
        drift_u_um_per_s: float = 0.0,
    ) -> float:
        """Return the best additional rest before a touch that is compared with one `seconds` ago; 0 if none pays.

        It minimises the uncertainty of the drift between the two, which enters the wear, together with that since
        the bottom was touched (`drift_u_um_per_s`), which enters the depth.
        """

        def left_u_um(more_s: float) -> float:
            kept = np.exp(-more_s / _TAU_S)
            um = last.um - float(self.creep @ (last.lags_um * (1.0 - kept)))
            later = Rest(last.time_s + more_s, um, last.u_um, last.lags_um * kept, last.lags_out_s * kept)
            drift = self.between(first, later, seconds + more_s, memory_s)
            return math.hypot(drift.left_u_um, drift_u_um_per_s * more_s)

        best_s = min((s for s in RESTS_S if s <= REST_SHARE * seconds), key=left_u_um, default=0.0)
        return best_s if left_u_um(best_s) <= (1.0 - LEAST_GAIN) * left_u_um(0.0) else 0.0

    def rest_moved(self, first: Rest, last: Rest, memory_s: float = math.inf) -> Drift:
        """Return the drift of a rest without creep; `memory_s` as in `fit_drift`, before the lags started."""
        if last.time_s == first.time_s:
            return Drift(0.0, 0.0)
        lags_um = last.lags_um - first.lags_um
        crept_um = float(self.creep @ lags_um)
        # The drift is in the lags as well, as much as that of a steady one would be.
        in_lags_s = float(self.creep @ (last.lags_out_s - first.lags_out_s))
        moved_um = (last.um - first.um - crept_um) / (1.0 - in_lags_s / (last.time_s - first.time_s))
        left = np.exp(-(memory_s + first.time_s) / _TAU_S) - np.exp(-(memory_s + last.time_s) / _TAU_S)
        moved_u_um = math.hypot(
            first.u_um,
            last.u_um,
            math.sqrt(max(0.0, float(lags_um @ self.creep_covariance @ lags_um))),
            MISFIT * crept_um,
            DRIFT_MISFIT * moved_um,
            MEMORY_UM * float(np.abs(self.creep) @ left) if math.isfinite(memory_s) else 0.0,
        )
        return Drift(moved_um, moved_u_um)


def refuse_creep(creep: Array, covariance: Array) -> None:
    """Raise ValueError for creep that no actuator has, or an impossible covariance."""
    if creep.max() > MOST_CREEP_PER_CONSTANT or creep.min() < LEAST_CREEP:
        raise ValueError(f"a creep of {creep[np.abs(creep).argmax()]:.2g} is none that an actuator has")
    if creep.sum() < LEAST_CREEP:
        raise ValueError(f"a creep of {creep.sum():.2g} in all is none that an actuator has")
    scale = float(np.abs(covariance).max())
    if not scale <= MOST_CREEP_PER_CONSTANT**2:
        raise ValueError(f"a creep that is known to {math.sqrt(scale):.2g} is not known")
    asymmetric = not np.allclose(covariance, covariance.T, rtol=0.0, atol=1e-9 * scale)
    if asymmetric or float(np.linalg.eigvalsh(covariance)[0]) < -1e-6 * scale:
        raise ValueError("its covariance is none")
    if np.diag(covariance).min() < LEAST_CREEP_U**2:
        raise ValueError("its creep is known better than a sensor can tell")


def model_of(fit: DriftFit) -> DriftModel:
    """Return the drift model of a fit.

    A share outside of 0 to 1 is impossible: the excess is a drift between tool and workpiece, which may differ in a
    later job. A share below 1 may have the same cause, and one run cannot distinguish them, so the whole difference
    of the drifts is the standard uncertainty of such a drift. An unknown share is taken as 1, between 0 and 1.
    """
    apart = fit.apart_um_per_s
    apart_u_um_per_s = math.hypot(apart.value, apart.u)
    if fit.share is None:
        share, u = 1.0, share_u(1.0)
    else:
        share, u = min(1.0, max(0.0, fit.share.value)), fit.share.u
    return DriftModel(fit.creep, fit.creep_covariance, share, u, apart_u_um_per_s, fit.walk_um_per_sqrt_s)
