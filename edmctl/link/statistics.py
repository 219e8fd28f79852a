"""What a session measures of its line: counts, round trips, and the report made from them."""

from __future__ import annotations

from collections import deque

from edmctl.dataclasses import dataclass, field
from edmctl.link.clock import ClockLine
from edmctl.link.messages import HeartbeatReply
from edmctl.results.telemetry import LinkReport

FIRST_S = 0.1
"""Wait before the first round trip is known."""
SHORTEST_S, LONGEST_S = 0.02, 0.2
_KEPT = 2000


class RetransmitTimer:
    """Says how long to wait for a reply, from the smoothed round trip and its deviation (Jacobson and Karels 1988).

    The newest round trips are kept for statistics.
    """

    def __init__(self) -> None:
        self._kept: deque[float] = deque(maxlen=_KEPT)
        self._smooth_s = 0.0
        self._deviation_s = 0.0

    def note(self, round_trip_s: float) -> None:
        """Take the round trip of a command sent once; of one sent again nobody knows which copy was answered."""
        if not self._kept:
            self._smooth_s, self._deviation_s = round_trip_s, 0.5 * round_trip_s
        else:
            error_s = round_trip_s - self._smooth_s
            self._smooth_s += 0.125 * error_s
            self._deviation_s += 0.25 * (abs(error_s) - self._deviation_s)
        self._kept.append(round_trip_s)

    @property
    def timeout_s(self) -> float:
        """Return how long to wait for a reply before the command is sent again."""
        if not self._kept:
            return FIRST_S
        return min(LONGEST_S, max(SHORTEST_S, self._smooth_s + 4.0 * self._deviation_s))

    def quantile_s(self, share: float) -> float:
        """Return the round trip that this share of the kept ones does not exceed; 0 before the first."""
        ordered = sorted(self._kept)
        return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else 0.0


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
