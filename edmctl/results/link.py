"""How the line to the controller did."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LinkReport:
    """How the line did so far.

    `controller_bad_frames` and `controller_dropped_frames` are what the controller threw away of ours, as far as it
    told. The clock is the controller's against the host's: offset in s, rate as deviation from one in ppm.
    """

    frames_sent: int
    frames_received: int
    bad_frames: int
    retries: int
    lost_frames: int
    controller_bad_frames: int
    controller_dropped_frames: int
    rtt_p50_ms: float
    rtt_p99_ms: float
    clock_offset_s: float
    clock_rate_ppm: float
    clock_residual_us: float
