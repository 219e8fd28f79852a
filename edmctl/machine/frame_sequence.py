"""Frames of samples and pulses one after the other: each where the one before says, and none too old.

A frame of telemetry says when its samples were taken, how many frames were sent before it and how many samples were
left out, and replies to heartbeats say what time it is. All that must agree. `docs/protocol.md` has the rules.
"""

from __future__ import annotations

from collections.abc import Sequence

from edmctl.errors import EdmError
from edmctl.link.messages import PulseBlocks, Pulses, Tlm
from edmctl.link.session import Session
from edmctl.link.transport import MergedTlm
from edmctl.machine.faults import host_fault
from edmctl.machine.requests import TelemetrySettings

OLDEST_SAMPLE_S = 1.0
"""A host whose newest sample is older than this knows too little to go on. Ten frames of 0.1 s in a row are lost by
then, which a line that loses a fifth of all frames does once in two weeks; a tool at 5 µm/s goes 5 µm meanwhile.
Of a served controller whose clock runs faster than that on the wall, a second is one on the wall."""
LATE_S = 1.0
"""Pulses that wait for a full frame come later than the samples of their time, but not by so much."""
_TICK_S = 1e-3
"""Times of pulses and of what ends a frame are known to a millisecond."""
_UNTOLD = 255
"""So many samples left out stand for any number."""
_WRAP_US = 1 << 32


class SampleStream:
    """Follows the telemetry of one session from `begin` to `end`."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._settings: TelemetrySettings | None = None
        self._last: Tlm | None = None
        self._newest_s = 0.0
        self.missing = 0

    def begin(self, settings: TelemetrySettings) -> None:
        """Telemetry has been asked for: samples are due from now on."""
        self._settings = settings
        self._last = None
        self._newest_s = self._session.heard_s

    def end(self) -> None:
        """No samples are due any more."""
        self._settings = None

    def wrong(self, frames: Sequence[Tlm]) -> str:
        """Take the next frames; return what cannot be in them, in words, and nothing where all can.

        `missing` is then the number of frames lost before and between them.
        """
        self.missing = 0
        latest_s = self._session.latest_s
        for frame in frames:
            end_s = self._end_s(frame)
            if reason := self._wrong_frame(frame, end_s, end_s - latest_s):
                return reason
            self._last, self._newest_s = frame, end_s
        return ""

    def age_s(self, arrived: Sequence[Tlm] = ()) -> float:
        """Return how old the newest sample is, 0 where none is due; `arrived` has frames not yet taken."""
        if self._settings is None:
            return 0.0
        newest_s = max(self._newest_s, self._end_s(arrived[-1])) if arrived else self._newest_s
        return self._session.heard_s - newest_s

    def too_old(self, arrived: Sequence[Tlm]) -> EdmError | None:
        """Return the fault of samples that have stayed away; None while there are some, or none are due."""
        age_s = self.age_s(arrived)
        if age_s <= OLDEST_SAMPLE_S * self._session.pace:
            return None
        return host_fault("SAMPLES_LOST", f" (the newest is {age_s:.1f} s old)")

    def _wrong_frame(self, frame: Tlm, end_s: float, ahead_s: float) -> str:
        settings, last = self._settings, self._last
        frames = frame.frames if isinstance(frame, MergedTlm) else 1
        if frame.n == 0:
            return "TLM without samples"
        if settings is not None and (
            frame.period_us != settings.period_us or frame.n > settings.batch * frames
        ):
            return (
                f"TLM with {frame.n} samples {frame.period_us} µs apart, asked for were {settings.batch} "
                f"samples {settings.period_us} µs apart"
            )
        if ahead_s > 0.0:
            return f"samples {ahead_s:.1f} s ahead of the controller's own time"
        if last is None:
            behind_s = self._newest_s - end_s
            return f"first samples of {behind_s:.1f} s before" if behind_s > OLDEST_SAMPLE_S else ""
        missing = (frame.counter - frames - last.counter) & 0xFFFF
        self.missing += missing
        due_us = last.t0_us + last.n * frame.period_us
        # The 32-bit times start over, so the difference is signed.
        skipped_us = (frame.t0_us - due_us + _WRAP_US // 2) % _WRAP_US - _WRAP_US // 2
        most = missing * (settings.batch if settings else 0) + frame.dropped
        if skipped_us < (missing + frame.dropped - 0.5) * frame.period_us:
            return f"samples {-1e-3 * skipped_us:.0f} ms before they are due"
        if frame.dropped < _UNTOLD and skipped_us > (most + 0.5) * frame.period_us:
            return f"samples {1e-3 * skipped_us:.0f} ms after they were due, {most} of them lost"
        return ""

    def _end_s(self, frame: Tlm) -> float:
        return self._session.seconds(frame.t0_us) + 1e-6 * frame.period_us * (frame.n - 1)


class PulseFrames:
    """Follows the frames of one kind since telemetry has begun."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._newest_s = 0.0

    def begin(self) -> None:
        """Telemetry has been asked for."""
        self._newest_s = self._session.heard_s - LATE_S

    def wrong(self, frames: Sequence[PulseBlocks | Pulses]) -> str:
        """Take the next frames; return what cannot be in them, in words, and nothing where all can."""
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
