"""Detection of a breakthrough at the back of a sheet, from feed, depth and open pulses.

As the bottom opens, less area remains to erode: the tool feeds faster, and more pulses are open. If the workpiece
erodes nearly as fast as the servo feeds, the feed cannot rise; then the end of all discharges shows it.
"""

from __future__ import annotations

import math
from collections import deque

from edmctl.process.next_cut import CLEAR_SIGMAS

FEED_WINDOW_S = 2.0
BASE_S = 20.0
FEED_FACTOR = 1.6
"""Mean feed of the last 2 s relative to the median of the last 20 s."""
DEPTH_SHARE = 0.15
"""Largest distance of the depth from the thickness, besides its uncertainty: the wear in it is only expected."""
OPEN_S = 1.0
OPEN_MORE = 0.10
"""Rise of the share of open pulses in the last second over that of the last 20 s."""
FREEZE_S = 0.5
"""Time after a jump without detection."""


def is_near_back(depth_um: float, depth_u_um: float, thickness_um: float) -> bool:
    """Return whether the hole may be open by its depth."""
    return abs(depth_um - thickness_um) <= DEPTH_SHARE * thickness_um + CLEAR_SIGMAS * depth_u_um


class Breakthrough:
    """Detects the breakthrough of one cut through a sheet of `thickness_um`, slice by slice.

    `at_um` is the displacement at which the sheet broke through, NaN before; `message` states the evidence. Feeds
    and shares of open pulses are the newest, and the usual ones before.
    """

    def __init__(self, thickness_um: float) -> None:
        self._thickness_um = thickness_um
        self._last_um = math.nan
        self._freeze_s = 0.0
        self._seconds = 0.0
        self._base: deque[tuple[float, float, float]] = deque()
        self._span_s = 0.0
        self.at_um = math.nan
        self.message = ""
        self.feed_um_s = self.usual_feed_um_s = self.open_share = self.usual_open_share = 0.0

    def update(
        self,
        duration_s: float,
        displacement_um: float,
        depth_um: float,
        depth_u_um: float,
        open_share: float,
        *,
        sparking: bool,
    ) -> bool:
        """Take a slice; return True once, when the sheet has broken through.

        `depth_um` is the estimated depth, `depth_u_um` its standard uncertainty.
        """
        if not sparking:
            self._freeze_s, self._last_um = FREEZE_S, math.nan
            return False
        if self._freeze_s > 0.0:
            self._freeze_s -= duration_s
            return False
        last_um, self._last_um = self._last_um, displacement_um
        if math.isnan(last_um):
            return False
        self._follow(duration_s, (displacement_um - last_um) / duration_s, open_share)
        if not math.isnan(self.at_um) or self._span_s < 0.5 * BASE_S:
            return False
        if not is_near_back(depth_um, depth_u_um, self._thickness_um):
            return False
        if not self._has_opened():
            return False
        self.at_um = displacement_um
        self.message = (
            f"Broke through at {self.at_um:.1f} µm: the feed rose from {self.usual_feed_um_s:.2f} to "
            f"{self.feed_um_s:.2f} µm/s, open pulses from {100 * self.usual_open_share:.0f} to "
            f"{100 * self.open_share:.0f} %."
        )
        return True

    def on_spark_loss(self, spark_um: float, depth_um: float, depth_u_um: float, lost: str) -> bool:
        """Take the end of all discharges, the last at `spark_um`; return whether the sheet has broken through."""
        if not is_near_back(depth_um, depth_u_um, self._thickness_um):
            return False
        self.at_um, self.message = spark_um, f"Broke through at {spark_um:.1f} µm: {lost}."
        return True

    def _follow(self, duration_s: float, speed_um_s: float, open_share: float) -> None:
        """Update the exponential means of feed and open share, and their history."""
        self._seconds += duration_s
        self.feed_um_s += duration_s / min(FEED_WINDOW_S, self._seconds) * (speed_um_s - self.feed_um_s)
        self.open_share += duration_s / min(OPEN_S, self._seconds) * (open_share - self.open_share)
        self._base.append((duration_s, self.feed_um_s, self.open_share))
        self._span_s += duration_s
        while self._span_s > BASE_S:
            self._span_s -= self._base.popleft()[0]

    def _has_opened(self) -> bool:
        _, feeds, shares = zip(*self._base, strict=True)
        self.usual_feed_um_s = sorted(feeds)[len(feeds) // 2]
        self.usual_open_share = sum(shares) / len(shares)
        faster = self.feed_um_s > FEED_FACTOR * self.usual_feed_um_s
        return faster and self.open_share > self.usual_open_share + OPEN_MORE


class SparkLoss:
    """Follows the tool since the last spark.

    limit_um, limit_s : way and time of open pulses that are too much

    `spark_um` is the displacement at the last spark, NaN before the first slice.
    """

    def __init__(self, limit_um: float, limit_s: float) -> None:
        self._limit_um, self._limit_s = limit_um, limit_s
        self._open_s = 0.0
        self.spark_um = math.nan

    def update(self, duration_s: float, displacement_um: float, pulses: int, opens: int) -> str:
        """Take a slice of sparking; return the evidence when the sparks are lost, otherwise empty."""
        if opens < pulses or math.isnan(self.spark_um):
            self._open_s, self.spark_um = 0.0, displacement_um
            return ""
        self._open_s += duration_s
        way_um = displacement_um - self.spark_um
        if way_um <= self._limit_um and self._open_s <= self._limit_s:
            return ""
        return f"{self._open_s:.1f} s and {way_um:.1f} µm without a discharge, at {displacement_um:.1f} µm"
