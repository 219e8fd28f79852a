"""Controller time against host time: a straight line through the heartbeats that came back fastest.

A heartbeat carries the host's time out and the controller's time back. The controller read its clock somewhere
between sending and receiving, so half the round trip is the best guess of when, and a fast round trip is a good one.
"""

from __future__ import annotations

from collections import deque

from edmctl.dataclasses import dataclass

WINDOW_S = 60.0
"""Heartbeats older than this are forgotten: crystals drift with temperature."""
SLOWEST_SHARE = 1.5
"""Of the best round trip in the window: slower heartbeats tell too little."""
LEAST_SPREAD_S = 0.2e-3
"""Round trips this little above the best one count as well: that much is noise of the computer."""
STRAIGHT_S = 10.0
"""With a shorter history the rate of a normal clock is better known from the crystal than from the fit."""
CRYSTAL = 0.02
"""A rate this near to one is that of a clock that runs as it should."""
SLOWEST = 0.01
"""No clock is taken for slower: a wait by one that stands still would have no end."""
SURE = 5
"""So many heartbeats with short round trips tell the rate of any clock."""
_REFIT_S = 0.5
_WRAP_32 = 1 << 32


@dataclass(frozen=True, slots=True)
class ClockLine:
    """Controller time = `machine_s` + `rate` × (host time − `host_s`), all in seconds."""

    host_s: float = 0.0
    machine_s: float = 0.0
    rate: float = 1.0
    residual_s: float = 0.0

    def at(self, host_s: float) -> float:
        """Return controller time at a host time."""
        return self.machine_s + self.rate * (host_s - self.host_s)


class ClockFit:
    """Collects heartbeats and fits the line through the best of them."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float, float]] = deque()
        self._line = ClockLine()
        self._good = 0
        self._fitted_s = -1e9

    def note(self, sent_s: float, received_s: float, machine_s: float) -> None:
        """Take one heartbeat: host times of sending and receiving, and the controller's time in its reply, in s."""
        self._samples.append((0.5 * (sent_s + received_s), machine_s, received_s - sent_s))
        while received_s - self._samples[0][0] > WINDOW_S and len(self._samples) > 1:
            self._samples.popleft()
        if len(self._samples) <= 8 or received_s - self._fitted_s >= _REFIT_S:
            self._line = self._fit()
            self._fitted_s = received_s

    @property
    def is_sure(self) -> bool:
        """Whether the newest line goes through enough heartbeats to tell the clock's rate."""
        return self._good >= SURE

    @property
    def line(self) -> ClockLine:
        """Return the newest fit; before the first heartbeat, that of equal clocks."""
        return self._line

    def _fit(self) -> ClockLine:
        best_s = min(sample[2] for sample in self._samples)
        limit_s = max(SLOWEST_SHARE * best_s, best_s + LEAST_SPREAD_S)
        good = [sample for sample in self._samples if sample[2] <= limit_s]
        n = self._good = len(good)
        host_s = sum(sample[0] for sample in good) / n
        machine_s = sum(sample[1] for sample in good) / n
        spread = sum((sample[0] - host_s) ** 2 for sample in good)
        rate = 1.0
        if spread > 0.0:
            rate = sum((s[0] - host_s) * (s[1] - machine_s) for s in good) / spread
        if good[-1][0] - good[0][0] < STRAIGHT_S and abs(rate - 1.0) < CRYSTAL:
            rate = 1.0
        rate = max(rate, SLOWEST)
        squares = sum((s[1] - machine_s - rate * (s[0] - host_s)) ** 2 for s in good)
        return ClockLine(host_s, machine_s, rate, (squares / n) ** 0.5)


class ControllerClock:
    """Unwraps the controller's 32-bit microseconds, which start over every 71.6 minutes."""

    def __init__(self) -> None:
        self._reference_us = 0

    def note(self, t_dev_us: int) -> None:
        """Take the controller's full time, as every heartbeat brings it."""
        self._reference_us = t_dev_us

    @property
    def newest_s(self) -> float:
        """Return the newest full time, in seconds."""
        return self._reference_us / 1_000_000

    def seconds(self, t_us: int) -> float:
        """Return controller time in seconds of a time within 35 minutes of the last heartbeat."""
        ahead = (t_us - self._reference_us) % _WRAP_32
        if ahead >= _WRAP_32 // 2:
            ahead -= _WRAP_32
        return (self._reference_us + ahead) / 1_000_000
