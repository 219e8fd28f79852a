"""The host's half of the protocol as the suite needs it: it sends exactly what a test says and trusts nothing.

Every frame that comes in is held against the tables; a controller that sends anything else fails the test at once.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle
from random import Random
from typing import Any

from tests.conformance import layouts, wire
from tests.conformance.layouts import Fields
from tests.conformance.lines import Line
from tests.conformance.wire import Frame

STATUS = layouts.enum("Status")
STATE = layouts.enum("State")
EVENT = layouts.enum("EventCode")
STATUS_NAMES = {number: name for name, number in STATUS.items()}
STATE_NAMES = {number: name for name, number in STATE.items()}
EVENT_NAMES = {number: name for name, number in EVENT.items()}
BEAT_S = 0.05
ANSWER_S = 0.75
_HELLO, _HEARTBEAT, _ADVANCE = (layouts.NAMES[n] for n in ("HELLO", "HEARTBEAT", "ADVANCE"))
_KEPT = 12
# One host after the other on one line must not come with the byte of the host before.
_SESSIONS = cycle(number for number in range(1, 256) if number != 0x5A)  # that is of the golden frames
# Commands that an event answers later; it may be there before their reply has been read.
_BEGIN = {
    "PIEZO_SET",
    "STAGE_MOVE",
    "STAGE_STOP",
    "APPROACH",
    "SELF_TEST",
    "SERVO_START",
    "SERVO_STOP",
    "JUMP",
    "TOUCH_OFF",
    "DISARM",
}


def loses_nothing(direction: str, frame: Frame | None) -> bool:
    """A line that delivers everything."""
    return False


@dataclass(frozen=True)
class Reply:
    """A reply: status, fields where the status is OK, and the frame itself."""

    status: int
    fields: Fields
    frame: Frame

    def __getattr__(self, name: str) -> Any:
        try:
            return self.fields[name]
        except KeyError:
            raise AttributeError(name) from None


class Peer:
    """One host on one line. `loses` decides about frames, "in" or "out", that the line shall lose."""

    def __init__(self, line: Line, seed: int = 1) -> None:
        self.line = line
        self.random = Random(seed)
        self.session = 0
        self.seq = 0
        self.driven = False
        self.beating = True
        self.loses: Callable[[str, Frame | None], bool] = loses_nothing
        self.check_frames = True
        self._advances = 0
        self._advanced_s = self._sent_s = 0.0
        self._beat_seq = 0
        self._begin()

    def _begin(self) -> None:
        self.frames: list[Frame] = []
        self.events: list[Fields] = []
        self.faults: list[Fields] = []
        self.boots: list[Fields] = []
        self.telemetry: list[Fields] = []
        self.pulses: list[Fields] = []
        self.beat: Fields | None = None
        self.last_event = 0
        self._mark = 0, 0
        self._receiver = wire.Receiver()
        self._next_beat_s = self.now_s()
        self._sent: list[str] = []

    # --------------------------------------------------------------------------------------------- time
    @property
    def exact(self) -> bool:
        """Time passes only while this host reads, so it can be told to the millisecond."""
        return self.line.virtual_time or self.driven

    @property
    def grain_s(self) -> float:
        """How finely a test may ask about time here."""
        return 0.001 if self.exact else 0.06

    def now_s(self) -> float:
        """The host's clock: the controller's own where that is exact."""
        return self._advanced_s if self.driven else self.line.now_s()

    # ---------------------------------------------------------------------------------------- one frame
    def send(self, name: str, *, seq: int | None = None, session: int | None = None, **values: Any) -> int:
        """Send one command and return its seq; it takes the next one where none is given."""
        type_id = layouts.NAMES[name]
        return self.send_payload(type_id, layouts.REQUESTS[type_id].pack(values), seq=seq, session=session)

    def send_payload(
        self, type_id: int, payload: bytes, *, seq: int | None = None, session: int | None = None
    ) -> int:
        """Send one command with any payload."""
        if seq is None:
            seq = self.seq
            self.seq = (self.seq + 1) % 256
        self.write(wire.encode(type_id, seq, self.session if session is None else session, payload))
        return seq

    def write(self, data: bytes) -> None:
        """Send bytes as they are."""
        self._sent = [*self._sent[-_KEPT:], data.hex(" ") if len(data) < 80 else f"{len(data)} bytes"]
        self._sent_s = self.now_s()
        if not self.loses("out", wire.decode(data.strip(b"\0"))):
            self.line.write(data)

    def send_beat(self) -> None:
        """Send a HEARTBEAT; its seq is counted apart from that of the commands."""
        values = {"t_host_us": int(self.now_s() * 1e6), "last_event": self.last_event}
        payload = layouts.REQUESTS[_HEARTBEAT].pack(values)
        self.send_payload(_HEARTBEAT, payload, seq=self._beat_seq)
        self._beat_seq = (self._beat_seq + 1) % 256
        self._next_beat_s = self.now_s() + BEAT_S

    # ------------------------------------------------------------------------------------------ waiting
    def step(self, timeout_s: float) -> list[Frame]:
        """Heartbeat if one is due, then one read of at most `timeout_s`; returns the frames that came."""
        if self.beating and self.session and self.now_s() >= self._next_beat_s - 1e-9:
            self.send_beat()
        data = self._advance(timeout_s) if self.driven else self.line.read(timeout_s)
        return self._take(data)

    def _advance(self, timeout_s: float) -> bytes:
        """Let the controller's time pass; everything up to the answer belongs to this read."""
        self._advances = (self._advances + 1) % 256
        payload = layouts.REQUESTS[_ADVANCE].pack({"timeout_us": max(0, round(timeout_s * 1e6))})
        self.line.write(wire.encode(_ADVANCE, self._advances, self.session, payload))
        data = b""
        end_s = self.line.now_s() + 10.0
        while self.line.now_s() < end_s:
            data += self.line.read(0.05)
            last = wire.pieces(data)[-1:] if data.endswith(b"\0") else []
            frame = wire.decode(last[0]) if last else None
            if frame and frame[:2] == (_ADVANCE | wire.REPLY, self._advances):
                fields = layouts.ANSWERS[frame.type_id].unpack(frame.payload)
                assert fields is not None
                self._advanced_s = fields["t_dev_us"] * 1e-6
                return data
        raise AssertionError(self.story("ADVANCE was not answered within 10 s", "driven-clock"))

    def wait(self, predicate: Callable[[], object], timeout_s: float, grain_s: float = BEAT_S) -> bool:
        """Read, with heartbeats, at most `grain_s` at a time until `predicate` holds; False where it is late."""
        end_s = self.now_s() + timeout_s
        while not predicate():
            left_s = end_s - self.now_s()
            if left_s <= 1e-9:
                return False
            self.step(min(left_s, grain_s))
        return True

    def pump(self, duration_s: float) -> None:
        """Read, with heartbeats, for `duration_s`."""
        self.wait(lambda: False, duration_s)

    def silence(self, duration_s: float) -> None:
        """Send nothing until `duration_s` after the last frame that was sent."""
        beating, self.beating = self.beating, False
        left_s = self._sent_s + duration_s - self.now_s()
        self.wait(lambda: False, left_s, left_s)
        self.beating = beating

    def fresh_beat(self) -> Fields:
        """Heartbeat now and return the answer to it."""
        for _ in range(8):
            self.beat = None
            self.send_beat()
            if self.wait(lambda: self.beat is not None, 0.1, 0.001 if self.exact else BEAT_S):
                assert self.beat is not None
                return self.beat
        raise AssertionError(self.story("HEARTBEAT was not answered", "safe-state-and-watchdog"))

    def ok_at(self, name: str, **values: Any) -> int:
        """Send a command that must be carried out; the controller's time when it came, µs."""
        self.beat = None
        self.send_beat()
        self.ok(name, **values)
        assert self.wait(lambda: self.beat is not None, 0.1), self.story("HEARTBEAT was not answered", "time")
        assert self.beat is not None
        at_us: int = self.beat["t_dev_us"]
        return at_us

    # ----------------------------------------------------------------------------------------- commands
    def hello(self, session: int | None = None, **values: Any) -> Reply:
        """Open a session, by default with a new byte, and forget what came before."""
        old, self.driven = self.session, False
        while session is None or session == old:
            session = next(_SESSIONS)
        self._begin()
        self.session = session
        given = {
            "proto_major": layouts.MAJOR,
            "proto_minor": layouts.MINOR,
            "host_nonce": secrets.randbits(32),  # of a HELLO seen before a controller takes no notice
            "schema_hash": layouts.schema_hash(),
        } | values
        beating, self.beating = self.beating, False
        reply = self.command("HELLO", **given)
        self.beating = beating
        assert reply.host_nonce == given["host_nonce"], self.story("host_nonce not echoed", "session")
        if reply.fields.get("clock") == layouts.enum("Clock")["DRIVEN"]:
            self.driven = True
            self.step(0.001)
        self._next_beat_s = self.now_s()
        return reply

    def reply_to(self, type_id: int, seq: int, timeout_s: float = ANSWER_S) -> Reply | None:
        """The reply to a command that was sent, or None."""
        wanted = (type_id | wire.REPLY, seq, self.session)

        def found() -> Frame | None:
            return next((frame for frame in self.frames[-400:] if frame[:3] == wanted), None)

        self.wait(found, timeout_s)
        frame = found()
        if frame is None:
            return None
        self.frames.remove(frame)
        return self._reply(frame)

    def _reply(self, frame: Frame) -> Reply:
        layout = layouts.ANSWERS.get(frame.type_id)
        fields = layout.unpack(frame.payload) if layout and frame.flags == STATUS["OK"] else None
        if frame.flags == STATUS["VERSION"]:
            fields = layouts.ANSWERS[_HELLO | wire.REPLY].unpack(frame.payload)
        return Reply(frame.flags, fields or {}, frame)

    def command(self, name: str, **values: Any) -> Reply:
        """Send a command once and return its reply, whatever its status."""
        if name in _BEGIN:
            self._mark = len(self.events), len(self.faults)
        seq = self.send(name, **values)
        reply = self.reply_to(layouts.NAMES[name], seq)
        assert reply is not None, self.story(f"{name} was not answered within {ANSWER_S} s", "delivery")
        return reply

    def ok(self, name: str, **values: Any) -> Reply:
        """Send a command that must be carried out."""
        return self.refused(name, "OK", **values)

    def refused(self, name: str, status: str, **values: Any) -> Reply:
        """Send a command that must be answered with `status`."""
        reply = self.command(name, **values)
        came = STATUS_NAMES.get(reply.status, str(reply.status))
        assert came == status, self.story(f"{name} {values}: status {came} instead of {status}", "states")
        return reply

    def state(self) -> str:
        """Name of the state that GET_STATUS tells."""
        return STATE_NAMES[self.ok("GET_STATUS").state]

    def event(self, code: str, timeout_s: float) -> Fields:
        """Wait for the event that ends the motion begun last; a fault instead fails the test."""
        faults = self._mark[1]

        self.wait(lambda: self.ended(code) or len(self.faults) > faults, timeout_s)
        fault = self.faults[faults]["code"] if len(self.faults) > faults else None
        found = self.ended(code)
        assert found is not None, self.story(f"no {code} within {timeout_s} s (fault: {fault})", "states")
        return found

    def ended(self, code: str) -> Fields | None:
        """The event of a code that came since the motion begun last, if there is one."""
        return next((e for e in self.events[self._mark[0] :] if e["code"] == EVENT[code]), None)

    def forget(self) -> None:
        """Start with empty lists of events, faults and telemetry."""
        self.telemetry.clear()
        self.pulses.clear()
        self.events.clear()
        self.faults.clear()
        self._mark = 0, 0

    def event_of(self, code: str, timeout_s: float) -> bool:
        """Wait until an event of a code is among those that came in this session."""
        return self.wait(lambda: any(e["code"] == EVENT[code] for e in self.events), timeout_s)

    def fault(self, timeout_s: float) -> Fields:
        """The first FAULT since the last were forgotten; waits for it."""
        assert self.wait(lambda: self.faults, timeout_s), self.story(
            f"no FAULT within {timeout_s} s", "faults"
        )
        return self.faults[0]

    # ------------------------------------------------------------------------------------- what came in
    def _take(self, data: bytes) -> list[Frame]:
        damaged = len(self._receiver.bad)
        frames = self._receiver.feed(data)
        if self.check_frames and self.line.bench is not None:
            assert len(self._receiver.bad) == damaged, self.story(
                f"the controller sent what is no frame: {self._receiver.bad[-1].hex(' ')}", "frame"
            )
        kept = [frame for frame in frames if not self.loses("in", frame)]
        for frame in kept:
            self._file(frame)
        return kept

    def _file(self, frame: Frame) -> None:
        if frame.type_id == layouts.NAMES["BOOT"]:
            fields = self._checked(frame)
            assert frame.session == 0, self.story("BOOT must carry session 0", "session")
            self.boots.append(fields)
            return
        if frame.session != self.session:
            return
        if frame.type_id in layouts.UNASKED.values():
            assert (frame.seq, frame.flags) == (0, 0), self.story(
                f"seq and flags of {frame} are not 0", "frame"
            )
            self._file_unasked(self._checked(frame), frame.type_id)
            return
        if frame.type_id == _HEARTBEAT | wire.REPLY:
            self.beat = self._checked(frame)
            return
        if frame.flags == STATUS["OK"]:
            self._checked(frame)
        if not (self.driven and frame.type_id == _ADVANCE | wire.REPLY):
            self.frames.append(frame)

    def _file_unasked(self, fields: Fields, type_id: int) -> None:
        name = layouts.ANSWERS[type_id].name
        if name in ("EVENT", "FAULT"):
            number = fields["event_no"]
            assert number != 0, self.story("event number 0 means none", "events")
            if self.last_event and number != self.last_event % 0xFFFF + 1:
                return  # a repetition, or one that came after a lost one and will come again
            self.last_event = number
            (self.events if name == "EVENT" else self.faults).append(fields)
        elif name == "TLM":
            self.telemetry.append(fields)
        elif name in ("PULSES", "PULSE_BLOCKS"):
            self.pulses.append(fields)

    def _checked(self, frame: Frame) -> Fields:
        layout = layouts.ANSWERS.get(frame.type_id)
        assert layout is not None, self.story(f"unknown type in {frame}", "messages")
        fields = layout.unpack(frame.payload)
        assert fields is not None, self.story(
            f"{layout.name}: length {len(frame.payload)} is wrong", "messages"
        )
        return fields

    def story(self, what: str, section: str) -> str:
        """A failure as a firmware author wants to read it."""
        came = [f"{f.type_id:02x} seq={f.seq} flags={f.flags} {f.payload.hex()}" for f in self.frames[-4:]]
        faults = [f["code"] for f in self.faults]
        events = [EVENT_NAMES.get(e["code"], e["code"]) for e in self.events[-6:]]
        return (
            f"{what}\n  line: {self.line.name}, session {self.session:02x}\n"
            f"  sent last: {self._sent[-3:]}\n  replies last: {came}\n"
            f"  events: {events}, faults: {faults}\n  see docs/protocol.md#{section}"
        )
