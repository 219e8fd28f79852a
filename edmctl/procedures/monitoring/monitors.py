"""Monitors of a whole run: the line, the sensor against the actuator model, and the uncertainties of the setup."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from edmctl.array_types import Array
from edmctl.labels import Seen
from edmctl.machine.faults import host_fault
from edmctl.machine.interface import TelemetryBlock
from edmctl.planning.forecast import stroke_um
from edmctl.procedures.run import Args, JobRun
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.process.plane import CONTRADICTION_SDS
from edmctl.record.rows import LinkRow, RunEvent
from edmctl.results.job import Belief

WINDOW_S = 1.0
WARNED_FRAMES = 3  # damaged frames within the window that are reported: a clean line has none in hours
MOST_FRAMES = 10  # damaged frames within the window that end the job; the controller does so too
REPORT_S = 10.0
LARGEST_SHARE = 0.15  # of the stroke of the job: the bound of Muralidhara et al. 2009 for hysteresis models
PATIENCE_S = 2.0  # a difference that lasts this long ends the job; a jolt or a jump is over sooner


class LinkMonitor:
    """Checks the line with every block of telemetry. Raises only once, not to disturb the retraction."""

    def __init__(self, run: JobRun) -> None:
        self._run = run
        self._bad: deque[tuple[float, int]] = deque()
        self._seen = run.machine.bad_frames
        self._warned = self._over = False
        self._next_report_s = REPORT_S

    def on_telemetry(self, block: TelemetryBlock) -> None:
        """Check the line at the time of these samples. Raises MachineFault E61003."""
        machine, now_s = self._run.machine, block.summary.end_s
        bad = machine.bad_frames
        if bad > self._seen:
            self._bad.append((now_s, bad - self._seen))
            self._seen = bad
        while self._bad and self._bad[0][0] <= now_s - WINDOW_S:
            self._bad.popleft()
        frames = sum(number for _, number in self._bad)
        if frames >= WARNED_FRAMES and not self._warned:
            self._run.warn(
                RunEvent.LINE_NOISE,
                f"The line is disturbed: {frames} damaged frames arrived within {WINDOW_S:.0f} s; "
                f"{MOST_FRAMES} end the job.",
                {"bad_frames": frames},
            )
        self._warned = frames >= WARNED_FRAMES
        if frames >= MOST_FRAMES and not self._over:
            self._over = True
            raise host_fault("LINE_NOISE", bad_frames=frames)
        if now_s >= self._next_report_s:
            self._next_report_s = REPORT_S * (now_s // REPORT_S + 1.0)
            self._run.recorder.append(LinkRow(now_s, machine.link_report()))


def record_link(run: JobRun) -> None:
    """Close the statistics of the line in the run file, and sum them up in an event."""
    report = run.machine.link_report()
    run.recorder.append(LinkRow(run.machine.time_s, report))
    message = (
        f"Link: {report.frames_received} frames in, {report.bad_frames} damaged, {report.lost_frames} lost, "
        f"{report.retries} commands repeated; round trip {report.rtt_p50_ms:.2f} ms."
    )
    run.note(RunEvent.LINK, message, {})


class SensorMonitor:
    """Compares the samples with their estimates; warns at once, and raises once if a difference lasts."""

    def __init__(self, run: JobRun) -> None:
        self._run = run
        self._largest_um = LARGEST_SHARE * stroke_um(run.profile)
        self._since_s: float | None = None
        self._over = False

    def update(self, block: TelemetryBlock, model_um: Array) -> None:
        """Take samples and their estimates, shape (n,) in µm. Raises MachineFault E67001."""
        sensor_um, estimate_um = float(block.displacement_um.mean()), float(model_um.mean())
        if self._over or abs(sensor_um - estimate_um) <= self._largest_um:
            self._since_s = None
            return
        message = (
            f" The sensor shows {sensor_um:.1f} µm and the model {estimate_um:.1f} µm; {self._largest_um:.1f} µm "
            "apart is the most."
        )
        if self._since_s is None:
            self._since_s = float(block.time_s[0])
            args = {"sensor_um": sensor_um, "model_um": estimate_um, "limit_um": self._largest_um}
            self._run.warn(RunEvent.Z_MISMATCH, host_fault("Z_MISMATCH").message + message, args)
        elif float(block.time_s[-1]) - self._since_s >= PATIENCE_S:
            self._over = True
            raise host_fault("Z_MISMATCH", message)


LEAST_SPAN_S = 60.0  # over less time creep of the first seconds after a cut would look like a drift


def judge_job(run: JobRun, pads: Sequence[SurfaceReading]) -> None:
    """Check the setup by the readings of the pad; creep in the drift of the rests is subtracted if measured."""
    drift, rests = run.job.drift, [pad.rest for pad in pads if pad.rest is not None]
    if drift is not None and len(rests) > 1:
        span_s = rests[-1].time_s - rests[0].time_s
        moved = drift.rest_moved(rests[0], rests[-1], run.job.unknown_use_s)
    else:
        span_s, moved = run.watch.rests.drifted()
    rates = (moved.um / span_s, moved.left_u_um / span_s) if span_s >= LEAST_SPAN_S else (math.nan, math.nan)
    run.tally.beliefs = judge(run, pads, *rates)


def judge(
    run: JobRun, pads: Sequence[SurfaceReading], drift_um_s: float, drift_u_um_s: float
) -> tuple[Belief, ...]:
    """Compare the setup's uncertainties with readings of the pad and the drift of the rests (NaN if unknown)."""
    setup = run.setup
    beliefs = (
        _judged("surface.tilt_u_mrad", setup.surface.tilt_u_mrad, *_slope_mrad(run, pads)),
        _judged("sensor.drift_um_per_s", setup.sensor.drift_um_per_s, drift_um_s, drift_u_um_s),
        Belief("sensor.gain_u_rel", setup.sensor.gain_u_rel, math.nan, math.nan, Seen.NEVER),
    )
    for belief in beliefs:
        if belief.seen is Seen.CONTRADICTED:
            args: Args = {"belief": belief.name, "believed": belief.believed, "found": belief.found}
            run.warn(RunEvent.BELIEF_CONTRADICTED, belief.message, args)
    return beliefs


def _judged(name: str, believed: float, found: float, u: float) -> Belief:
    if math.isnan(found):
        return Belief(name, believed, found, u, Seen.NOT)
    contradicted = abs(found) > CONTRADICTION_SDS * math.hypot(believed, u)
    return Belief(name, believed, found, u, Seen.CONTRADICTED if contradicted else Seen.HELD)


def _slope_mrad(run: JobRun, pads: Sequence[SurfaceReading]) -> tuple[float, float]:
    """Return the slope between the two spots of the pad and its standard uncertainty; NaN without one."""
    steps = [pad.step for pad in pads if pad.step is not None]
    if not steps:
        return math.nan, math.nan
    touch_u_um = run.tally.scatter.u_um
    slopes = [1e3 * step.um / math.hypot(*step.way_um) for step in steps]
    us = [1e3 * step.u_um(touch_u_um) / math.hypot(*step.way_um) for step in steps]
    return math.fsum(slopes) / len(steps), math.sqrt(math.fsum(u**2 for u in us)) / len(steps)
