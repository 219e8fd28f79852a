"""How long a reply takes, and so how long to wait before asking again (Jacobson and Karels 1988)."""

from __future__ import annotations

from collections import deque

FIRST_S = 0.1
"""Wait before the first round trip is known."""
SHORTEST_S, LONGEST_S = 0.02, 0.2
_KEPT = 2000


class RetransmitTimer:
    """Says how long to wait for a reply, from the smoothed round trip and its deviation.

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
