"""Electrode jumps: how high a jump must be to flush the gap, and what it costs."""

from __future__ import annotations


def minimum_height_um(depth_um: float, diameter_um: float, side_gap_um: float) -> float:
    """Least useful jump height in µm: the tool's stroke must refill the annulus beside it.

    `h_min = 4 s z / d * (1 + s / d)`: annulus volume of depth z over the tool's face.
    """
    return 4.0 * side_gap_um * depth_um / diameter_um * (1.0 + side_gap_um / diameter_um)


def duration_s(height_um: float, speed_um_s: float, dwell_s: float) -> float:
    """Time of one jump, up and down with a dwell at the top."""
    return 2.0 * height_um / speed_um_s + dwell_s


def time_share(height_um: float, speed_um_s: float, dwell_s: float, period_s: float) -> float:
    """Share of the time that jumping takes when a jump starts every `period_s`."""
    return duration_s(height_um, speed_um_s, dwell_s) / period_s
