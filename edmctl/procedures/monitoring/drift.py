"""Drift of the zero of the displacement: as the setup states it, and as the rests at 0 V have shown it.

A rest does not distinguish drift from creep of the actuator, and does not show a drift between tool and workpiece.
So an observed drift only widens the uncertainty, and no reading is corrected by it here; `touch/surfaces.py` does so
if `edmctl measure-drift` has measured the common drift of rests and touches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from edmctl.planning.measuring import displacement
from edmctl.procedures.job import Job
from edmctl.process.touches import Displacement, Drift, share_u

LEAST_SPAN_S = 120.0  # over less time the error of the model after a deep cut would look like a drift
RECENT_S = 600.0  # time over which a recent drift is detected
HOMES_APART_S = 900.0  # least time between homes of successive jobs that show a drift
HOMES_ALIKE_UM = 3.0  # difference between homes of successive jobs by creep and unrecorded time
CREEP_UM = 0.6  # residual creep in two zeros ten minutes apart; it may hide as much of a drift
CREEP_SHARE = 0.01  # residual creep per way of the tool since the first rest; it hides a drift [assumed]
SEEN_SDS = 2.0  # standard deviations beyond which a drift contradicts the setup: 1 in 20 by chance
DRIFT_SDS = 4.0  # standard deviations beyond which a change is no drift
UNCERTAINTIES_IN_STROKE = 3.0  # a drift counts for no more than the stroke: no zero is further
Zero = tuple[float, float]  # time, s, and sensor reading with the tool at home, µm


class Rests:
    """Zeros of the displacement at every rest at 0 V: the sensor reading less the actuator's own creep.

    Only differences of zeros have a meaning. `first_um` is the rest before the actuator was conditioned, at
    `first_s`, NaN before there is one; `hidden_um` is by how much at most it is too far out.
    """

    def __init__(self) -> None:
        self._rests: list[tuple[float, float]] = []
        self._low_um, self._high_um = math.inf, -math.inf
        self.first_um = self.first_s = math.nan
        self.hidden_um = 0.0

    def note(self, time_s: float, zero_um: float) -> None:
        self._rests.append((time_s, zero_um))

    def reach(self, low_um: float, high_um: float) -> None:
        """Take the range of displacements of a block: the longer the way, the more creep."""
        if self._rests:
            self._low_um, self._high_um = min(self._low_um, low_um), max(self._high_um, high_um)

    def home_um(self, zero_um: float) -> float:
        """Return the sensor reading of a tool at home, by a rest with that zero."""
        return self.first_um + (zero_um - self._rests[0][1] if self._rests else 0.0)

    def ends(self) -> tuple[tuple[float, float], ...]:
        """Return time and zero of the first and of the newest rest; none before the first."""
        return (self._rests[0], self._rests[-1]) if self._rests else ()

    def drifted(self) -> tuple[float, Drift]:
        """Return the time from the first rest to the newest, and the drift of the zero less its creep."""
        if not self._rests:
            return 0.0, Drift(0.0, 0.0)
        (first_s, first_um), (last_s, last_um) = self.ends()
        return last_s - first_s, self._less_creep(last_um - first_um)

    def _less_creep(self, shift_um: float) -> Drift:
        """Creep by the way of the tool keeps it lower; residual creep has either sign."""
        creep_um = 0.5 * CREEP_SHARE * max(0.0, self._high_um - self._low_um)
        return Drift(shift_um - creep_um, share_u(CREEP_UM + creep_um))

    def contradicting_um_s(self, stated_um_s: float) -> float:
        """Return the drift that contradicts the setup, over the whole run or over `RECENT_S`, µm/s; 0 if none."""
        if len(self._rests) < 2:
            return 0.0
        last_s, last_um = self._rests[-1]
        earlier = [zero for zero in self._rests if last_s - zero[0] >= RECENT_S]
        return max(
            _contradicting(stated_um_s, last_s - time_s, self._less_creep(last_um - zero_um))
            for time_s, zero_um in (self._rests[0], earlier[-1] if earlier else self._rests[0])
        )


def _contradicting(stated_um_s: float, span_s: float, seen: Drift) -> float:
    """Return a drift that the setup does not explain, as its new standard uncertainty, µm/s; 0 if it does."""
    allowed_um = SEEN_SDS * math.hypot(stated_um_s * span_s, seen.left_u_um)
    return abs(seen.um) / max(LEAST_SPAN_S, span_s) if abs(seen.um) > allowed_um else 0.0


def contradicting_between_jobs_um_s(homes: Sequence[Zero], stated_um_s: float) -> float:
    """Return the drift of the homes of earlier jobs, the oldest first, that contradicts the setup, µm/s.

    `stated_um_s` is stated by the setup. A larger step is a sensor that was set anew, and a time that goes back a
    clock that was: the newest consistent homes that are far enough apart count. Homes without a time (NaN) are
    consistent with no others.
    """
    together: list[list[Zero]] = []
    for time_s, um in homes:
        before_s, before_um = together[-1][-1] if together else (math.nan, math.nan)
        most_um = HOMES_ALIKE_UM + DRIFT_SDS * stated_um_s * (time_s - before_s)
        if time_s >= before_s and abs(um - before_um) <= most_um:
            together[-1].append((time_s, um))
        else:
            together.append([(time_s, um)])
    for since in reversed(together):
        (first_s, first_um), (last_s, last_um) = since[0], since[-1]
        if last_s - first_s >= HOMES_APART_S:
            drift = Drift(last_um - first_um, share_u(CREEP_UM))
            return _contradicting(stated_um_s, last_s - first_s, drift)
    return 0.0


def first_home_um(rest_um: float, expected_um: float, drift_um: float) -> float:
    """Return home by a first rest: a lower rest is home, a higher one as far as the sensor may have drifted."""
    return min(rest_um, expected_um + drift_um)


def displacement_uncertainty(job: Job) -> Displacement:
    """Return the standard uncertainties of displacements: by the sensor, or by a calibrated actuator.

    A calibration inherits scale and linearity of its sensor. Its gain may have changed by 2.5 % since then, its zero
    walks by 1 µm in ten minutes, and a length is the difference of two estimates.
    """
    known = displacement(job.setup)
    if job.setup.sensor.fitted or job.calibration is None:
        return known
    return replace(known, model_u_um=math.sqrt(2.0) * job.calibration.held_out_rms_um)


def uncertainty_now(job: Job, rests: Rests) -> Displacement:
    """Return the same with the drift of the rests if that is more, and that between tool and workpiece."""
    sensor_u = displacement_uncertainty(job)
    apart_um_s = job.drift.apart_u_um_per_s if job.drift is not None else 0.0
    stated_um_s = sensor_u.drift_u_um_per_s
    seen_um_s = max(rests.contradicting_um_s(stated_um_s), job.drift_seen_um_s)
    drift_um_s = math.hypot(max(stated_um_s, seen_um_s), apart_um_s)
    return replace(sensor_u, drift_u_um_per_s=drift_um_s)


def counted_pause_s(job: Job) -> float:
    """Return the pause, at most until three standard uncertainties of the drift are the whole stroke."""
    drift_um_per_s = displacement_uncertainty(job).drift_u_um_per_s
    if not drift_um_per_s:
        return job.pause_s if math.isfinite(job.pause_s) else 0.0
    actuator = job.setup.actuator
    stroke_um = actuator.gain_um_per_v * actuator.stroke_v
    return min(job.pause_s, stroke_um / (UNCERTAINTIES_IN_STROKE * drift_um_per_s))


def pause_drift_u_um(job: Job) -> float:
    """Return the standard uncertainty of a place of the tool that was touched before the pause."""
    return displacement_uncertainty(job).drift_u_um_per_s * counted_pause_s(job)
