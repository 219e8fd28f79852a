"""Shorts that do not clear by the servo's own retreat: a jump breaks the bridge before the controller gives up.

The controller retracts while the gap is shorted and latches a fault after 1.5 s. Its clock starts again with a jump,
so the jumps for one short are few: after them its fault comes as it would have come without.
"""

from __future__ import annotations

SHORT_S = 0.3
"""A short that lasts so long is answered: healthy ones clear within 70 ms."""
MOST_JUMPS = 2
HEALED_S = 10.0
"""After so long without such a short the next one counts as a new one."""


class ShortRecovery:
    """Counts how long every pulse has been a short, and the jumps made for it."""

    def __init__(self) -> None:
        self._shorted_s = 0.0
        self._healthy_s = 0.0
        self.jumps = 0

    def take(self, duration_s: float, pulses: int, shorts: int, *, sparking: bool) -> None:
        """Judge a slice."""
        if not sparking or pulses == 0:
            return
        if shorts == pulses:
            self._shorted_s += duration_s
            self._healthy_s = 0.0
            return
        self._shorted_s = 0.0
        self._healthy_s += duration_s
        if self._healthy_s > HEALED_S:
            self.jumps = 0

    def due(self) -> str:
        """Why to jump now; empty while there is no reason, or when it has been tried often enough."""
        if self._shorted_s < SHORT_S - 1e-6 or self.jumps >= MOST_JUMPS:
            return ""
        return f"a short has lasted {self._shorted_s:.1f} s"

    def jumped(self) -> None:
        """Count the jump that was made."""
        self._shorted_s = 0.0
        self.jumps += 1
