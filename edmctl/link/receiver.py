"""The receiving half of a session: bytes to frames, replies to whoever waits, reports to their subscribers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import TypeVar

from edmctl.link.frame import Frame, FrameDecoder
from edmctl.link.messages import (
    UNSOLICITED,
    Advance,
    Boot,
    Event,
    Fault,
    Heartbeat,
    HeartbeatReply,
    PulseBlocks,
    Pulses,
    Tlm,
)
from edmctl.link.statistics import Statistics
from edmctl.link.transport import MergedTlm

REPLY = 0x40
_COUNTER_WRAP = 1 << 16
_LAST_EVENT_NO = 0xFFFF
_FAR_EVENTS = 1000
"""No controller keeps so many events: a number further from the last one is none."""

MessageT = TypeVar("MessageT")


class Subscriptions:
    """Subscribers, telemetry counters, and the last event, which heartbeats acknowledge (0: none yet)."""

    def __init__(self) -> None:
        self._subscribers: dict[type, list[Callable[..., None]]] = {}
        self._next_counter: dict[type, int] = {}
        self.last_event = 0

    def begin(self, statistics: Statistics) -> None:
        """Start a session; subscribers stay."""
        self._statistics = statistics
        self.last_event = 0
        self.restart_counters()

    def restart_counters(self) -> None:
        """Take the next frame of each kind of telemetry as its first."""
        self._next_counter.clear()

    def subscribe(self, message_type: type[MessageT], callback: Callable[[MessageT], None]) -> None:
        """Call `callback` with every message of one type."""
        self._subscribers.setdefault(message_type, []).append(callback)

    def deliver(self, frame: Frame) -> None:
        """Deliver one frame of a type in UNSOLICITED."""
        try:
            message = UNSOLICITED[frame.type_id].unpack(frame.payload)
        except ValueError:
            self._statistics.malformed += 1
            return
        if isinstance(message, Tlm | PulseBlocks | Pulses):
            if not self._is_newer(message):
                self._statistics.repeated_frames += 1
                return
        elif isinstance(message, Event | Fault) and not self._is_due(message.event_no):
            return
        for callback in self._subscribers.get(type(message), ()):
            callback(message)

    def deliver_samples(self, samples: MergedTlm) -> None:
        """Deliver samples that came without frames, so that none is lost or repeated."""
        self._next_counter[Tlm] = (samples.counter + 1) % _COUNTER_WRAP
        for callback in self._subscribers.get(Tlm, ()):
            callback(samples)

    def _is_newer(self, message: Tlm | PulseBlocks | Pulses) -> bool:
        """Whether a frame is none that came before, or was overtaken; counts what is missing before it."""
        kind, counter = type(message), message.counter
        missing = (counter - self._next_counter.get(kind, counter)) % _COUNTER_WRAP
        if missing >= _COUNTER_WRAP // 2:
            return False
        self._next_counter[kind] = (counter + 1) % _COUNTER_WRAP
        if missing:
            lost = self._statistics.lost_frames
            lost[message.NAME] = lost.get(message.NAME, 0) + missing
        return True

    def _is_due(self, event_no: int) -> bool:
        # One after a gap must wait: acknowledging it would acknowledge the lost one before it.
        ahead = (event_no - self.last_event - 1) % _LAST_EVENT_NO
        if event_no == 0 or (self.last_event and _FAR_EVENTS < ahead < _LAST_EVENT_NO - _FAR_EVENTS):
            self._statistics.malformed += 1
            return False
        if self.last_event and ahead:
            self._statistics.repeated_events += 1
            return False
        self.last_event = event_no
        return True


class Receiver:
    """Takes the bytes of one session and counts what does not belong to it.

    `heard` becomes true with every sign of life of the controller; whoever looks sets it back. `others` is whether
    frames of another session have come since.
    """

    def __init__(
        self,
        session: int,
        statistics: Statistics,
        subscriptions: Subscriptions,
        on_heartbeat: Callable[[HeartbeatReply, int], None],
        on_boot: Callable[[Boot], None],
    ) -> None:
        self._session = session
        self._statistics = statistics
        self._subscriptions = subscriptions
        self._on_heartbeat = on_heartbeat
        self._on_boot = on_boot
        self._decoder = FrameDecoder(watch_for_abort=False)
        self._inbox: deque[Frame] = deque()
        self._waiting: dict[tuple[int, int], Frame | None] = {}
        self.heard = self.others = False

    def expect(self, type_id: int, seq: int) -> None:
        """Keep the reply to this command when it comes."""
        self._waiting[type_id | REPLY, seq] = None

    def reply(self, type_id: int, seq: int) -> Frame | None:
        """Return the reply to an expected command, None while there is none."""
        return self._waiting[type_id | REPLY, seq]

    def forget(self, type_id: int, seq: int) -> None:
        """Wait no longer."""
        del self._waiting[type_id | REPLY, seq]

    @property
    def pending(self) -> bool:
        """Whether frames are left that a raising subscriber kept from being handled."""
        return bool(self._inbox)

    def feed(self, data: bytes) -> None:
        """Take the next bytes."""
        self._statistics.bytes_received += len(data)
        self._inbox.extend(self._decoder.feed(data))
        self._statistics.bad_frames = self._decoder.bad

    def take_samples(self, samples: Sequence[MergedTlm]) -> None:
        """Take samples that came without frames."""
        for some in samples:
            self._statistics.frames_received += some.frames
            self._hear()
            self._subscriptions.deliver_samples(some)

    def dispatch(self) -> None:
        """Handle every frame that has come. What a subscriber raises comes out here and loses no other frame."""
        while self._inbox:
            self._dispatch(self._inbox.popleft())

    def _dispatch(self, frame: Frame) -> None:
        counts, kind = self._statistics, frame.type_id
        counts.frames_received += 1
        if kind == Boot.ID:
            self._boot(frame)
            return
        if frame.session != self._session:
            counts.other_session += 1
            self.others = True
            return
        if kind == Heartbeat.ID | REPLY:
            self._heartbeat(frame)
        elif kind in UNSOLICITED:
            self._hear()
            self._subscriptions.deliver(frame)
        elif (kind, frame.seq) in self._waiting:
            self._hear()
            self._waiting[kind, frame.seq] = frame
        elif kind == Advance.ID | REPLY:
            return  # the driven line has seen it
        elif kind & REPLY:
            counts.stray_replies += 1
        else:
            counts.unknown_types += 1

    def _hear(self) -> None:
        self.heard, self.others = True, False

    def _heartbeat(self, frame: Frame) -> None:
        try:
            reply = HeartbeatReply.unpack(frame.payload)
        except ValueError:
            self._statistics.malformed += 1
            return
        self._hear()
        self._statistics.heartbeats_answered += 1
        self._on_heartbeat(reply, frame.seq)

    def _boot(self, frame: Frame) -> None:
        try:
            boot = Boot.unpack(frame.payload)
        except ValueError:
            self._statistics.malformed += 1
            return
        self._subscriptions.deliver(frame)
        self._on_boot(boot)
