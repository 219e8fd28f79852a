"""One conversation with one controller: commands and replies, heartbeats, and what the controller reports.

Bytes are read and subscribers called only while the caller waits in `request`, `pump` or `pump_until`. Where time
is virtual, heartbeats are sent there as well; on a live line they have a thread of their own, which falls silent
when the caller does not come back. A `VirtualLine` keeps the watchdog from acting while the host reads: there
heartbeats only acknowledge events and set the clock.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from random import Random, SystemRandom
from threading import RLock
from typing import TypeVar

from edmctl import failures
from edmctl.errors import LinkLost
from edmctl.link.clock import ClockFit, ControllerClock
from edmctl.link.compatibility import UPDATE, Introduction, check_hello, introduction
from edmctl.link.frame import ABORT, Frame, encode_frame
from edmctl.link.heartbeat import HeartbeatThread
from edmctl.link.link_errors import CommandRefused, nak_error, restarted, unanswered
from edmctl.link.messages import (
    PROTO_MAJOR,
    PROTO_MINOR,
    SCHEMA_HASH,
    Boot,
    Clock,
    Heartbeat,
    HeartbeatReply,
    Hello,
    HelloReply,
    Status,
    TlmStart,
)
from edmctl.link.receiver import Receiver, Subscriptions
from edmctl.link.statistics import LONGEST_S, RetransmitTimer, Statistics, link_report
from edmctl.link.transport import SteppedLine, Transport, VirtualLine
from edmctl.link.wire import Request
from edmctl.results.telemetry import LinkReport

__all__ = ["DEADLINE_S", "HEARTBEAT_S", "LATE_BEAT_S", "SILENCE_S", "CommandRefused", "Session"]

HEARTBEAT_S = 0.05
VIRTUAL_BEAT_S = 0.1
"""On a `VirtualLine` a heartbeat goes before a read where the last one is so old."""
LATE_BEAT_S = 0.2
"""A heartbeat that is later by this means that the host was away."""
DEADLINE_S = 0.75
"""Longest wait for the reply to a command, all its repetitions included."""
SILENCE_S = 0.5
"""A controller that leaves heartbeats unanswered for so long is gone."""
SPARE_S, SPARE_SHARE = 1.0, 1.5
"""By this, and this share of the time since the last heartbeat, the controller's time may be beyond the expected."""
FIRST_BEATS, FIRST_BEATS_APART_S = 8, 0.02
"""A live line begins with these, for the clock fit."""
_LOOK_S, _LAST_LOOK_S = 0.25, 0.05
# Waits shorter than this are over; a clock need not be able to move by less.
_CLOCK_TICK_S = 1e-6
_NEVER_US = -1
_NO_SCHEMA = 0xFFFF_FFFF
"""What makes of this program's schema hash one that nobody has."""

ReplyT = TypeVar("ReplyT")
MessageT = TypeVar("MessageT")


class Session:
    """Commands to and reports from one controller.

    `random_source` chooses session byte and nonce. In virtual time the first two heartbeats are `first_beat_s`
    apart.
    """

    def __init__(
        self, transport: Transport, random_source: Random | None = None, first_beat_s: float = HEARTBEAT_S
    ) -> None:
        self.transport = self._line = transport
        self._first_beat_s = first_beat_s
        self._virtual = transport if isinstance(transport, VirtualLine) else None
        self._random = random_source or SystemRandom()
        self._subscriptions = Subscriptions()
        self._writing = RLock()
        self._pulse: HeartbeatThread | None = None
        self._begin(0)

    def _begin(self, session: int) -> None:
        self.statistics = Statistics()
        self.last_heartbeat: HeartbeatReply | None = None
        self._session = session
        self._hello: HelloReply | None = None
        self._is_open = False
        self._lost: LinkLost | None = None
        self._seq = self._beat_seq = self._acknowledged = 0
        self._beats_us = [_NEVER_US] * 256
        self._next_beat_s = inf
        self._unanswered_since_s = inf
        self._moved_s = 0.0
        self._clock = ControllerClock()
        self._fit = ClockFit()
        self._retransmit_timer = RetransmitTimer()
        self._subscriptions.begin(self.statistics)
        self._receiver = Receiver(
            session, self.statistics, self._subscriptions, self._on_heartbeat, self._on_boot
        )

    def open(self, patience_s: float = DEADLINE_S) -> HelloReply:
        """Open a new session; a board that resets when its port is opened needs `patience_s` to come up.

        Raises
        ------
        ProtocolMismatch
            The controller speaks another version or has another schema.
        LinkLost
            Nothing answers, or something that is no controller.
        """
        self._end_heartbeats()
        self.transport = self._line
        self._begin(self._random.randrange(1, 256))
        hello = Hello(PROTO_MAJOR, PROTO_MINOR, self._random.getrandbits(32), SCHEMA_HASH)
        frame = self._exchange(hello, patience_s)
        check_hello(frame.payload, self.transport.name, self.request)
        if frame.flags != Status.OK:
            raise nak_error(hello.ID, frame)
        reply = _unpack_reply(hello, frame)
        if reply.host_nonce != hello.host_nonce:
            raise self._lose(failures.answer_for_another_host(name=self.transport.name))
        self._hello = reply
        if self._virtual is not None:
            self._virtual.samples()  # those of an earlier session
        if reply.clock == Clock.DRIVEN:
            self.transport = SteppedLine(self.transport, self._session)
        self._is_open = True
        self._first_heartbeats()
        return reply

    def introduction(self, patience_s: float = DEADLINE_S) -> Introduction:
        """Return what the controller says of itself to a host of another schema: that opens and ends no session.

        A controller that is armed stays so, and its host goes on (docs/protocol.md, Session).

        Raises ProtocolMismatch for what does not speak EDM Link, LinkLost where nothing answers.
        """
        self._end_heartbeats()
        self.transport = self._line
        self._begin(self._random.randrange(1, 256))
        stranger = Hello(PROTO_MAJOR, PROTO_MINOR, self._random.getrandbits(32), SCHEMA_HASH ^ _NO_SCHEMA)
        frame = self._exchange(stranger, patience_s)
        return introduction(frame.payload, self.transport.name, self.request)

    @property
    def hello(self) -> HelloReply:
        """What the controller said of itself when the session opened; LinkLost before that."""
        if self._hello is None:
            raise failures.session_not_open()
        return self._hello

    def request(self, message: Request[ReplyT]) -> ReplyT:
        """Send a command and return its reply; other messages that come meanwhile reach their subscribers.

        The command is sent again, as the same command, until it is answered: the controller executes it once.

        Raises
        ------
        CommandRefused
            The controller answered with a status other than OK.
        LinkLost
            No answer within 750 ms, or the controller restarted.
        """
        frame = self._exchange(message)
        if frame.flags != Status.OK:
            raise nak_error(message.ID, frame)
        if message.ID == TlmStart.ID:
            self._subscriptions.restart_counters()
        return _unpack_reply(message, frame)

    def pump(self, duration_s: float) -> None:
        """Read and dispatch for `duration_s`. What a subscriber raises comes out here and loses no frame."""
        self.pump_until(lambda: False, duration_s)

    def pump_until(self, predicate: Callable[[], bool], timeout_s: float, *, wakes: bool = False) -> bool:
        """Read and dispatch until `predicate` holds; False where it did not in `timeout_s` of controller time.

        With `wakes` a wait in virtual time also ends, with False, when the controller has cut a read short: it has
        sent what its host has to see at once.
        """
        end_s = self.transport.now_s() + timeout_s / self._rate
        while not predicate():
            now_s = self.transport.now_s()
            if end_s - now_s < _CLOCK_TICK_S:
                return False
            woken = self._step(now_s, end_s if self._is_watched else min(end_s, now_s + _LOOK_S))
            if self._is_silent():
                # As above: what came meanwhile may not have been read yet.
                now_s = self.transport.now_s()
                self._step(now_s, now_s + self._last_look_s)
            if self._is_silent():
                raise self._give_up(
                    failures.controller_silent(name=self.transport.name, silence_s=1000 * SILENCE_S)
                )
            if wakes and woken:
                return predicate()
        return True

    def subscribe(self, message_type: type[MessageT], callback: Callable[[MessageT], None]) -> None:
        """Call `callback` with every message of one type that the controller sends by itself."""
        self._subscriptions.subscribe(message_type, callback)

    def fall_silent(self, duration_s: float) -> None:
        """Read for `duration_s` and send nothing, as a host that is gone: the controller's watchdog is to notice."""
        self._end_heartbeats()
        self._next_beat_s, end_s = inf, self.transport.now_s() + duration_s / self._rate
        try:
            while end_s - (now_s := self.transport.now_s()) >= _CLOCK_TICK_S:
                self._step(now_s, min(end_s, now_s + _LOOK_S))
        finally:
            self._next_beat_s = inf if self.transport.live else self.transport.now_s()
            self._start_heartbeats()

    def catch_up(self) -> None:
        """Read and dispatch what waits on a live line; where time is virtual nothing can."""
        if self.transport.live:
            now_s = self.transport.now_s()
            self._step(now_s, now_s)

    def take_samples(self) -> None:
        """Dispatch the samples that a transport has kept apart from its bytes."""
        if self._virtual is not None:
            self._receiver.take_samples(self._virtual.samples())

    def seconds(self, t_us: int) -> float:
        """Return controller time in seconds of the 32-bit time that a message just received carries."""
        return self._clock.seconds(t_us)

    @property
    def heard_s(self) -> float:
        """Controller time of the newest reply to a heartbeat, in seconds."""
        return self._clock.newest_s

    @property
    def _knows_pace(self) -> bool:
        """Whether enough heartbeats have told how fast the controller's clock goes."""
        return self._fit.is_sure or not self.transport.live

    @property
    def latest_s(self) -> float:
        """Latest controller time that a message read now can carry, in seconds; infinite before its rate is known.

        It is that of the newest reply to a heartbeat and what has passed since that was sent, for the reply may
        have waited long to be read; with much to spare, for a served controller keeps its pace only roughly.
        """
        beat = self.last_heartbeat
        if beat is None or not self._knows_pace:
            return inf
        since_s = self.transport.now_s() - 1e-6 * beat.t_host_us
        return self._clock.newest_s + self.pace * (SPARE_SHARE * since_s + SPARE_S)

    def machine_now_s(self) -> float:
        """Return controller time now, in seconds: by the clock fit on a live line."""
        host_s = self.transport.now_s()
        return self._fit.line.at(host_s) if self.transport.live else host_s

    def link_report(self) -> LinkReport:
        """Return how the line did since the session opened."""
        return link_report(self.statistics, self.last_heartbeat, self._retransmit_timer, self._fit.line)

    def abort(self) -> None:
        """Send the abort run: pulses off and tool retracted, in whatever state line and controller are."""
        self.transport.write(ABORT)

    def close(self) -> None:
        """Give the line back. The controller's watchdog ends whatever still runs."""
        self._is_open = False
        self._end_heartbeats()
        self.transport.close()

    @property
    def _rate(self) -> float:
        """Controller seconds per second of the line's clock."""
        return self._fit.line.rate if self.transport.live else 1.0

    @property
    def pace(self) -> float:
        """The same, at least 1: how much more of the controller's time passes while a computer is held up."""
        return max(1.0, self._rate)

    @property
    def _is_watched(self) -> bool:
        """Whether the controller hears its host without heartbeats."""
        return self._virtual is not None and self._virtual.is_watched

    @property
    def _last_look_s(self) -> float:
        """How long the reader of a live line gets to hand over what came while the host was away."""
        return _LAST_LOOK_S if self.transport.live else 0.0

    def _is_silent(self) -> bool:
        return self.transport.now_s() - self._unanswered_since_s > SILENCE_S

    def _first_heartbeats(self) -> None:
        if self.transport.live:
            for _ in range(FIRST_BEATS):
                self._beat(self.transport.now_s())
                self.pump_until(lambda: False, FIRST_BEATS_APART_S)
        else:
            self._beat(self.transport.now_s())
            self._next_beat_s = self.transport.now_s() + self._first_beat_s
        if not self.pump_until(lambda: self.last_heartbeat is not None, DEADLINE_S):
            heartbeat = Heartbeat(0, 0)
            raise self._lose(unanswered(self.transport.name, heartbeat, DEADLINE_S, self.statistics))
        self._start_heartbeats()

    def _start_heartbeats(self) -> None:
        if self._virtual is not None:
            self._virtual.watch(watched=True)
        if not self.transport.live:
            return
        now_s = self.transport.now_s
        self._pulse = HeartbeatThread(
            lambda: self._beat(now_s()), lambda: now_s() - self._moved_s, HEARTBEAT_S
        )
        self._pulse.start()

    def _end_heartbeats(self) -> None:
        if self._virtual is not None:
            self._virtual.watch(watched=False)
        pulse, self._pulse = self._pulse, None
        if pulse is not None:
            pulse.stop()

    def _exchange(self, message: Request[ReplyT], patience_s: float = DEADLINE_S) -> Frame:
        """Send a command, again and again until its reply of any status comes."""
        if self._lost is not None:
            raise self._lost
        seq, self._seq = self._seq, (self._seq + 1) & 0xFF
        payload = message.pack()
        self._receiver.expect(message.ID, seq)
        try:
            start_s = now_s = self.transport.now_s()
            deadline_s, wait_s = start_s + patience_s, self._retransmit_timer.timeout_s
            self._send(message.ID, seq, payload)
            again_s, repeated = start_s + wait_s, False
            while (frame := self._receiver.reply(message.ID, seq)) is None:
                now_s = self.transport.now_s()
                if deadline_s - now_s < _CLOCK_TICK_S:
                    # A host that was away itself may find the reply waiting.
                    self._step(now_s, now_s + self._last_look_s)
                    if (frame := self._receiver.reply(message.ID, seq)) is not None:
                        break
                    raise self._give_up(unanswered(self.transport.name, message, patience_s, self.statistics))
                if again_s - now_s < _CLOCK_TICK_S:
                    wait_s = min(LONGEST_S, 2.0 * wait_s)
                    again_s, repeated = now_s + wait_s, True
                    self.statistics.retries += 1
                    self._send(message.ID, seq, payload)
                self._step(now_s, min(deadline_s, again_s))
            if not repeated:
                self._retransmit_timer.note(self.transport.now_s() - start_s)
        finally:
            self._receiver.forget(message.ID, seq)
        return frame

    def _send(self, type_id: int, seq: int, payload: bytes) -> None:
        with self._writing:
            self.statistics.frames_sent += 1
            self.transport.write(encode_frame(type_id, seq, self._session, 0, payload))

    def _beat(self, now_s: float) -> None:
        with self._writing:
            seq, self._beat_seq = self._beat_seq, (self._beat_seq + 1) & 0xFF
            self._acknowledged = self._subscriptions.last_event
            self._beats_us[seq] = int(now_s * 1e6)
            self._send(Heartbeat.ID, seq, Heartbeat(self._beats_us[seq], self._acknowledged).pack())
        # A host that was away itself cannot blame the controller for the silence.
        was_away = now_s - self._next_beat_s > LATE_BEAT_S
        self._unanswered_since_s = now_s if was_away else min(self._unanswered_since_s, now_s)
        if not self.transport.live:
            self._next_beat_s = now_s + (VIRTUAL_BEAT_S if self._is_watched else HEARTBEAT_S)
        self.statistics.heartbeats_sent += 1

    def _step(self, now_s: float, until_s: float) -> bool:
        """Heartbeat if one is due, then read until the next; return whether virtual time stopped early."""
        if self._lost is not None:
            raise self._lost
        self._moved_s = now_s
        if self._next_beat_s - now_s < _CLOCK_TICK_S:
            self._beat(now_s)
        if not self._is_watched:
            until_s = min(until_s, self._next_beat_s)
        until_s = max(until_s, now_s)
        # A subscriber that raised has left frames behind; they come before new bytes.
        if not self._receiver.pending:
            self._receiver.feed(self.transport.read(until_s - now_s))
        try:
            self._receiver.dispatch()
        finally:
            if self._receiver.heard:
                self._receiver.heard = False
                self._unanswered_since_s = inf
        if not self.transport.live and self._subscriptions.last_event != self._acknowledged:
            self._next_beat_s = now_s
        return not self.transport.live and until_s - self.transport.now_s() > _CLOCK_TICK_S

    def _on_heartbeat(self, reply: HeartbeatReply, seq: int) -> None:
        before, is_ours = self.last_heartbeat, reply.t_host_us == self._beats_us[seq]
        if is_ours and before is not None and reply.t_host_us < before.t_host_us:
            return  # overtaken on its way
        if not (is_ours and self._goes_on(reply, before)):
            self.statistics.malformed += 1
            return
        self.last_heartbeat = reply
        self._clock.note(reply.t_dev_us)
        if self.transport.live:
            sent_s, now_s = 1e-6 * reply.t_host_us, self.transport.now_s()
            self._fit.note(sent_s, now_s, 1e-6 * reply.t_dev_us)
            self._retransmit_timer.note(now_s - sent_s)

    def _goes_on(self, reply: HeartbeatReply, before: HeartbeatReply | None) -> bool:
        """Whether the controller's time goes forward, and no faster than it can."""
        if before is None:
            return True
        if not self._knows_pace:
            return reply.t_dev_us >= before.t_dev_us
        # By when both were sent: a host that was away reads many replies at once.
        asked_s = 1e-6 * (reply.t_host_us - before.t_host_us)
        passed_s = 1e-6 * (reply.t_dev_us - before.t_dev_us)
        return 0.0 <= passed_s <= self.pace * (SPARE_SHARE * asked_s + SPARE_S)

    def _on_boot(self, boot: Boot) -> None:
        # A controller that boots because the port was opened says so before it answers HELLO.
        if self._is_open:
            raise self._lose(restarted(self.transport.name, boot))

    def _give_up(self, silence: LinkLost) -> LinkLost:
        """Lose a controller that is silent, or that talks to somebody else by now."""
        is_taken = self._is_open and self._receiver.others
        return self._lose(failures.session_taken_over(name=self.transport.name) if is_taken else silence)

    def _lose(self, error: LinkLost) -> LinkLost:
        self._is_open = False
        self._next_beat_s = inf
        self._end_heartbeats()  # the controller may hear what this side does not, and must not be kept going
        self._lost = error
        return error


def _unpack_reply(message: Request[ReplyT], frame: Frame) -> ReplyT:
    try:
        return message.unpack_reply(frame.payload)
    except ValueError as error:
        raise failures.reply_unreadable(name=message.NAME, error=error, update=UPDATE) from error
