"""Limits of a cut and of a job: arcs and shorts, a stalled tool, time and stroke."""

from __future__ import annotations

import math

import numpy as np

from edmctl.actuator.model import Estimator
from edmctl.dataclasses import dataclass
from edmctl.planning.forecast import forecast
from edmctl.procedures.run import JobRun
from edmctl.record.rows import RunEvent
from edmctl.results.telemetry import PulseShares

UNSTABLE_S = 30.0
"""A cut over its arc or short limit for this long is ended. Badly flushed holes that succeed are over it for up to
9 s, until the next jump, so it has to outlast some jump periods (decision 0012)."""

# Looked up in every slice; an enum member costs a metaclass call each time in Python 3.11.
_ARCING, _SHORTING = RunEvent.ARCING, RunEvent.SHORTING
STALL_S = 60.0
"""A cut that moves less than `STALL_SHARE` of the forecast feed for this long is stalled. Our choice: six jumps."""
STALL_SHARE = 0.05
"""Of the forecast feed; bad flushing alone leaves more than half of it."""
JUMP_AFTER_S = 0.5 * STALL_S
"""After this time a jump is tried, whatever the recipe."""
LONGEST_SHARE = 3.0
"""Longest machining time of a job relative to its forecast."""
RISE_SAMPLES = 200
LEAST_S = 120.0
"""Least limit of a short job, twice the time that detects a stalled tool."""


class RatioLimits:
    """Limits of the shares over a window of `window_s`."""

    def __init__(self, run: JobRun, window_s: float) -> None:
        self._run = run
        self._window_s = window_s
        self._since_s: dict[RunEvent, float] = {}

    def update(self, now_s: float, ratios: PulseShares, *, window_is_full: bool) -> str:
        """Return which have stayed over their limit for too long, arcs or shorts; empty if none have."""
        limits = self._run.profile.limits
        arcs = self._look(_ARCING, "arcs", ratios.arc, limits.arc_ratio, now_s, window_is_full)
        shorts = self._look(_SHORTING, "shorts", ratios.short, limits.short_ratio, now_s, window_is_full)
        return "shorts" if shorts else "arcs" if arcs else ""

    def _look(
        self, code: RunEvent, name: str, ratio: float, limit: float, now_s: float, window_is_full: bool
    ) -> bool:
        if ratio <= limit:
            self._since_s.pop(code, None)
            return False
        if not window_is_full:
            return False
        since_s = self._since_s.get(code)
        if since_s is None:
            self._since_s[code] = now_s
            self._run.warn(
                code,
                f"{100 * ratio:.0f} % {name} in the last {self._window_s:.0f} s; "
                f"the limit is {100 * limit:.0f} %.",
                {"ratio": ratio, "limit": limit},
            )
            return False
        return now_s - since_s > UNSTABLE_S


class StallDetection:
    """Compares the advance of the tool in a cut with the forecast feed."""

    def __init__(self, forecast_feed_um_s: float) -> None:
        self._least_um = STALL_SHARE * forecast_feed_um_s * STALL_S
        self._since_s = self._since_um = math.nan
        self._tried = False
        self.jump_wanted = False
        self.message = ""

    @property
    def due_s(self) -> float:
        """When a stalled tool causes the next reaction; infinity before the first update."""
        after_s = STALL_S if self._tried else JUMP_AFTER_S
        return math.inf if math.isnan(self._since_s) else self._since_s + after_s

    def update(self, now_s: float, displacement_um: float) -> bool:
        """Take the place of the sparking tool; return whether the cut has stalled, as `message` then states."""
        if math.isnan(self._since_s) or displacement_um - self._since_um > self._least_um:
            self._since_s, self._since_um = now_s, displacement_um
            self._tried = self.jump_wanted = False
            return False
        stood_s = now_s - self._since_s
        self.message = f"{displacement_um - self._since_um:.1f} µm in {stood_s:.0f} s"
        if stood_s > JUMP_AFTER_S and not self._tried:
            self._tried = self.jump_wanted = True
        return stood_s > STALL_S


@dataclass(frozen=True, slots=True)
class TimeLeft:
    """Seconds until a limit, and its name."""

    seconds: float
    limit: str


class TimeLimits:
    """The time limits of one run: of the whole job, and of machining."""

    def __init__(self, run: JobRun) -> None:
        self._run = run
        expected_s = forecast(run.job.profile, run.setup, run.job.sites).machining_time_s
        self._machining_s = max(LEAST_S, LONGEST_SHARE * expected_s)
        self._before_s = run.tally.machining_time_s

    def left(self) -> TimeLeft:
        """Return the limit that comes first."""
        job_s = self._run.profile.limits.max_time_s
        whole = TimeLeft(job_s - self._run.machine.time_s, f"limits.max_time_s allows the job {job_s:.0f} s")
        machined_s = self._run.tally.machining_time_s - self._before_s
        machining = TimeLeft(
            self._machining_s - machined_s, f"the forecast allows {self._machining_s:.0f} s of machining"
        )
        return min(whole, machining, key=lambda left: left.seconds)


def stroke_left_um(estimator: Estimator, limit_v: float) -> float:
    """Return the way in µm that the actuator moves at once from here to `limit_v`."""
    model, state = estimator.model, estimator.state
    reached_um = model.at_once_um(state, max(state.u_v, limit_v))
    return estimator.gain * (reached_um - model.at_once_um(state, state.u_v))


def rise_um(estimator: Estimator, limit_v: float, time_s: float) -> float:
    """Return how far a steady rise to `limit_v` within `time_s` moves the actuator, in µm, creep included."""
    state = estimator.state
    times_s = np.linspace(state.t_s, state.t_s + time_s, RISE_SAMPLES)
    risen_um = estimator.model.predict(times_s, np.linspace(state.u_v, limit_v, RISE_SAMPLES), state)
    return estimator.gain * float(risen_um[-1] - risen_um[0])
