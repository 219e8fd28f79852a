"""Shares of the four pulse classes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PulseShares:
    """Share of the pulses in each class; they sum to 1, or are all 0 when there was no pulse."""

    open: float
    normal: float
    arc: float
    short: float


def pulse_shares(open_count: int, normal_count: int, arc_count: int, short_count: int) -> PulseShares:
    """Shares from counts."""
    total = open_count + normal_count + arc_count + short_count
    if total == 0:
        return PulseShares(0.0, 0.0, 0.0, 0.0)
    return PulseShares(open_count / total, normal_count / total, arc_count / total, short_count / total)
