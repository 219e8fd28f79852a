"""Arcs and shorts of the last seconds of sparking."""

from __future__ import annotations

from collections import deque


class PulseWindow:
    """Sums over the newest `length_s` of what was added; jumps and what follows them are simply not added."""

    def __init__(self, length_s: float) -> None:
        self._length_s = length_s
        self._parts: deque[tuple[float, int, int, int]] = deque()
        self._span_s = 0.0
        self._pulses = self._arcs = self._shorts = 0

    def add(self, duration_s: float, pulses: int, arcs: int, shorts: int) -> None:
        """Take the pulses of a slice."""
        self._parts.append((duration_s, pulses, arcs, shorts))
        self._span_s += duration_s
        self._pulses += pulses
        self._arcs += arcs
        self._shorts += shorts
        while self._span_s - self._parts[0][0] >= self._length_s - 1e-6:
            old_s, old_pulses, old_arcs, old_shorts = self._parts.popleft()
            self._span_s -= old_s
            self._pulses -= old_pulses
            self._arcs -= old_arcs
            self._shorts -= old_shorts

    def clear(self) -> None:
        """Forget everything."""
        self._parts.clear()
        self._span_s = 0.0
        self._pulses = self._arcs = self._shorts = 0

    @property
    def is_full(self) -> bool:
        """Whether it covers its length."""
        return self._span_s >= self._length_s - 1e-6

    @property
    def arcs(self) -> float:
        """Share of arcs; 0 without pulses."""
        return self._arcs / self._pulses if self._pulses else 0.0

    @property
    def shorts(self) -> float:
        """Share of shorts; 0 without pulses."""
        return self._shorts / self._pulses if self._pulses else 0.0
