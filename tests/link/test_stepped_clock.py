"""A line whose time is the host's to give: the run is the same as without a line."""

from __future__ import annotations

from random import Random

import pytest

from edmctl.errors import LinkLost
from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.session import Session
from edmctl.link.transport import SteppedLine
from edmctl.simulator import BenchConfig, open_bench


class Served:
    """The virtual controller behind a line of the computer's clock, its own clock driven; bytes come in pieces."""

    name, live = "served", True

    def __init__(self, seed: int, piece: int = 100, *, refuses: bool = False) -> None:
        self.bench = open_bench(BenchConfig(), seed)
        self.bench.controller.link.driven = True
        self._decoder = FrameDecoder()
        self._out = bytearray()
        self._piece = piece
        self._refuses = refuses
        self._clock_s = 0.0
        self.deaf = False
        self.beats_to_lose = 0

    def now_s(self) -> float:
        return self._clock_s

    def close(self) -> None:
        return

    def write(self, data: bytes) -> None:
        controller = self.bench.controller
        for frame in self._decoder.feed(data):
            if frame.type_id == m.Heartbeat.ID and self.beats_to_lose:
                self.beats_to_lose -= 1
                continue
            if self._refuses and frame.type_id == m.Advance.ID:
                self._out += encode_frame(
                    m.Advance.ID | 0x40, frame.seq, frame.session, m.Status.UNKNOWN_TYPE, b""
                )
                continue
            controller.receive(encode_frame(*frame))
            if controller.link.greeting:
                controller.host_wait.wait(0.0)
            if controller.link.due:
                self._out += controller.link.take_output()

    def read(self, timeout_s: float) -> bytes:
        if not self._out or self.deaf:
            self._clock_s += timeout_s
            return b""
        data, self._out = bytes(self._out[: self._piece]), self._out[self._piece :]
        return data


def telemetry(session: Session) -> list[bytes]:
    seen: list[bytes] = []
    session.subscribe(m.Tlm, lambda message: seen.append(message.pack()))
    session.open()
    session.request(m.TlmStart(1000, 10, m.PulseLog.OFF))
    session.request(m.Arm(m.param_crc({})))
    session.request(m.PiezoSet(30.0, 60.0))
    session.pump(1.0)
    return seen


@pytest.mark.parametrize("piece", [1, 100, 100_000])
def test_a_run_over_a_driven_line_is_the_run_without_a_line(piece: int) -> None:
    alone = open_bench(BenchConfig(), 3)
    expected = telemetry(Session(alone.transport, Random(1)))
    served = Served(3, piece)
    session = Session(served, Random(1))
    assert telemetry(session) == expected
    assert session.transport.now_s() == alone.transport.now_s()
    assert session.machine_now_s() == session.transport.now_s()
    assert session.transport.live is False
    assert session.statistics.stray_replies == 0
    session.close()


@pytest.mark.parametrize(("lost", "fault"), [(3, 0), (5, FaultCode.HOST_SILENT)])
def test_an_armed_machine_on_a_driven_line_outlives_lost_heartbeats_as_on_a_live_one(
    lost: int, fault: int
) -> None:
    served = Served(1)
    session = Session(served, Random(1))
    session.open()
    session.request(m.Arm(m.param_crc({})))
    session.pump(1.0)
    served.beats_to_lose = lost
    session.pump(1.0)
    assert served.bench.controller.fault == fault


def test_a_session_on_a_driven_line_can_be_opened_again() -> None:
    session = Session(Served(1), Random(1))
    session.open()
    session.pump(0.5)
    time_s = session.transport.now_s()
    session.open()
    session.pump(0.5)
    assert session.transport.now_s() > time_s


def test_a_simulator_that_does_not_answer_is_a_lost_link() -> None:
    served = Served(1)
    line = SteppedLine(served, 1)
    served.deaf = True
    with pytest.raises(LinkLost, match="did not let time pass within 20 s") as caught:
        line.read(0.1)
    assert "edmctl simulate serve" in caught.value.hint


def test_a_controller_that_says_driven_and_refuses_is_told_so() -> None:
    with pytest.raises(LinkLost, match="refuses ADVANCE"):
        Session(Served(1, refuses=True), Random(1)).open()


def test_a_clock_that_stands_still_for_good_is_a_lost_link() -> None:
    line = Frozen(3, piece=10_000)
    session = Session(line, Random(1))
    session.open()
    line.frozen = True
    with pytest.raises(LinkLost, match="lets no time pass in 1000 waits") as caught:
        session.pump(1.0)
    assert caught.value.code == "E4008"


class Frozen(Served):
    """A controller whose answers to ADVANCE stop telling the time, once `frozen`."""

    frozen = False

    def read(self, timeout_s: float) -> bytes:
        data = super().read(timeout_s)
        if not self.frozen:
            return data
        parts = [part for part in data.split(b"\0") if part]
        return b"".join(self._stopped(b"\0" + part + b"\0") for part in parts)

    @staticmethod
    def _stopped(whole: bytes) -> bytes:
        (frame,) = FrameDecoder().feed(whole)
        if frame.type_id != m.Advance.ID | 0x40:
            return whole
        return encode_frame(*frame[:4], m.AdvanceReply(12_345).pack())
