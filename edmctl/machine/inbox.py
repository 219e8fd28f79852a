"""What the controller sent and nobody has handled yet: samples, pulses, events, a fault."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from edmctl.errors import EdmError
from edmctl.link.messages import Event, EventCode, Fault, Log, PulseBlocks, Pulses, Tlm
from edmctl.link.session import Session
from edmctl.link.transport import MergedTlm
from edmctl.machine.decode import ToSeconds, pulse_batches, pulse_block_batch, telemetry_block
from edmctl.machine.faults import host_fault
from edmctl.machine.interface import (
    MachineEvent,
    MachineListener,
    MachineState,
    TelemetryBlock,
    TelemetrySettings,
)
from edmctl.machine.plausibility import (
    impossible,
    wrong_block,
    wrong_blocks,
    wrong_event,
    wrong_fault,
    wrong_pulses,
)

_PULSE_FRAMES = 16
"""Pulse frames gathered before they are handed on: they are only recorded, so they may wait."""
LATE_S = 0.4
"""Samples that stay away for so long shorten the waits in virtual time, which last 0.5 s."""
OLDEST_EVENT_S = 70.0
"""A touch is reported after its dwell, 65 s at most, and a report that got lost is sent again every 100 ms."""
OLDEST_SAMPLE_S = 1.0
"""A host whose newest sample is older than this knows too little to go on. Ten frames of 0.1 s in a row are lost by
then, which a line that loses a fifth of all frames does once in two weeks; a tool at 5 µm/s goes 5 µm meanwhile.
Of a served controller whose clock runs faster than that on the wall, a second is one on the wall."""
LATEST_PULSES_S = 1.0
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
        self._newest_s = self._session.heard_s - LATEST_PULSES_S

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


class Inbox:
    """Collects unsolicited messages while the session reads, and hands them to the listener between reads.

    Nothing but collecting happens inside the session's callbacks, so an error of a listener (a full disk)
    surfaces in the procedure that waits and never in the middle of a frame.

    `events` holds what no wait has taken yet; `news` is set by every event and fault, for the waits to clear. Of
    what cannot be, nothing is handed on: `lie` is the fault of the first of it. `state` is that of the newest
    sample, and `state_since_s` the time of the first block that ended with it.
    """

    def __init__(self, session: Session, to_seconds: ToSeconds) -> None:
        self._session = session
        self._to_seconds = to_seconds
        self._telemetry: list[Tlm] = []
        self._blocks: list[PulseBlocks] = []
        self._pulses: list[Pulses] = []
        self._logs: list[Log] = []
        self._unheard: list[MachineEvent] = []
        self._stream = SampleStream(session)
        self._block_frames, self._pulse_frames = PulseFrames(session), PulseFrames(session)
        self._malformed = session.statistics.malformed
        self.events: list[MachineEvent] = []
        self._gathered: list[TelemetryBlock] | None = None
        self.fault: Fault | None = None
        self.lie: EdmError | None = None
        self.news = False
        self.time_s = 0.0
        self.state, self.state_since_s = int(MachineState.BOOT), 0.0
        session.subscribe(Tlm, self._telemetry.append)
        session.subscribe(PulseBlocks, self._blocks.append)
        session.subscribe(Pulses, self._pulses.append)
        session.subscribe(Log, self._logs.append)
        session.subscribe(Event, self._on_event)
        session.subscribe(Fault, self._on_fault)

    def _on_event(self, message: Event) -> None:
        if problem := wrong_event(message) or self._wrong_time(message):
            self._doubt(problem)
            return
        event = MachineEvent(
            code=EventCode(message.code),
            time_s=self._to_seconds(message.t_us),
            argument=message.arg,
            displacement_um=message.displacement_um,
            actuator_v=message.actuator_v,
        )
        self.news = True
        self.events.append(event)
        self._unheard.append(event)

    def _on_fault(self, message: Fault) -> None:
        if problem := wrong_fault(message):
            self._doubt(problem)
            return
        self.news = True
        if self.fault is None:
            self.fault = message

    def _wrong_time(self, message: Event) -> str:
        time_s, heard_s = self._session.seconds(message.t_us), self._session.heard_s
        if heard_s - OLDEST_EVENT_S <= time_s <= self._session.latest_s:
            return ""
        return f"EVENT {EventCode(message.code).name} {time_s - heard_s:+.0f} s from now"

    def _doubt(self, problem: str) -> None:
        self.news = True
        if self.lie is None:
            self.lie = impossible(problem)

    def begin_telemetry(self, settings: TelemetrySettings) -> None:
        """Telemetry has been asked for; its next frame is the first."""
        self._stream.begin(settings)
        self._block_frames.begin()
        self._pulse_frames.begin()

    def end_telemetry(self) -> None:
        """Telemetry is over."""
        self._stream.end()

    @contextmanager
    def gathering(self) -> Iterator[list[TelemetryBlock]]:
        """Keep every block that is handed on, while the context lasts."""
        self._gathered = []
        try:
            yield self._gathered
        finally:
            self._gathered = None

    @property
    def samples_are_late(self) -> bool:
        """Whether no samples have come for `LATE_S`."""
        return self._stream.age_s() > LATE_S

    def doubts(self) -> EdmError | None:
        """Return the fault of what has come, or has stayed away: the controller lies, or its samples are lost."""
        self._session.take_samples()
        malformed = self._session.statistics.malformed
        if malformed > self._malformed:
            self._doubt(
                f"{malformed - self._malformed} frames with the right checksum say what no message can"
            )
            self._malformed = malformed
        return self.lie or self._stream.too_old(self._telemetry)

    def deliver(self, listener: MachineListener, *, everything: bool = False) -> None:
        """Hand on what has come in; `everything` also empties the pulse buffers."""
        self._session.take_samples()
        if self._telemetry:
            self._deliver_telemetry(listener)
        for event in self._unheard:
            listener.event(event)
            self.time_s = max(self.time_s, event.time_s)
        self._unheard.clear()
        for line in self._logs:
            listener.log(line.level, line.text)
        self._logs.clear()
        threshold = 1 if everything else _PULSE_FRAMES
        if len(self._blocks) >= threshold:
            self._deliver_blocks(listener)
        if len(self._pulses) >= threshold:
            self._deliver_pulses(listener)

    def _deliver_telemetry(self, listener: MachineListener) -> None:
        frames = self._telemetry.copy()
        self._telemetry.clear()
        if problem := self._stream.wrong(frames):
            self._doubt(problem)
            return
        block = telemetry_block(frames, self._to_seconds, self._stream.missing)
        if problem := wrong_block(block):
            self._doubt(problem)
            return
        self.time_s = float(block.time_s[-1])
        if block.state.item(-1) != self.state:
            self.state, self.state_since_s = block.state.item(-1), self.time_s
        if self._gathered is not None:
            self._gathered.append(block)
        listener.telemetry(block)

    def _deliver_blocks(self, listener: MachineListener) -> None:
        frames = self._blocks.copy()
        self._blocks.clear()
        if problem := self._block_frames.wrong(frames):
            self._doubt(problem)
            return
        batch = pulse_block_batch(frames, self._to_seconds)
        if problem := wrong_blocks(batch, frames[0].block_pulses):
            self._doubt(problem)
            return
        listener.pulse_blocks(batch)

    def _deliver_pulses(self, listener: MachineListener) -> None:
        frames = self._pulses.copy()
        self._pulses.clear()
        if problem := self._pulse_frames.wrong(frames):
            self._doubt(problem)
            return
        for train in pulse_batches(frames, self._to_seconds):
            if problem := wrong_pulses(train):
                self._doubt(problem)
                return
            listener.pulses(train)
