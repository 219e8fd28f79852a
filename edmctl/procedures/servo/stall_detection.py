"""A cut that no longer advances: first a jump, then the verdict."""

from __future__ import annotations

import math

STALL_S = 60.0
"""A cut that moves less than `STALL_SHARE` of the forecast feed for so long is stalled. Our choice: six jumps."""
STALL_SHARE = 0.05
"""Of the forecast feed; bad flushing alone leaves more than half of it."""
JUMP_AFTER_S = 0.5 * STALL_S
"""Halfway there a jump is tried, whatever the recipe says of jumps."""


class Stall:
    """Follows the tool of one cut.

    forecast_feed_um_s : what it should feed
    """

    def __init__(self, forecast_feed_um_s: float) -> None:
        self._least_um = STALL_SHARE * forecast_feed_um_s * STALL_S
        self._since_s = self._since_um = math.nan
        self._tried = False
        self.jump_wanted = False
        self.told = ""

    def take(self, now_s: float, displacement_um: float) -> bool:
        """Judge where the tool is while sparking; True when the cut has stalled, `told` then says by what."""
        if math.isnan(self._since_s) or displacement_um - self._since_um > self._least_um:
            self._since_s, self._since_um = now_s, displacement_um
            self._tried = self.jump_wanted = False
            return False
        stood_s = now_s - self._since_s
        self.told = f"{displacement_um - self._since_um:.1f} µm in {stood_s:.0f} s"
        if stood_s > JUMP_AFTER_S and not self._tried:
            self._tried = self.jump_wanted = True
        return stood_s > STALL_S
