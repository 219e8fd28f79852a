"""What a session keeps count of, and the report made from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from edmctl.results.link import LinkReport

if TYPE_CHECKING:
    from edmctl.link.clock import ClockLine
    from edmctl.link.messages import HeartbeatReply
    from edmctl.link.retransmit_timer import RetransmitTimer


@dataclass(slots=True)
class Statistics:
    """Counts since the session opened. `lost_frames` counts telemetry frames by message name, exactly.

    `malformed` frames had the right check, and said what no controller can say.
    """

    frames_sent: int = 0
    frames_received: int = 0
    bad_frames: int = 0
    other_session: int = 0
    stray_replies: int = 0
    unknown_types: int = 0
    malformed: int = 0
    repeated_events: int = 0
    repeated_frames: int = 0
    retries: int = 0
    bytes_received: int = 0
    heartbeats_sent: int = 0
    heartbeats_answered: int = 0
    lost_frames: dict[str, int] = field(default_factory=dict)


def link_report(
    counts: Statistics, beat: HeartbeatReply | None, timer: RetransmitTimer, line: ClockLine
) -> LinkReport:
    """Return the report that these add up to; `beat` is the newest answer to a heartbeat."""
    return LinkReport(
        frames_sent=counts.frames_sent,
        frames_received=counts.frames_received,
        bad_frames=counts.bad_frames,
        retries=counts.retries,
        lost_frames=sum(counts.lost_frames.values()),
        controller_bad_frames=beat.rx_bad if beat else 0,
        controller_dropped_frames=beat.rx_drop if beat else 0,
        rtt_p50_ms=1e3 * timer.quantile_s(0.5),
        rtt_p99_ms=1e3 * timer.quantile_s(0.99),
        clock_offset_s=line.machine_s - line.host_s,
        clock_rate_ppm=1e6 * (line.rate - 1.0),
        clock_residual_us=1e6 * line.residual_s,
    )
