"""Limits of a cut and of a job: arcs and shorts, a stalled tool, lost sparks and breakthrough, time and stroke."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from edmctl.actuator.model import Estimator
from edmctl.dataclasses import dataclass
from edmctl.planning.forecast import forecast
from edmctl.procedures.run import JobRun
from edmctl.process.next_cut import CLEAR_SIGMAS
from edmctl.quantity import Value
from edmctl.record.rows import RunEvent
from edmctl.results.telemetry import PulseShares

RATIO_WINDOW_S = 2.0  # window of arcs and shorts; over their limit they are reported at once (decision 0012)
UNSTABLE_S = 30.0  # a cut over its limits for this long is ended: bad flushing gives 9 s (decision 0012)

# Looked up in every slice; an enum member costs a metaclass call each time in Python 3.11.
_ARCING, _SHORTING = RunEvent.ARCING, RunEvent.SHORTING
STALL_S = 60.0  # a cut with less than `STALL_SHARE` of the forecast feed is stalled. Our choice: six jumps
STALL_SHARE = 0.05  # of the forecast feed; bad flushing alone leaves more than half of it
JUMP_AFTER_S = 0.5 * STALL_S  # after this time a jump is tried, whatever the recipe
LONGEST_SHARE = 3.0  # longest machining time of a job relative to its forecast
RISE_SAMPLES = 200
LEAST_S = 120.0  # least limit of a short job, twice the time that detects a stalled tool


class RatioLimits:
    """Limits of the shares of arcs and shorts over the last seconds."""

    def __init__(self, run: JobRun) -> None:
        self._run = run
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
            window = f"{100 * ratio:.0f} % {name} in the last {RATIO_WINDOW_S:.0f} s"
            args = {"ratio": ratio, "limit": limit}
            self._run.warn(code, f"{window}; the limit is {100 * limit:.0f} %.", args)
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
        run, job_s = self._run, self._run.profile.limits.max_time_s
        machined_s = run.tally.machining_time_s - self._before_s
        whole = TimeLeft(job_s - run.machine.time_s, f"limits.max_time_s allows the job {job_s:.0f} s")
        limit = f"the forecast allows {self._machining_s:.0f} s of machining"
        return min(whole, TimeLeft(self._machining_s - machined_s, limit), key=lambda left: left.seconds)


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


BREAKTHROUGH_WINDOW_S = 2.0
BASE_S = 20.0
FEED_FACTOR = 1.6  # mean feed of the last 2 s relative to the median of the last 20 s
DEPTH_SHARE = 0.15  # distance of depth and thickness besides its uncertainty: the wear in it is only expected
OPEN_S = 1.0
OPEN_MORE = 0.10  # rise of the share of open pulses in the last second over that of the last 20 s
FREEZE_S = 0.5  # time after a jump without detection


def is_near_back(depth: Value, thickness_um: float) -> bool:
    """Return whether the hole may be open by its depth."""
    return abs(depth.value - thickness_um) <= DEPTH_SHARE * thickness_um + CLEAR_SIGMAS * depth.u


class Breakthrough:
    """Detects the breakthrough of one cut through a sheet of `thickness_um`, slice by slice.

    `at_um` is the displacement at which the sheet broke through, NaN before; `message` states the evidence.
    `feed_um_s` is the newest mean feed.
    """

    def __init__(self, thickness_um: float) -> None:
        self._thickness_um = thickness_um
        self._last_um = self.at_um = math.nan
        self._freeze_s = self._seconds = self._span_s = 0.0
        self._base: deque[tuple[float, float, float]] = deque()
        self.feed_um_s = self._open_share = 0.0
        self.message = ""

    def update(
        self, duration_s: float, displacement_um: float, depth: Value, open_share: float, *, sparking: bool
    ) -> bool:
        """Take a slice with the estimated depth; return True once, when the sheet has broken through."""
        if not sparking:
            self._freeze_s, self._last_um = FREEZE_S, math.nan
            return False
        if self._freeze_s > 0.0:
            self._freeze_s -= duration_s
            return False
        last_um, self._last_um = self._last_um, displacement_um
        if math.isnan(last_um):
            return False
        speed_um_s = (displacement_um - last_um) / duration_s
        self._seconds += duration_s
        self.feed_um_s += (
            duration_s / min(BREAKTHROUGH_WINDOW_S, self._seconds) * (speed_um_s - self.feed_um_s)
        )
        self._open_share += duration_s / min(OPEN_S, self._seconds) * (open_share - self._open_share)
        self._base.append((duration_s, self.feed_um_s, self._open_share))
        self._span_s += duration_s
        while self._span_s > BASE_S:
            self._span_s -= self._base.popleft()[0]
        if not math.isnan(self.at_um) or self._span_s < 0.5 * BASE_S:
            return False
        if not is_near_back(depth, self._thickness_um):
            return False
        _, feeds, shares = zip(*self._base, strict=True)
        usual_um_s, usual_share = sorted(feeds)[len(feeds) // 2], sum(shares) / len(shares)
        is_faster = self.feed_um_s > FEED_FACTOR * usual_um_s
        if not is_faster or self._open_share <= usual_share + OPEN_MORE:
            return False
        self.at_um = displacement_um
        self.message = (
            f"Broke through at {self.at_um:.1f} µm: the feed rose from {usual_um_s:.2f} to {self.feed_um_s:.2f} "
            f"µm/s, open pulses from {100 * usual_share:.0f} to {100 * self._open_share:.0f} %."
        )
        return True

    def on_spark_loss(self, spark_um: float, depth: Value, lost: str) -> bool:
        """Take the end of all discharges, the last at `spark_um`; return whether the sheet has broken through."""
        if not is_near_back(depth, self._thickness_um):
            return False
        self.at_um, self.message = spark_um, f"Broke through at {spark_um:.1f} µm: {lost}."
        return True


class SparkLoss:
    """Open pulses for over `limit_um` or `limit_s` since the last spark, at `spark_um` (NaN before the first)."""

    def __init__(self, limit_um: float, limit_s: float) -> None:
        self._limit_um, self._limit_s = limit_um, limit_s
        self._open_s = 0.0
        self.spark_um = math.nan

    def update(self, duration_s: float, displacement_um: float, pulses: int, opens: int) -> str:
        """Take a slice of sparking; return the evidence when the sparks are lost, otherwise empty."""
        if opens < pulses or math.isnan(self.spark_um):
            self._open_s, self.spark_um = 0.0, displacement_um
            return ""
        self._open_s += duration_s
        way_um = displacement_um - self.spark_um
        if way_um <= self._limit_um and self._open_s <= self._limit_s:
            return ""
        return f"{self._open_s:.1f} s and {way_um:.1f} µm without a discharge, at {displacement_um:.1f} µm"
