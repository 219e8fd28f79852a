"""One conversation with one controller: commands and replies, heartbeats, and what the controller reports.

Nothing here runs by itself: bytes are read, heartbeats sent and subscribers called while the caller waits in
`request`, `pump` or `pump_until`, so that a host that hangs also falls silent.
"""

from __future__ import annotations

from collections import deque
from math import inf
from random import Random, SystemRandom
from typing import TYPE_CHECKING, TypeVar

from edmctl.errors import LinkLost, ProtocolMismatch
from edmctl.link.accounting import ControllerClock, Statistics
from edmctl.link.compatibility import check_hello
from edmctl.link.frame import ABORT, Frame, FrameDecoder, encode_frame
from edmctl.link.messages import (
    PROTO_MAJOR,
    PROTO_MINOR,
    SCHEMA_HASH,
    UNSOLICITED,
    Boot,
    Heartbeat,
    HeartbeatReply,
    Hello,
    HelloReply,
    Status,
    TlmStart,
)
from edmctl.link.refusal import CommandRefused, refusal
from edmctl.link.reports import Reports

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.link.transport import Transport
    from edmctl.link.wire import Request

__all__ = ["DEADLINE_S", "HEARTBEAT_S", "SILENCE_S", "CommandRefused", "Session"]

HEARTBEAT_S = 0.05
DEADLINE_S = 0.75
"""Longest wait for the reply to a command."""
SILENCE_S = 0.5
"""A controller that leaves heartbeats unanswered for so long is gone."""
_REPLY = 0x40
# Waits shorter than this are over; a clock need not be able to move by less.
_CLOCK_TICK_S = 1e-6

ReplyT = TypeVar("ReplyT")
MessageT = TypeVar("MessageT")


class Session:
    """Commands to and reports from one controller.

    `random_source` chooses the session byte and the nonce. `heartbeat_s` is how often the controller hears
    from a host that has nothing to say: a line that loses frames wants several within the watchdog's time.
    """

    def __init__(
        self, transport: Transport, random_source: Random | None = None, heartbeat_s: float = HEARTBEAT_S
    ) -> None:
        self.transport = transport
        self._heartbeat_s = heartbeat_s
        self._random = random_source or SystemRandom()
        self._reports = Reports()
        self._begin(0)

    def _begin(self, session: int) -> None:
        self.statistics = Statistics()
        self.last_heartbeat: HeartbeatReply | None = None
        self._session = session
        self._hello: HelloReply | None = None
        self._is_open = False
        self._lost: LinkLost | None = None
        self._seq = 0
        self._decoder = FrameDecoder(watch_for_abort=False)
        self._inbox: deque[Frame] = deque()
        self._waiting: dict[tuple[int, int], Frame | None] = {}
        self._next_beat_s = inf
        self._unanswered_since_s = inf
        self._clock = ControllerClock()
        self._reports.begin(self.statistics)

    def open(self) -> HelloReply:
        """Open a new session.

        Raises
        ------
        ProtocolMismatch
            The controller speaks another version or has another schema.
        LinkLost
            Nothing answers.
        """
        self._begin(self._random.randrange(1, 256))
        hello = Hello(PROTO_MAJOR, PROTO_MINOR, self._random.getrandbits(32), SCHEMA_HASH)
        frame = self._exchange(hello)
        check_hello(frame.payload, self.transport.name)
        if frame.flags != Status.OK:
            raise refusal(hello.ID, frame)
        reply = _unpack_reply(hello, frame)
        if reply.host_nonce != hello.host_nonce:
            raise self._lose("The answer to HELLO was meant for another host.", "Close the other program.")
        self._hello = reply
        self._is_open = True
        self._next_beat_s = self.transport.now_s()
        if not self.pump_until(lambda: self.last_heartbeat is not None, DEADLINE_S):
            raise self._lose(*_no_answer("HEARTBEAT", self.transport.name))
        return reply

    @property
    def hello(self) -> HelloReply:
        """What the controller said of itself when the session opened; LinkLost before that."""
        if self._hello is None:
            raise LinkLost("The session is not open.", hint="Open it first.")
        return self._hello

    def request(self, message: Request[ReplyT]) -> ReplyT:
        """Send a command and return its reply; other messages that come meanwhile reach their subscribers.

        Raises
        ------
        CommandRefused
            The controller answered with a status other than OK.
        LinkLost
            No answer within 750 ms, or the controller restarted.
        """
        frame = self._exchange(message)
        if frame.flags != Status.OK:
            raise refusal(message.ID, frame)
        if message.ID == TlmStart.ID:
            self._reports.restart_counters()
        return _unpack_reply(message, frame)

    def pump(self, duration_s: float) -> None:
        """Read and dispatch for `duration_s`. What a subscriber raises comes out here and loses no frame."""
        self.pump_until(lambda: False, duration_s)

    def pump_until(self, predicate: Callable[[], bool], timeout_s: float) -> bool:
        """Read and dispatch until `predicate` holds; return False where it does not within `timeout_s`."""
        end_s = self.transport.now_s() + timeout_s
        while not predicate():
            now_s = self.transport.now_s()
            if end_s - now_s < _CLOCK_TICK_S:
                return False
            self._step(now_s, end_s)
            if now_s - self._unanswered_since_s > SILENCE_S:
                raise self._lose(
                    f"The controller at {self.transport.name} fell silent for {SILENCE_S * 1000:.0f} ms.",
                    "Check cable and supply; the controller has switched the pulses off by itself.",
                )
        return True

    def subscribe(self, message_type: type[MessageT], callback: Callable[[MessageT], None]) -> None:
        """Call `callback` with every message of one type that the controller sends by itself."""
        self._reports.subscribe(message_type, callback)

    def seconds(self, t_us: int) -> float:
        """Return controller time in seconds of the 32-bit time that a message just received carries."""
        return self._clock.seconds(t_us)

    def abort(self) -> None:
        """Send the abort run: pulses off and tool retracted, in whatever state line and controller are."""
        self.transport.write(ABORT)

    def close(self) -> None:
        """Give the line back. The controller's watchdog ends whatever still runs."""
        self._is_open = False
        self.transport.close()

    def _exchange(self, message: Request[ReplyT]) -> Frame:
        """Send a command once and wait for its reply of any status."""
        if self._lost is not None:
            raise self._lost
        key = (message.ID | _REPLY, self._send(message.ID, message.pack()))
        self._waiting[key] = None
        deadline_s = self.transport.now_s() + DEADLINE_S
        try:
            while (frame := self._waiting[key]) is None:
                now_s = self.transport.now_s()
                if deadline_s - now_s < _CLOCK_TICK_S:
                    raise self._lose(*_no_answer(message.NAME, self.transport.name))
                self._step(now_s, deadline_s)
        finally:
            del self._waiting[key]
        return frame

    def _send(self, type_id: int, payload: bytes) -> int:
        seq = self._seq
        self._seq = (seq + 1) & 0xFF
        self.statistics.frames_sent += 1
        self.transport.write(encode_frame(type_id, seq, self._session, 0, payload))
        return seq

    def _beat(self, now_s: float) -> None:
        self._send(Heartbeat.ID, Heartbeat(int(now_s * 1e6), self._reports.last_event).pack())
        # A host that was away itself cannot blame the controller for the silence.
        was_away = now_s - self._next_beat_s > self._heartbeat_s
        self._unanswered_since_s = now_s if was_away else min(self._unanswered_since_s, now_s)
        self._next_beat_s = now_s + self._heartbeat_s
        self.statistics.heartbeats_sent += 1

    def _step(self, now_s: float, until_s: float) -> None:
        """Heartbeat if one is due, then one read that ends before the next is."""
        if self._lost is not None:
            raise self._lost
        if self._next_beat_s - now_s < _CLOCK_TICK_S:
            self._beat(now_s)
        # A subscriber that raised has left frames behind; they come before new bytes.
        if not self._inbox:
            data = self.transport.read(max(min(until_s, self._next_beat_s) - now_s, 0.0))
            if not data:
                return
            self._inbox.extend(self._decoder.feed(data))
            self.statistics.bad_frames = self._decoder.bad
        while self._inbox:
            self._dispatch(self._inbox.popleft())

    def _dispatch(self, frame: Frame) -> None:
        self.statistics.frames_received += 1
        kind = frame.type_id
        if kind == Boot.ID:
            self._on_boot(frame)
        elif frame.session != self._session:
            self.statistics.other_session += 1
        elif kind == Heartbeat.ID | _REPLY:
            self._on_heartbeat(frame)
        elif kind in UNSOLICITED:
            self._unanswered_since_s = inf
            self._reports.take(frame)
        elif (kind, frame.seq) in self._waiting:
            self._unanswered_since_s = inf
            self._waiting[kind, frame.seq] = frame
        elif kind & _REPLY:
            self.statistics.stray_replies += 1
        else:
            self.statistics.unknown_types += 1

    def _on_heartbeat(self, frame: Frame) -> None:
        try:
            reply = HeartbeatReply.unpack(frame.payload)
        except ValueError:
            self.statistics.malformed += 1
            return
        self._unanswered_since_s = inf
        self.statistics.heartbeats_answered += 1
        self.last_heartbeat = reply
        self._clock.note(reply.t_dev_us)

    def _on_boot(self, frame: Frame) -> None:
        # A controller that boots because the port was opened says so before it answers HELLO.
        if not self._is_open:
            return
        try:
            boot = Boot.unpack(frame.payload)
        except ValueError:
            self.statistics.malformed += 1
            return
        self._reports.take(frame)
        raise self._lose(
            f"The controller restarted (reset cause {boot.reset_cause}, boot {boot.boot_count}).",
            "Check the controller's supply; home and measure again before machining.",
        )

    def _lose(self, message: str, hint: str) -> LinkLost:
        self._is_open = False
        self._next_beat_s = inf
        self._lost = LinkLost(message, hint=hint)
        return self._lost


def _unpack_reply(message: Request[ReplyT], frame: Frame) -> ReplyT:
    try:
        return message.unpack_reply(frame.payload)
    except ValueError as error:
        raise ProtocolMismatch(
            f"The controller's reply cannot be read: {error}.", hint="Update the controller's firmware."
        ) from error


def _no_answer(name: str, line: str) -> tuple[str, str]:
    return (
        f"The controller at {line} did not answer {name} within {DEADLINE_S * 1000:.0f} ms.",
        "Check that the controller is on and that the cable and the port are the right ones.",
    )
