"""An adaptive servo reference: it follows the share of arcs, which is nearly the same wherever removal is the most.

A lower reference ignites more pulses and fills the gap with debris, and debris makes arcs that remove little. Where
the best of both lies moves with flushing and depth, and nobody knows it beforehand; the arcs that it comes with do
not (decision 0043).
"""

from __future__ import annotations

import math

from edmctl.procedures.servo.pulse_window import PulseWindow
from edmctl.profile.findings import REFERENCE_MARGIN
from edmctl.profile.model import Profile

WINDOW_S = 4.0
"""Arcs are counted over so long before the reference is judged: 9 000 pulses tell 8 % within 0.3 %."""
DEAD_BAND = 0.12
"""Relative difference from the target that is left alone: it costs less than 1 % of the removal."""
GAIN = 0.06
"""Change of the reference for twice the arcs, as a share of the span between all-sparking and all-open."""
LARGEST_STEP = 0.06


class ReferenceSearch:
    """Where the reference should be, by the arcs of the last seconds."""

    def __init__(self, profile: Profile, highest: float) -> None:
        assert profile.adaptive.arc_target is not None, "a loaded profile has it"
        self.target = profile.adaptive.arc_target
        """Share of arcs and shorts that is kept."""
        self.seen = math.nan
        """That of the window judged last."""
        self._span = 1.0 - profile.pulse.rho
        self._lowest, self._highest = profile.pulse.rho + REFERENCE_MARGIN, highest
        self._window = PulseWindow(WINDOW_S)

    def update(self, duration_s: float, pulses: int, arcs: int, shorts: int, reference: float) -> float:
        """Take a slice of sparking at `reference`; return which one to go on with.

        Bridges are as bad as arcs: both say that the gap is too small.
        """
        self._window.add(duration_s, pulses, arcs, shorts)
        if not self._window.is_full:
            return reference
        self.seen = self._window.arcs + self._window.shorts
        self._window.clear()
        off = math.log(max(self.seen, 0.1 * self.target) / self.target)
        if abs(off) < DEAD_BAND:
            return reference
        step = min(max(GAIN * off / math.log(2.0), -LARGEST_STEP), LARGEST_STEP) * self._span
        return min(max(reference + step, self._lowest), self._highest)
