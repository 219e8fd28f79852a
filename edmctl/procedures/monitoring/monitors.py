"""Monitors of a whole run: the line, and the sensor against the actuator model."""

from __future__ import annotations

from collections import deque

from edmctl.array_types import Array
from edmctl.machine.faults import host_fault
from edmctl.machine.interface import TelemetryBlock
from edmctl.planning.forecast import stroke_um
from edmctl.procedures.run import Args, JobRun
from edmctl.record.rows import LinkRow, RunEvent

WINDOW_S = 1.0
WARNED_FRAMES = 3
"""Damaged frames within the window that are reported: a clean line has none in hours."""
MOST_FRAMES = 10
"""Damaged frames within the window that end the job, as the controller does for those that it receives."""
REPORT_S = 10.0
LARGEST_SHARE = 0.15
"""Of the stroke that the job uses: the bound of Muralidhara et al. 2009 for a model of hysteresis."""
PATIENCE_S = 2.0
"""A difference that lasts this long ends the job; a jolt or a jump is over sooner."""


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
        now_s = block.summary.end_s
        self._look_for_noise(now_s)
        if now_s >= self._next_report_s:
            self._next_report_s = REPORT_S * (now_s // REPORT_S + 1.0)
            self._run.recorder.append(LinkRow(now_s, self._run.machine.link_report()))

    def _look_for_noise(self, now_s: float) -> None:
        bad = self._run.machine.bad_frames
        if bad > self._seen:
            self._bad.append((now_s, bad - self._seen))
            self._seen = bad
        while self._bad and self._bad[0][0] <= now_s - WINDOW_S:
            self._bad.popleft()
        if not self._bad:
            self._warned = False
            return
        frames = sum(number for _, number in self._bad)
        if frames < WARNED_FRAMES:
            self._warned = False
        elif not self._warned:
            self._warned = True
            self._run.warn(
                RunEvent.LINE_NOISE,
                f"The line is disturbed: {frames} damaged frames arrived within {WINDOW_S:.0f} s; "
                f"{MOST_FRAMES} end the job.",
                {"bad_frames": frames},
            )
        if frames >= MOST_FRAMES and not self._over:
            self._over = True
            raise host_fault("LINE_NOISE", bad_frames=frames)


def record_link(run: JobRun) -> None:
    """Close the statistics of the line in the run file, and sum them up in an event."""
    report = run.machine.link_report()
    run.recorder.append(LinkRow(run.machine.time_s, report))
    message = (
        f"Link: {report.frames_received} frames in, {report.bad_frames} damaged, {report.lost_frames} lost, "
        f"{report.retries} commands repeated; round trip {report.rtt_p50_ms:.2f} ms."
    )
    # The names are so short that they fit an event.
    figures: Args = {
        "sent": report.frames_sent,
        "received": report.frames_received,
        "bad": report.bad_frames,
        "lost": report.lost_frames,
        "retries": report.retries,
        "bad_there": report.controller_bad_frames,
        "rtt50_ms": round(report.rtt_p50_ms, 3),
        "rtt99_ms": round(report.rtt_p99_ms, 3),
        "clock_s": round(report.clock_offset_s, 6),
        "clock_ppm": round(report.clock_rate_ppm, 2),
        "residual_us": round(report.clock_residual_us, 1),
    }
    run.note(RunEvent.LINK, message, figures)


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
        now_s = float(block.time_s[-1])
        if self._over or abs(sensor_um - estimate_um) <= self._largest_um:
            self._since_s = None
            return
        message = (
            f" The sensor shows {sensor_um:.1f} µm and the model {estimate_um:.1f} µm; {self._largest_um:.1f} µm "
            "apart is the most."
        )
        if self._since_s is None:
            self._since_s = float(block.time_s[0])
            self._run.warn(
                RunEvent.Z_MISMATCH,
                host_fault("Z_MISMATCH").message + message,
                {"sensor_um": sensor_um, "model_um": estimate_um, "limit_um": self._largest_um},
            )
        elif now_s - self._since_s >= PATIENCE_S:
            self._over = True
            raise host_fault("Z_MISMATCH", message)
