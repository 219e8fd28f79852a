"""Time in the unit in which people would tell it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TimeUnit:
    """A unit of time, and how many seconds it has."""

    seconds: float
    symbol: str

    @property
    def label(self) -> str:
        """Label of an axis."""
        return f"time since start ({self.symbol})"


def time_unit(span_s: float) -> TimeUnit:
    """Return seconds for minutes, minutes for hours, and hours for what is longer."""
    if span_s <= 300.0:
        return TimeUnit(1.0, "s")
    return TimeUnit(60.0, "min") if span_s <= 3.0 * 3600.0 else TimeUnit(3600.0, "h")
