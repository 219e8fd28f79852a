"""Whether frames of pulses, or of sums over them, can be: none empty, and one after the other in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.link.messages import PulseBlocks, Pulses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.link.session import Session

LATE_S = 1.0
"""Pulses that wait for a full frame come later than the samples of their time, but not by so much."""
_TICK_S = 1e-3
"""Times of pulses and of what ends a frame are known to a millisecond."""


class PulseFrames:
    """Follows the frames of one kind since telemetry has begun."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._newest_s = 0.0

    def begin(self) -> None:
        """Telemetry has been asked for."""
        self._newest_s = self._session.heard_s - LATE_S

    def wrong(self, frames: Sequence[PulseBlocks | Pulses]) -> str:
        """Take the next frames; what cannot be in them, in words, and nothing where all can."""
        for frame in frames:
            step = frame.block_pulses if isinstance(frame, PulseBlocks) else 1
            if frame.n == 0 or frame.period_ns == 0 or step == 0:
                return f"{frame.NAME} with {frame.n} records of {step} pulses {frame.period_ns} ns apart"
            start_s = self._session.seconds(frame.t0_us)
            end_s = start_s + 1e-9 * frame.period_ns * step * (frame.n - 1)
            if end_s > self._session.latest_s:
                return (
                    f"{frame.NAME} {end_s - self._session.latest_s:.1f} s ahead of the controller's own time"
                )
            if start_s < self._newest_s - _TICK_S:
                return f"{frame.NAME} {self._newest_s - start_s:.3f} s before the one before"
            self._newest_s = start_s
        return ""
