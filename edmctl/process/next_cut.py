"""Depth to target by cuts with measurements between them.

A measured depth is exact where a feed is not: tool wear takes an unknown part of it. So the first cut stays
short of the depth, and each later one is sized by the wear ratio measured so far.
"""

from __future__ import annotations

from dataclasses import dataclass

LONG_REST_TOLERANCES = 8.0
"""A rest of more tolerances than this is cut short once more: its wear ratio is known too badly."""
LONG_REST_FRACTION = 0.9
NOISE_FLOOR_SIGMAS = 2.0
"""A rest below this many standard deviations of the depth is noise; chasing it only cuts too deep."""


@dataclass(frozen=True, slots=True)
class NextCut:
    """Feed of the next cut in µm, or the end of it: then `feed_um` is 0."""

    feed_um: float
    remaining_um: float

    @property
    def done(self) -> bool:
        return self.feed_um == 0.0


def first_feed_um(depth_um: float, wear_ratio: float, first_fraction: float) -> float:
    """Feed of the first cut: a fraction of the depth and the wear that goes with it, µm."""
    return first_fraction * depth_um * (1.0 + wear_ratio)


def next_cut(
    *, target_um: float, depth_um: float, wear_ratio: float, tolerance_um: float, depth_noise_um: float
) -> NextCut:
    """Size the next cut from the measured depth and wear ratio.

    Stops at half the tolerance, or at the noise of the measurement where that is larger.
    `wear_ratio` is linear (wear length per depth), `depth_noise_um` one standard deviation.
    """
    remaining_um = target_um - depth_um
    if remaining_um <= max(tolerance_um / 2.0, NOISE_FLOOR_SIGMAS * depth_noise_um):
        return NextCut(0.0, remaining_um)
    fraction = LONG_REST_FRACTION if remaining_um > LONG_REST_TOLERANCES * tolerance_um else 1.0
    return NextCut(fraction * remaining_um * (1.0 + max(wear_ratio, 0.0)), remaining_um)
