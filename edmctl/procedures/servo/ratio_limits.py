"""Arcs and shorts over the recipe's limits: told at once, and a reason to end a cut when they stay."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.procedures.event_codes import RunEvent
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    from edmctl.procedures.run import Run
    from edmctl.results.pulses import PulseShares

UNSTABLE_S = 30.0
"""A cut over its arc or short limit for so long is ended. Badly flushed holes that come out well are over it for up
to 9 s, until the next jump, so it has to outlast some jump periods (decision 0012)."""

# Looked up in every slice; an enum member costs a metaclass call each time in Python 3.11.
_ARCING, _SHORTING = RunEvent.ARCING, RunEvent.SHORTING


class RatioLimits:
    """Judges the shares over a window of `window_s`."""

    def __init__(self, run: Run, window_s: float) -> None:
        self._run = run
        self._window_s = window_s
        self._since_s: dict[RunEvent, float] = {}

    def take(self, now_s: float, ratios: PulseShares, *, window_is_full: bool) -> bool:
        """Judge; True when arcs or shorts have stayed over their limit for too long."""
        limits = self._run.profile.limits
        arcs = self._look(_ARCING, "arcs", ratios.arc, limits.arc_ratio, now_s, window_is_full)
        shorts = self._look(_SHORTING, "shorts", ratios.short, limits.short_ratio, now_s, window_is_full)
        return arcs or shorts

    def _look(
        self, code: RunEvent, name: str, ratio: float, limit: float, now_s: float, window_is_full: bool
    ) -> bool:
        if ratio <= limit:
            self._since_s.pop(code, None)
            return False
        if not window_is_full:
            return False
        since_s = self._since_s.get(code)
        if since_s is None:
            self._since_s[code] = now_s
            self._run.decide(
                code,
                f"{100 * ratio:.0f} % {name} in the last {self._window_s:.0f} s; "
                f"the limit is {100 * limit:.0f} %.",
                {"ratio": ratio, "limit": limit},
                level=EventLevel.WARNING,
            )
            return False
        return now_s - since_s > UNSTABLE_S
