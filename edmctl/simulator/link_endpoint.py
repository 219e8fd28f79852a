"""The virtual controller's end of the line: sessions, at-most-once execution, events until acknowledged."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Protocol

from edmctl.link.frame import ABORT_RUN, Frame, FrameDecoder, encode_frame
from edmctl.link.messages import REQUESTS, Advance, Event, Fault, GetSchema, Heartbeat, Hello, Status
from edmctl.link.wire import Message, saturated
from edmctl.simulator.plant_interface import TICK_S

REPLY_BIT = 0x40
REPLIES_KEPT = 8
NONCES_KEPT = 8
EVENTS_KEPT = 32
FOR_FAULTS = 2
"""Places of those that only a FAULT takes: the one that latches, and an emergency stop over it."""
ANSWERS_PER_TICK = 8
_HALF = 128
"""Commands may run so far ahead of the newest one executed; what lies behind it is a late copy."""
Outcome = tuple[Status, bytes]
OK: Outcome = (Status.OK, b"")


class Executor(Protocol):
    """What carries out commands."""

    def execute(self, message: Message) -> Outcome:
        """Carry out a command and return the status and payload of its reply."""


class LinkEndpoint:
    """Turns bytes into commands and messages into bytes.

    `execute` gets each valid command of the session once. A copy of one of the last commands gets the reply that the
    command got; an older copy gets none, for nobody can be waiting for it any more.
    `heard` is called with what only a living host sends, before it acts: a new command of the session, and a
    heartbeat that is newer than all before; `opened` when a HELLO opens a session, before it is answered. HELLO is
    executed for its reply alone. `urgent` tells that somebody waits for what is to be sent; answers to heartbeats
    may wait for company. With a `driven` clock ADVANCE needs no session, so that a host whose controller has
    restarted can wait for the news of it; what there is to send is then `due` with the answer to ADVANCE, to HELLO
    and to whoever has no session, and with every answer before the first ADVANCE. One that `reboots` takes no more
    commands until it has.
    """

    answer_ticks = 0
    """Milliseconds within which a command is answered."""

    def __init__(
        self, execute: Callable[[Message], Outcome], heard: Callable[[], None], opened: Callable[[], None]
    ) -> None:
        self._execute = execute
        self._heard, self._opened = heard, opened
        self.driven = False
        self.reboots = False
        self._decoder = FrameDecoder()
        self._out: list[bytes] = []
        self.urgent = self.due = False
        self._event_no = 0
        self.rx_drop = 0
        self.rx_frames = 0  # commands that came whole, whoever sent them
        self._replies: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._unacknowledged: list[tuple[int, bytes]] = []
        self._hello = b""
        self._welcome = OK
        self._former_nonces: deque[int] = deque(maxlen=NONCES_KEPT)
        self.begin_session(0)

    def restart(self) -> None:
        """Forget, as a reset does, session, counters and the frame begun. Nonces of former HELLOs outlast it."""
        self._decoder = FrameDecoder()
        self.rx_drop = 0
        self.reboots = False
        self.begin_session(0)

    def begin_session(self, session: int) -> None:
        """Forget what belonged to the session before; 0 is none."""
        if self._hello:
            self._former_nonces.append(Hello.unpack(self._hello).host_nonce)
        self._session = session
        self._hello = b""
        self._advanced = False
        self._newest: int | None = None
        self._newest_beat_us = -1
        self._replies.clear()
        self._unacknowledged.clear()

    @property
    def rx_bad(self) -> int:
        """Frames dropped for a bad check."""
        return self._decoder.bad

    @property
    def takes_events(self) -> bool:
        """Whether another EVENT may wait for its acknowledgement, and two FAULTs after it."""
        return len(self._unacknowledged) < EVENTS_KEPT - FOR_FAULTS

    @property
    def takes_faults(self) -> bool:
        """Whether two more FAULTs may wait."""
        return len(self._unacknowledged) <= EVENTS_KEPT - FOR_FAULTS

    def count_from(self, event_no: int, bad: int, dropped: int) -> None:
        """Let the counters stand where they do after a long time."""
        self._event_no, self._decoder.bad, self.rx_drop = event_no, bad, dropped

    @property
    def greeting(self) -> bool:
        """Whether somebody waits for an answer on a driven clock that nobody drives yet."""
        return self.driven and self.urgent and not self._advanced

    def up_to_aborts(self, data: bytes) -> list[bytes]:
        """Cut what came in one read behind each abort run, so that it acts before what follows it."""
        missing = max(0, len(ABORT_RUN) - self._decoder.zeros)
        ends_run = data[:missing] if missing and data.startswith(bytes(missing)) else b""
        *before, last = data[len(ends_run) :].split(ABORT_RUN)
        return [ends_run, *(part + ABORT_RUN for part in before), last]

    def receive(self, data: bytes) -> bool:
        """Execute what the bytes say; returns whether an abort run came."""
        for frame in self._decoder.feed(data):
            self._handle(frame)
        aborted, self._decoder.abort_seen = self._decoder.abort_seen, False
        return aborted

    def take_output(self) -> bytes:
        """Hand over everything to be sent."""
        out = b"".join(self._out)
        self._out.clear()
        self.urgent = self.due = False
        return out

    def send(self, message: Message) -> None:
        """Send an unsolicited message once."""
        self._out.append(encode_frame(message.ID, 0, self._session, 0, message.pack()))

    def next_event_no(self) -> int:
        """Number of the next event; wraps past 65535 and skips 0, which means none."""
        self._event_no = self._event_no % 0xFFFF + 1
        return self._event_no

    def send_event(self, event: Event | Fault) -> None:
        """Send an event and keep it for repetition."""
        frame = encode_frame(event.ID, 0, self._session, 0, saturated(event).pack())
        self._unacknowledged.append((event.event_no, frame))
        self._out.append(frame)

    def acknowledge(self, last_event: int) -> None:
        """Forget every event up to and with `last_event`."""
        numbers = [n for n, _ in self._unacknowledged]
        if last_event in numbers:
            del self._unacknowledged[: numbers.index(last_event) + 1]

    def repeat_events(self) -> bool:
        """Send again what is not acknowledged; returns whether there was anything."""
        self._out.extend(frame for _, frame in self._unacknowledged)
        return bool(self._unacknowledged)

    def _handle(self, frame: Frame) -> None:
        if not 0 < frame.type_id < REPLY_BIT:
            # An echo of what the controller sent must not feed its watchdog.
            self.rx_drop += 1
            return
        self.rx_frames += 1
        if self.driven and frame.type_id == Advance.ID:
            self._advanced = True
            self._out.append(self._run(frame))
            self.due = True
            return
        if self.reboots:
            self.rx_drop += 1
            return
        if frame.session == 0 or frame.session != self._session:
            self._handle_stranger(frame)
            return
        if frame.type_id == Hello.ID:
            self._greet(frame)
            return
        reply = self._reply_to(frame)
        if reply is not None:
            self._out.append(reply)
            self.urgent = self.urgent or frame.type_id != Heartbeat.ID
            self.due = self.due or self.greeting

    def _handle_stranger(self, frame: Frame) -> None:
        """Answer what may be asked outside the session: a HELLO, and what a host of another version asks about."""
        if frame.session != 0 and frame.type_id == Hello.ID:
            self._greet(frame)
        elif frame.session != 0 and frame.type_id == GetSchema.ID:
            self._answer_now(self._run(frame))
        else:
            self.rx_drop += 1

    def _greet(self, frame: Frame) -> None:
        """Answer a HELLO. Only a new one that is answered OK opens a session; no other changes or feeds anything."""
        if (frame.session, frame.payload) == (self._session, self._hello):
            self._answer_now(self._encoded(frame, self._welcome))
            return
        outcome = self._outcome(frame)
        if outcome[0] == Status.OK and self._is_former(frame):
            # A late copy: it must not open, with an empty memory, what it opened once.
            self.rx_drop += 1
            return
        if outcome[0] == Status.OK:
            self.begin_session(frame.session)
            self._hello, self._newest = frame.payload, frame.seq
            self._opened()
            outcome = self._welcome = self._outcome(frame)  # what the former host left running has ended
        self._answer_now(self._encoded(frame, outcome))

    def _is_former(self, frame: Frame) -> bool:
        """Whether a whole HELLO carries the nonce of a session, whatever else it says."""
        nonce = Hello.unpack(frame.payload).host_nonce
        present = Hello.unpack(self._hello).host_nonce if self._hello else None
        return nonce == present or nonce in self._former_nonces

    def _answer_now(self, reply: bytes) -> None:
        """Send an answer that no ADVANCE of a session is waited for with."""
        self._out.append(reply)
        self.urgent = self.due = True

    def _reply_to(self, frame: Frame) -> bytes | None:
        """Execute the command if it is new; its reply, or None for a copy from too long ago."""
        if frame.type_id == Heartbeat.ID:
            return self._encoded(frame, self._hear_beat(frame))
        key = (frame.type_id, frame.seq)
        kept = self._replies.get(key)
        if kept is not None:
            return kept
        if self._newest is not None and not 0 < (frame.seq - self._newest) % 256 < _HALF:
            self.rx_drop += 1
            return None
        self._heard()
        reply = self._run(frame)
        self._newest = frame.seq
        self._replies[key] = reply
        if len(self._replies) > REPLIES_KEPT:
            self._replies.popitem(last=False)
        return reply

    def _hear_beat(self, frame: Frame) -> Outcome:
        """Let a heartbeat count that is newer than all before: a line that repeats or delays one is no host."""
        try:
            beat = Heartbeat.unpack(frame.payload)
        except ValueError:
            return Status.BAD_LENGTH, b""
        if beat.t_host_us > self._newest_beat_us:
            self._newest_beat_us = beat.t_host_us
            self._heard()
        return self._execute(beat)

    def _run(self, frame: Frame) -> bytes:
        return self._encoded(frame, self._outcome(frame))

    @staticmethod
    def _encoded(frame: Frame, outcome: Outcome) -> bytes:
        return encode_frame(frame.type_id | REPLY_BIT, frame.seq, frame.session, *outcome)

    def _outcome(self, frame: Frame) -> Outcome:
        message_type = REQUESTS.get(frame.type_id)
        if message_type is None:
            return Status.UNKNOWN_TYPE, b""
        try:
            message = message_type.unpack(frame.payload)
        except ValueError:
            return Status.BAD_LENGTH, b""
        return self._execute(message)


class Answering(Protocol):
    """An end of the line."""

    @property
    def urgent(self) -> bool:
        """Whether somebody waits for what is to be sent."""


class HostWait:
    """Lets time pass for a host that waits.

    The controller answers commands at once, without time. So that a host which asks again and again cannot stop the
    clock, a millisecond passes after every eight answers.
    """

    def __init__(self, link: Answering, advance: Callable[[int], None]) -> None:
        self._link, self._advance = link, advance
        self._answers = 0

    def wait(self, timeout_s: float) -> None:
        """Let up to `timeout_s` pass: nothing where an answer is there already, else whole milliseconds."""
        urgent = self._link.urgent
        if urgent and self._answers < ANSWERS_PER_TICK:
            self._answers += 1
            return
        self._answers = 0
        self._advance(1 if urgent else max(1, math.floor(timeout_s / TICK_S + 0.5)))
