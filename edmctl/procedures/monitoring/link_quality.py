"""The line of a run: what the host receives damaged, and every ten seconds how it does."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from edmctl.machine.interface import host_fault
from edmctl.procedures.event_codes import RunEvent
from edmctl.record.rows import EventLevel, LinkRow

if TYPE_CHECKING:
    from edmctl.machine.interface import TelemetryBlock
    from edmctl.procedures.run import Run
    from edmctl.results.link import LinkReport

WINDOW_S = 1.0
WARNED_FRAMES = 3
"""Damaged frames within the window that are told: a clean line has none in hours."""
MOST_FRAMES = 10
"""Damaged frames within the window that end the job, as the controller does for those that it receives."""
REPORT_S = 10.0


class LinkWatch:
    """Looks at the line with every block of telemetry. Raises once, as the retreat must not be disturbed."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._bad: deque[tuple[float, int]] = deque()
        self._seen = run.machine.bad_frames
        self._warned = self._over = False
        self._next_report_s = REPORT_S

    def take(self, block: TelemetryBlock) -> None:
        """Judge the line at the time of these samples. Raises MachineFault E61003."""
        now_s = float(block.time_s[-1])
        self._look_for_noise(now_s)
        if now_s >= self._next_report_s:
            self._next_report_s = REPORT_S * (now_s // REPORT_S + 1.0)
            self._run.recorder.append_link(_row(now_s, self._run.machine.link_report()))

    def _look_for_noise(self, now_s: float) -> None:
        bad = self._run.machine.bad_frames
        if bad > self._seen:
            self._bad.append((now_s, bad - self._seen))
            self._seen = bad
        while self._bad and self._bad[0][0] <= now_s - WINDOW_S:
            self._bad.popleft()
        frames = sum(number for _, number in self._bad)
        if frames < WARNED_FRAMES:
            self._warned = False
        elif not self._warned:
            self._warned = True
            self._run.decide(
                RunEvent.LINE_NOISE,
                f"The line is disturbed: {frames} damaged frames arrived within {WINDOW_S:.0f} s; "
                f"{MOST_FRAMES} end the job.",
                {"bad_frames": frames},
                level=EventLevel.WARNING,
            )
        if frames >= MOST_FRAMES and not self._over:
            self._over = True
            raise host_fault("LINE_NOISE", bad_frames=frames)


def record_link(run: Run) -> None:
    """Close the statistics of the line in the run file, and sum them up in an event."""
    report = run.machine.link_report()
    run.recorder.append_link(_row(run.machine.time_s, report))
    message = (
        f"Link: {report.frames_received} frames in, {report.bad_frames} damaged, {report.lost_frames} lost, "
        f"{report.retries} commands repeated; round trip {report.rtt_p50_ms:.2f} ms."
    )
    run.recorder.event(run.machine.time_s, RunEvent.LINK, EventLevel.INFO, message, _figures(report))


def _row(time_s: float, report: LinkReport) -> LinkRow:
    return LinkRow(
        time_s=time_s,
        frames_sent=report.frames_sent,
        frames_received=report.frames_received,
        bad_frames=report.bad_frames,
        lost_frames=report.lost_frames,
        retries=report.retries,
        controller_bad_frames=report.controller_bad_frames,
        controller_dropped_frames=report.controller_dropped_frames,
        rtt_p50_ms=report.rtt_p50_ms,
        rtt_p99_ms=report.rtt_p99_ms,
        clock_offset_s=report.clock_offset_s,
        clock_rate_ppm=report.clock_rate_ppm,
    )


def _figures(report: LinkReport) -> dict[str, float | int]:
    """The report in names so short that they fit an event."""
    return {
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
