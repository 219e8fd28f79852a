"""A session over a scripted line: every reply, refusal, silence and repetition a controller can offer."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from random import Random

import pytest

from edmctl.errors import LinkLost, MachineFault, PreconditionError, ProtocolMismatch
from edmctl.link.frame import ABORT, Frame, FrameDecoder, encode_frame
from edmctl.link.messages import (
    PROTO_MAJOR,
    PROTO_MINOR,
    SCHEMA_HASH,
    Boot,
    Event,
    EventCode,
    Fault,
    GetParam,
    GetParamReply,
    GetStatus,
    Heartbeat,
    HeartbeatReply,
    Hello,
    HelloReply,
    Log,
    PiezoSet,
    PulseBlocks,
    Status,
    Tlm,
    TlmStart,
    TlmStop,
)
from edmctl.link.session import CommandRefused, Session
from edmctl.link.wire import Message

TLM = Tlm(counter=0, t0_us=0, period_us=1000, n=0, dropped=0, records=b"")
EVENT = Event(1, 0, EventCode.MOVE_DONE, 0, 0.0, 0.0)


class ScriptedLine:
    """A transport whose far end answers as told; its clock moves only while the host waits."""

    def __init__(self) -> None:
        self.name = "scripted"
        self.live = False
        self.clock_s = 0.0
        self.to_host = b""
        self.received: list[Frame] = []
        self.raw = b""
        self.session = 0
        self.deaf_to: set[int] = set()
        self.answers: dict[int, Callable[[Frame], bytes]] = {}
        self.hello = HelloReply(
            PROTO_MAJOR, PROTO_MINOR, 0, SCHEMA_HASH, 1, 2, 3, 0, "EDM-1", 0, 1000, 1000, 1, 1, 0, 0, 1, 0, 0
        )
        self.later: list[tuple[float, bytes]] = []
        self.closed = False
        self._decoder = FrameDecoder()

    def now_s(self) -> float:
        return self.clock_s

    def close(self) -> None:
        self.closed = True

    def write(self, data: bytes) -> None:
        self.raw += data
        for frame in self._decoder.feed(data):
            self.received.append(frame)
            if frame.type_id not in self.deaf_to:
                self.to_host += self._answer(frame)

    def read(self, timeout_s: float) -> bytes:
        if not self.to_host:
            due = [entry for entry in self.later if entry[0] <= self.clock_s + timeout_s]
            if not due:
                self.clock_s += timeout_s
                return b""
            self.later.remove(due[0])
            self.clock_s = max(self.clock_s, due[0][0])
            return due[0][1]
        data, self.to_host = self.to_host, b""
        return data

    def send(self, message: Message, session: int | None = None) -> None:
        self.to_host += self.frame(message, session)

    def frame(self, message: Message, session: int | None = None) -> bytes:
        return encode_frame(message.ID, 0, self.session if session is None else session, 0, message.pack())

    def sent(self, kind: type[Message]) -> list[Frame]:
        return [frame for frame in self.received if frame.type_id == kind.ID]

    def _answer(self, frame: Frame) -> bytes:
        if frame.type_id in self.answers:
            return self.answers[frame.type_id](frame)
        payload = b""
        if frame.type_id == Hello.ID:
            self.session = frame.session
            payload = self.hello.pack()[:2] + frame.payload[2:6] + self.hello.pack()[6:]
        elif frame.type_id == Heartbeat.ID:
            beat = Heartbeat.unpack(frame.payload)
            payload = HeartbeatReply(beat.t_host_us, int(self.clock_s * 1e6), 1, 0, 0, 0).pack()
        return reply_to(frame, payload)


def reply_to(frame: Frame, payload: bytes = b"", status: int = Status.OK) -> bytes:
    return encode_frame(frame.type_id | 0x40, frame.seq, frame.session, status, payload)


@pytest.fixture
def line() -> ScriptedLine:
    return ScriptedLine()


@pytest.fixture
def session(line: ScriptedLine) -> Session:
    session = Session(line, Random(1))
    session.open()
    return session


def test_open_tells_who_answered_and_chooses_the_session(line: ScriptedLine) -> None:
    session = Session(line, Random(5))
    assert session.open().serial == "EDM-1"
    assert session.hello.fw_patch == 3
    (hello,) = line.sent(Hello)
    assert hello.session != 0
    assert Hello.unpack(hello.payload).schema_hash == SCHEMA_HASH
    assert {frame.session for frame in line.received} == {hello.session}


def test_the_session_byte_is_never_zero_and_follows_the_random_source() -> None:
    chosen = []
    for seed in (*range(300), 0):
        line = ScriptedLine()
        Session(line, Random(seed)).open()
        chosen.append(line.session)
    assert 0 not in chosen
    assert chosen[-1] == chosen[0]
    assert len(set(chosen)) > 100


def test_nobody_answers_hello(line: ScriptedLine) -> None:
    line.deaf_to = {Hello.ID}
    with pytest.raises(LinkLost, match=r"No controller answered at scripted within 1\.5 s") as caught:
        Session(line).open(1.5)
    assert caught.value.code == "E4011"
    assert line.clock_s == pytest.approx(1.5)
    assert len({(frame.seq, frame.session, frame.payload) for frame in line.sent(Hello)}) == 1
    assert len(line.sent(Hello)) > 5


def test_something_that_is_no_controller_answers_hello(line: ScriptedLine) -> None:
    line.deaf_to = {Hello.ID}
    line.to_host = b"Grbl 1.1h ['$' for help]\r\n"
    with pytest.raises(LinkLost, match="no controller of this kind: 26 bytes came") as caught:
        Session(line).open()
    assert "edmctl ports" in caught.value.hint
    line.deaf_to = set()
    line.answers[Hello.ID] = lambda frame: reply_to(frame, b"\x01")
    with pytest.raises(ProtocolMismatch, match="does not speak EDM Link"):
        Session(line).open()
    line.answers[Hello.ID] = lambda frame: reply_to(frame, line.hello.pack())
    with pytest.raises(LinkLost, match="another host"):
        Session(line).open()


def test_an_unopened_session_knows_no_controller(line: ScriptedLine) -> None:
    with pytest.raises(LinkLost, match="not open"):
        _ = Session(line).hello


@pytest.mark.parametrize(
    ("major", "minor", "schema_hash", "verdict", "hint"),
    [
        (PROTO_MAJOR + 1, 0, 7, "this program is older", "Update edmctl"),
        (PROTO_MAJOR - 1, 9, 7, "the controller is older", "Update the controller's firmware"),
        (PROTO_MAJOR, PROTO_MINOR + 1, 7, "this program is older", "Update edmctl"),
        (PROTO_MAJOR, PROTO_MINOR, 7, "unreleased build", "released"),
    ],
)
def test_a_mismatch_names_both_versions_and_the_older_side(
    line: ScriptedLine, major: int, minor: int, schema_hash: int, verdict: str, hint: str
) -> None:
    start = bytes((major, minor, 0, 0, 0, 0)) + schema_hash.to_bytes(4, "little")
    line.answers[Hello.ID] = lambda frame: reply_to(frame, start, Status.VERSION)
    with pytest.raises(ProtocolMismatch) as caught:
        Session(line).open()
    for part in (f"EDM Link {major}.{minor}", f"{PROTO_MAJOR}.{PROTO_MINOR}", "00000007", verdict):
        assert part in caught.value.message
    assert hint in caught.value.hint


def test_a_newer_minor_version_with_the_same_schema_is_spoken_to(line: ScriptedLine) -> None:
    line.hello = HelloReply.unpack(
        bytes((PROTO_MAJOR, PROTO_MINOR + 1)) + line.hello.pack()[2:],
    )
    assert Session(line).open().proto_minor == PROTO_MINOR + 1


def test_the_answer_to_a_command_that_was_repeated_tells_no_round_trip(
    line: ScriptedLine, session: Session
) -> None:
    """Nobody knows which of the copies was answered (Karn and Partridge 1987)."""
    for _ in range(20):
        session.request(PiezoSet(1.0, 1.0))
    copies = 0

    def third_time(frame: Frame) -> bytes:
        nonlocal copies
        copies += 1
        return reply_to(frame, GetParamReply(-7).pack()) if copies == 3 else b""

    line.answers[GetParam.ID] = third_time
    assert session.request(GetParam(4)) == GetParamReply(-7)
    assert session.statistics.retries == 2
    assert session.link_report().rtt_p99_ms == 0.0


def test_sequence_numbers_count_on_and_wrap_and_heartbeats_have_their_own(
    line: ScriptedLine, session: Session
) -> None:
    for _ in range(300):
        session.request(PiezoSet(1.0, 1.0))
    numbers = [frame.seq for frame in line.received if frame.type_id != Heartbeat.ID]
    assert numbers == [n % 256 for n in range(301)]
    session.pump(20.0)
    beats = line.sent(Heartbeat)
    assert len(beats) > 300
    assert [frame.seq for frame in beats] == [n % 256 for n in range(len(beats))]
    session.request(PiezoSet(1.0, 1.0))
    assert line.sent(PiezoSet)[-1].seq == 301 % 256


@pytest.mark.parametrize(
    ("status", "payload", "text"),
    [
        (Status.OUT_OF_RANGE, b"\x01" + bytes(8) + (9).to_bytes(8, "little"), "(slew_v_s: 0..9 counts)"),
        (Status.INTERLOCK, b"\x03\x00", "(ESTOP, DOOR)"),
        (Status.OUT_OF_RANGE, b"", "OUT_OF_RANGE."),
        (Status.PROFILE_MISMATCH, b"", "refused PIEZO_SET: PROFILE_MISMATCH"),
        (99, b"", "INTERNAL."),
    ],
)
def test_a_refusal_says_what_the_controller_told(
    line: ScriptedLine, session: Session, status: int, payload: bytes, text: str
) -> None:
    line.answers[PiezoSet.ID] = lambda frame: reply_to(frame, payload, status)
    with pytest.raises(CommandRefused) as caught:
        session.request(PiezoSet(1.0, 1.0))
    assert text in caught.value.message
    assert isinstance(caught.value, PreconditionError)
    assert caught.value.status == (status if status != 99 else Status.INTERNAL)
    assert caught.value.hint


def test_no_reply_is_a_lost_link_at_the_deadline_until_it_is_opened_again(
    line: ScriptedLine, session: Session
) -> None:
    line.deaf_to = {PiezoSet.ID}
    start_s = line.clock_s
    with pytest.raises(LinkLost, match="did not answer PIEZO_SET within 750 ms"):
        session.request(PiezoSet(1.0, 1.0))
    assert line.clock_s - start_s == pytest.approx(0.75)
    sent = len(line.received)
    with pytest.raises(LinkLost, match="PIEZO_SET"):
        session.request(GetStatus())
    assert len(line.received) == sent
    line.deaf_to = set()
    session.open()
    session.request(PiezoSet(1.0, 1.0))


@pytest.mark.parametrize("wrong", ["seq", "session", "type"])
def test_a_reply_to_something_else_is_not_taken(line: ScriptedLine, session: Session, wrong: str) -> None:
    def answer(frame: Frame) -> bytes:
        changed = {
            "seq": frame._replace(seq=frame.seq ^ 1),
            "session": frame._replace(session=frame.session ^ 1),
            "type": frame._replace(type_id=GetStatus.ID),
        }
        return reply_to(changed[wrong])

    line.answers[PiezoSet.ID] = answer
    with pytest.raises(LinkLost):
        session.request(PiezoSet(1.0, 1.0))
    statistics, tries = session.statistics, len(line.sent(PiezoSet))
    strays = (tries, 0) if wrong == "session" else (0, tries)
    assert (statistics.other_session, statistics.stray_replies) == strays


def test_a_reply_that_cannot_be_read_is_a_mismatch(line: ScriptedLine, session: Session) -> None:
    line.answers[GetParam.ID] = lambda frame: reply_to(frame, b"123")
    with pytest.raises(ProtocolMismatch, match=r"reply to GET_PARAM .*: payload of 3 bytes, expected 4"):
        session.request(GetParam(4))
    line.answers[PiezoSet.ID] = lambda frame: reply_to(frame, b"1")
    with pytest.raises(ProtocolMismatch, match=r"reply to PIEZO_SET .*: payload of 1 bytes, expected 0"):
        session.request(PiezoSet(1.0, 1.0))


def test_heartbeats_go_every_50_ms_while_waiting(line: ScriptedLine, session: Session) -> None:
    before = len(line.sent(Heartbeat))
    start_s = line.clock_s
    session.pump(1.0)
    assert line.clock_s - start_s == pytest.approx(1.0)
    assert len(line.sent(Heartbeat)) - before in (19, 20)
    times = [Heartbeat.unpack(frame.payload).t_host_us for frame in line.sent(Heartbeat)]
    steps = [after - earlier for earlier, after in pairwise(times)]
    assert steps == pytest.approx([50_000] * len(steps), abs=2)


def test_heartbeats_go_on_while_a_reply_is_awaited(line: ScriptedLine, session: Session) -> None:
    def answer_late(frame: Frame) -> bytes:
        line.later.append((line.clock_s + 0.4, reply_to(frame)))
        return b""

    line.answers[PiezoSet.ID] = answer_late
    before = len(line.sent(Heartbeat))
    session.request(PiezoSet(1.0, 1.0))
    assert len(line.sent(Heartbeat)) - before == 8


def test_a_silent_controller_is_noticed_while_pumping(line: ScriptedLine, session: Session) -> None:
    line.deaf_to = {Heartbeat.ID}
    start_s = line.clock_s
    with pytest.raises(LinkLost, match="fell silent for 500 ms"):
        session.pump(10.0)
    assert 0.5 < line.clock_s - start_s < 0.7


def test_a_controller_that_talks_to_another_host_is_told_from_a_silent_one(
    line: ScriptedLine, session: Session
) -> None:
    for waits in (lambda: session.pump(10.0), lambda: session.request(PiezoSet(1.0, 1.0))):
        line.deaf_to = set()
        session.open()
        line.deaf_to = {PiezoSet.ID, Heartbeat.ID}
        line.send(Log(1, "to another"), session=line.session ^ 0x10)
        with pytest.raises(LinkLost, match="Another host has opened a session") as lost:
            waits()
        assert lost.value.code == "E4013"


def test_what_a_former_session_left_on_the_line_is_not_another_host(
    line: ScriptedLine, session: Session
) -> None:
    line.send(Log(1, "old"), session=line.session ^ 0x10)
    session.pump(0.1)
    line.deaf_to = {Heartbeat.ID}
    with pytest.raises(LinkLost, match="fell silent"):
        session.pump(10.0)


def test_a_host_that_slept_does_not_blame_the_controller(line: ScriptedLine, session: Session) -> None:
    line.deaf_to = {Heartbeat.ID}
    session.pump(0.1)
    line.deaf_to = set()
    line.clock_s += 30.0
    session.pump(0.2)
    assert session.statistics.heartbeats_answered > 1


def test_events_come_once_and_in_order_and_are_acknowledged(line: ScriptedLine, session: Session) -> None:
    seen: list[int] = []
    session.subscribe(Event, lambda event: seen.append(event.event_no))
    session.subscribe(Fault, lambda fault: seen.append(fault.event_no))
    for number in (65534, 65534, 65535, 65534):
        line.send(Event(number, 0, EventCode.MOVE_DONE, 0, 0.0, 0.0))
    line.send(Fault(1, 0, 1001, 0, 0.0, 0.0))
    line.send(Fault(1, 0, 1001, 0, 0.0, 0.0))
    session.pump(0.1)
    assert seen == [65534, 65535, 1]
    assert session.statistics.repeated_events == 3
    line.send(Event(2, 0, EventCode.MOVE_DONE, 0, 0.0, 0.0))
    session.pump(0.1)
    assert Heartbeat.unpack(line.sent(Heartbeat)[-1].payload).last_event == 2


def test_an_event_after_a_lost_one_waits_for_it(line: ScriptedLine, session: Session) -> None:
    seen: list[int] = []
    session.subscribe(Event, lambda event: seen.append(event.event_no))
    for number in (1, 3):
        line.send(Event(number, 0, EventCode.MOVE_DONE, 0, 0.0, 0.0))
    session.pump(0.1)
    assert Heartbeat.unpack(line.sent(Heartbeat)[-1].payload).last_event == 1
    for number in (2, 3):
        line.send(Event(number, 0, EventCode.MOVE_DONE, 0, 0.0, 0.0))
    session.pump(0.1)
    assert seen == [1, 2, 3]


def test_missing_telemetry_frames_are_counted_exactly(line: ScriptedLine, session: Session) -> None:
    kept = [n for n in range(65530, 65600) if n % 10 not in (3, 4)]
    for number in kept:
        line.send(Tlm(number % 65536, 0, 1000, 0, 0, b""))
    line.send(PulseBlocks(9, 0, 0, 0, 23, 0, b""))
    line.send(PulseBlocks(10, 0, 0, 0, 23, 0, b""))
    session.pump(0.1)
    assert session.statistics.lost_frames == {"TLM": 70 - len(kept)}


def test_a_new_start_of_telemetry_is_not_a_gap(line: ScriptedLine, session: Session) -> None:
    line.send(Tlm(7, 0, 1000, 0, 0, b""))
    session.pump(0.1)
    session.request(TlmStop())
    session.request(TlmStart(1000, 14, 0))
    line.send(TLM)
    session.pump(0.1)
    assert session.statistics.lost_frames == {}


def told_time(line: ScriptedLine, t_dev_us: Callable[[], int]) -> None:
    """Let the controller's clock say what `t_dev_us` does."""

    def answer(frame: Frame) -> bytes:
        t_host_us = Heartbeat.unpack(frame.payload).t_host_us
        return reply_to(frame, HeartbeatReply(t_host_us, t_dev_us(), 1, 0, 0, 0).pack())

    line.answers[Heartbeat.ID] = answer


@pytest.mark.parametrize("start_us", [2**32 - 40_000, 3 * 2**32 + 5])
def test_controller_time_is_unwrapped_from_32_bits(start_us: int) -> None:
    line = ScriptedLine()
    told_time(line, lambda: start_us + round(1e6 * line.clock_s))
    session = Session(line, Random(1))
    session.open()
    session.pump(0.1)
    now_us = round(1e6 * session.heard_s)
    assert start_us < now_us < start_us + 200_000
    for t_us in (now_us - 10_000, now_us, now_us + 60_000):
        assert session.seconds(t_us % 2**32) == t_us / 1e6


@pytest.mark.parametrize("jump_us", [-1_000_000, 5_000_000, 2**40], ids=["back", "ahead", "far ahead"])
def test_a_clock_that_jumps_is_not_followed_and_counted(
    line: ScriptedLine, session: Session, jump_us: int
) -> None:
    session.pump(2.0)
    told_time(line, lambda: round(1e6 * line.clock_s) + jump_us)
    session.pump(0.2)
    told_time(line, lambda: round(1e6 * line.clock_s))
    session.pump(0.2)
    assert session.statistics.malformed in (3, 4, 5)
    assert session.heard_s == pytest.approx(line.clock_s, abs=0.1)


def test_a_reply_that_waited_to_be_read_tells_the_time_of_its_heartbeat(
    line: ScriptedLine, session: Session
) -> None:
    def held_up(frame: Frame) -> bytes:
        beat = Heartbeat.unpack(frame.payload)
        reply = HeartbeatReply(beat.t_host_us, int(line.clock_s * 1e6), 1, 0, 0, 0).pack()
        line.clock_s += 10.0  # the host is busy, and events of these seconds come with the reply
        return reply_to(frame, reply)

    line.answers[Heartbeat.ID] = held_up
    session.pump(0.2)
    assert session.latest_s >= line.clock_s


def test_an_answer_that_was_overtaken_is_neither_followed_nor_malformed(
    line: ScriptedLine, session: Session
) -> None:
    session.pump(1.0)
    held: list[bytes] = []

    def by_pairs(frame: Frame) -> bytes:
        beat = Heartbeat.unpack(frame.payload)
        held.append(
            reply_to(frame, HeartbeatReply(beat.t_host_us, int(line.clock_s * 1e6), 1, 0, 0, 0).pack())
        )
        return b"".join(held.pop() for _ in range(2)) if len(held) == 2 else b""

    line.answers[Heartbeat.ID] = by_pairs
    before_s = session.heard_s
    session.pump(1.0)
    assert session.statistics.malformed == 0
    assert session.heard_s > before_s + 0.8
    assert session.statistics.heartbeats_answered > 30


def test_an_answer_to_no_heartbeat_is_counted(line: ScriptedLine, session: Session) -> None:
    session.pump(1.0)
    beat = HeartbeatReply(12_345, round(1e6 * line.clock_s), 1, 0, 0, 0)
    line.answers[Heartbeat.ID] = lambda frame: reply_to(frame, beat.pack())
    session.pump(0.07)
    assert session.statistics.malformed >= 1


def test_a_repeated_frame_of_telemetry_is_dropped_and_counted(line: ScriptedLine, session: Session) -> None:
    seen: list[int] = []
    session.subscribe(Tlm, lambda frame: seen.append(frame.counter))
    for counter in (65534, 65535, 65535, 0, 65534, 2, 1):
        line.send(Tlm(counter, 0, 1000, 0, 0, b""))
    session.pump(0.1)
    assert seen == [65534, 65535, 0, 2]
    assert (session.statistics.repeated_frames, session.statistics.lost_frames) == (3, {"TLM": 1})


def test_a_restart_of_the_controller_is_a_lost_link(line: ScriptedLine, session: Session) -> None:
    causes: list[int] = []
    session.subscribe(Boot, lambda boot: causes.append(boot.reset_cause))
    line.send(Boot(3, 12), session=0)
    with pytest.raises(LinkLost, match=r"scripted restarted: its supply dipped \(boot 12\)"):
        session.pump(1.0)
    assert causes == [3]


def test_a_restart_while_a_reply_is_awaited_is_told_as_such_and_at_the_start_welcome(
    line: ScriptedLine, session: Session
) -> None:
    line.answers[PiezoSet.ID] = lambda _: line.frame(Boot(1, 2), session=0)
    with pytest.raises(LinkLost, match="restarted: somebody restarted it"):
        session.request(PiezoSet(1.0, 1.0))
    line.send(Boot(1, 2), session=0)
    session.open()


def test_reports_of_another_session_are_dropped_and_counted(line: ScriptedLine, session: Session) -> None:
    seen: list[Log] = []
    session.subscribe(Log, seen.append)
    line.send(Log(1, "old"), session=line.session ^ 0x10)
    line.send(Log(1, "new"))
    session.pump(0.1)
    assert [log.text for log in seen] == ["new"]
    assert session.statistics.other_session == 1


def test_damage_and_nonsense_are_counted_not_fatal(line: ScriptedLine, session: Session) -> None:
    line.to_host += b"\0AT+GCAP\r\n\0"
    line.to_host += encode_frame(Tlm.ID, 0, line.session, 0, b"short")
    line.to_host += encode_frame(0xBF, 0, line.session, 0, b"")
    line.to_host += encode_frame(0x3F, 0, line.session, 0, b"")
    line.to_host += encode_frame(Heartbeat.ID | 0x40, 0, line.session, 0, b"")
    session.pump(0.1)
    statistics = session.statistics
    assert (statistics.bad_frames, statistics.malformed, statistics.unknown_types) == (1, 2, 2)


def test_a_subscriber_that_raises_stops_the_wait_and_loses_nothing(
    line: ScriptedLine, session: Session
) -> None:
    texts: list[str] = []

    def fail(_: Fault) -> None:
        raise MachineFault("boom", fault=1001)

    session.subscribe(Fault, fail)
    session.subscribe(Log, lambda log: texts.append(log.text))
    line.send(Log(1, "before"))
    line.send(Fault(1, 0, 1001, 0, 0.0, 0.0))
    line.send(Log(1, "after"))
    with pytest.raises(MachineFault):
        session.pump(1.0)
    assert texts == ["before"]
    session.pump(0.1)
    assert texts == ["before", "after"]


def test_a_subscriber_may_send_a_command_itself(line: ScriptedLine, session: Session) -> None:
    replies: list[object] = []
    line.answers[GetParam.ID] = lambda frame: reply_to(frame, GetParamReply(5).pack())
    session.subscribe(Event, lambda _: replies.append(session.request(GetParam(1))))
    line.answers[PiezoSet.ID] = lambda frame: line.frame(EVENT) + reply_to(frame)
    session.request(PiezoSet(1.0, 1.0))
    assert replies == [GetParamReply(5)]


def test_pump_until_ends_as_soon_as_its_condition_holds(line: ScriptedLine, session: Session) -> None:
    seen: list[Event] = []
    session.subscribe(Event, seen.append)
    line.later.append((line.clock_s + 0.3, line.frame(EVENT)))
    start_s = line.clock_s
    assert session.pump_until(lambda: bool(seen), 5.0)
    assert line.clock_s - start_s == pytest.approx(0.3)
    assert not session.pump_until(lambda: len(seen) > 1, 0.2)
    assert line.clock_s - start_s == pytest.approx(0.5)


def test_abort_is_a_run_of_zeros_and_close_gives_the_line_back(line: ScriptedLine, session: Session) -> None:
    session.abort()
    assert line.raw.endswith(ABORT)
    session.close()
    assert line.closed
