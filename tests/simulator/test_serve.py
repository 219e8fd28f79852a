"""The served controller: the same bytes as in process, one client at a time, and never a line that blocks it."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from random import Random
from typing import Any

import pytest

from edmctl.errors import LinkLost
from edmctl.link import gate
from edmctl.link import messages as m
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.opening import open_line
from edmctl.link.session import Session
from edmctl.simulator import BenchConfig, open_bench, serve
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.serve import Endpoint, EventMonitor, PtyEndpoint, Server, SocketEndpoint
from tests.serving import serving

NEAR = BenchConfig(offset_um=20.0)
HELLO = encode_frame(m.Hello.ID, 0, 9, 0, m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 77, m.SCHEMA_HASH).pack())
PATIENCE_S = 10.0


@contextmanager
def running(server: Server, endpoint: Endpoint) -> Iterator[None]:
    over = threading.Event()
    thread = threading.Thread(target=server.run, args=(over.is_set,), name="server")
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        endpoint.close()


def until(done: Callable[[], bool]) -> bool:
    end_s = time.monotonic() + PATIENCE_S
    while not done() and time.monotonic() < end_s:
        time.sleep(0.002)
    return done()


def replies(receive: Callable[[], bytes], count: int = 1) -> list[Any]:
    decoder, frames = FrameDecoder(watch_for_abort=False), list[Any]()
    end_s = time.monotonic() + PATIENCE_S
    while len(frames) < count and time.monotonic() < end_s:
        frames += decoder.feed(receive())
    return frames


def client_of(endpoint: SocketEndpoint) -> socket.socket:
    host, port = endpoint.name.removeprefix("socket://").rsplit(":", 1)
    return socket.create_connection((host, int(port)), timeout=PATIENCE_S)


def job(session: Session) -> list[bytes]:
    """A short cut with telemetry and every pulse; what was told of it."""
    told: list[bytes] = []
    session.subscribe(m.Tlm, lambda message: told.append(message.pack()))
    session.subscribe(m.Pulses, lambda message: told.append(message.pack()))
    session.subscribe(m.Event, lambda message: told.append(message.pack()))
    session.open()
    session.request(m.TlmStart(1000, 10, m.PulseLog.FULL))
    crc = m.param_crc({})
    session.request(m.PulseConfig(130.435, 304.348, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0))
    session.request(m.Arm(crc))
    session.request(m.PulseEnable(1))
    session.request(m.StageMove(m.Axis.X, 0, 50_000_000))
    session.pump(0.5)
    session.request(m.Approach(10.0, 120.0, 10.8))
    session.pump(4.0)
    session.request(m.ServoStart(9.6, 500.0, 100.0))
    session.pump(2.0)
    session.request(m.Disarm())
    session.pump(1.0)
    session.close()
    return told


def test_a_driven_job_over_a_pty_is_the_job_in_process() -> None:
    alone = open_bench(NEAR, 4)
    expected = job(Session(alone.transport, Random(1)))
    bench = open_bench(NEAR, 4)
    with serving(bench) as path:
        assert job(Session(open_line(path), Random(1))) == expected
    assert bench.controller.tick == alone.controller.tick
    assert bench.truth() == alone.truth()
    assert len(expected) > 500


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_clients_in_turn_talk_to_the_same_running_machine(speed: float) -> None:
    bench = open_bench(NEAR, 4)
    with serving(bench, speed) as path:
        times_s = []
        for turn in range(2):
            session = Session(open_line(path), Random(turn))
            hello = session.open()
            assert (hello.serial, hello.clock, hello.boot_count) == ("SIM-4", m.Clock.RUNNING, 1)
            session.pump(0.05)
            times_s.append(session.machine_now_s())
            session.close()
    assert times_s[1] > times_s[0] > 0.0


def test_at_a_speed_the_watchdog_goes_by_the_clock_on_the_wall() -> None:
    bench = open_bench(NEAR, 4)
    with serving(bench, 50.0) as path:
        line = open_line(path)
        session = Session(line, Random(1))
        session.open()
        session.request(m.Arm(m.param_crc({})))
        armed = bench.controller.tick
        session.pump(15.0)  # of the controller's time: 0.3 s on the wall, more than the watchdog's
        assert bench.controller.armed
        assert bench.controller.tick - armed > 10_000
        session.close()
        assert until(lambda: bench.controller.fault == 1001)


def test_a_socket_has_one_client_at_a_time_and_then_the_next() -> None:
    bench, said = open_bench(NEAR, 4), list[str]()
    endpoint = SocketEndpoint("127.0.0.1", 0, said.append)
    with running(Server(bench, endpoint, 1.0), endpoint):
        with client_of(endpoint) as first:
            first.sendall(HELLO)
            (reply,) = replies(lambda: first.recv(4096))
            assert m.HelloReply.unpack(reply.payload).host_nonce == 77
            with client_of(endpoint) as second:
                assert second.makefile("rb").read() == gate.line_of(gate.BUSY)
            first.sendall(HELLO)
            assert replies(lambda: first.recv(4096))
        assert until(lambda: not endpoint.has_client())
        with client_of(endpoint) as third:
            third.sendall(HELLO)
            assert replies(lambda: third.recv(4096))
    assert len(said) == 1
    assert "(busy), 1 in all" in said[0]


def test_only_a_client_that_is_silent_makes_room_for_another(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, said = open_bench(NEAR, 4), list[str]()
    endpoint = SocketEndpoint("127.0.0.1", 0, said.append)
    with running(Server(bench, endpoint, 1.0), endpoint), client_of(endpoint) as silent:
        assert until(endpoint.has_client)
        monkeypatch.setattr(serve, "SILENT_S", 0.2)
        time.sleep(0.3)
        silent.sendall(b"\0no frame at all\0")
        with client_of(endpoint) as second:
            second.sendall(HELLO)
            assert replies(lambda: second.recv(4096))
            assert silent.recv(100) == b""
    assert "silent for" in said[0]


SECRET = b"what nobody on the way has read"


def open_secretly(endpoint: SocketEndpoint, secret: bytes) -> Session:
    session = Session(open_line(endpoint.name, secret=secret), Random(1))
    session.open()
    return session


def test_a_socket_with_a_secret_takes_who_knows_it_and_nobody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, said = open_bench(NEAR, 4), list[str]()
    endpoint = SocketEndpoint("127.0.0.1", 0, said.append, SECRET)
    with running(Server(bench, endpoint, 1.0), endpoint):
        for secret, told in ((b"", "asks for a secret"), (b"another secret entirely", "refused the secret")):
            with pytest.raises(LinkLost, match=told) as refused:
                open_secretly(endpoint, secret)
            assert refused.value.code == "E4023"
        with client_of(endpoint) as rude:
            rude.sendall(HELLO)
            with client_of(endpoint) as half_open:
                session = open_secretly(endpoint, SECRET)
                assert session.hello.serial == "SIM-4"
                with pytest.raises(LinkLost, match="another client") as busy:
                    open_line(endpoint.name, secret=SECRET)
                assert busy.value.code == "E4006"
                session.close()
                assert half_open.recv(100).startswith(gate.GREETING + gate.CHALLENGE)
            monkeypatch.setattr(serve, "GATE_S", 0.1)
            seen = rude.makefile("rb").read()
            assert seen.endswith(gate.line_of(gate.REFUSED))
    assert SECRET not in b"".join(text.encode() for text in said) + seen


def test_strangers_at_the_gate_are_few_and_do_not_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = open_bench(NEAR, 4)
    endpoint = SocketEndpoint("127.0.0.1", 0, secret=SECRET)
    with running(Server(bench, endpoint, 1.0), endpoint), ExitStack() as others:
        strangers = [others.enter_context(client_of(endpoint)) for _ in range(40)]
        assert until(lambda: len(endpoint.descriptors()) == 1 + serve.MOST_AT_GATE)
        monkeypatch.setattr(serve, "GATE_S", 0.1)
        assert until(lambda: len(endpoint.descriptors()) == 1)
        for stranger in strangers:
            assert stranger.makefile("rb").read().splitlines()[-1].startswith(gate.GREETING)
        open_secretly(endpoint, SECRET).close()


def test_only_this_computer_is_loopback() -> None:
    assert serve.is_loopback(serve.address_of("localhost"))
    assert not serve.is_loopback(serve.address_of("0.0.0.0"))
    assert not serve.is_loopback("::")
    for nobody in ("a..b", ".", "no such host"):
        with pytest.raises(LinkLost, match="no such host"):
            serve.address_of(nobody)


def test_whoever_comes_back_at_once_is_not_kept_out_by_itself() -> None:
    endpoint = SocketEndpoint("127.0.0.1", 0)
    with running(Server(open_bench(NEAR, 4), endpoint, None), endpoint):
        for _ in range(40):
            with client_of(endpoint) as client:
                client.sendall(HELLO)
                (reply,) = replies(lambda client=client: client.recv(4096))  # type: ignore[misc]
                assert m.HelloReply.unpack(reply.payload).host_nonce == 77


def test_a_client_that_does_not_read_loses_whole_frames_and_blocks_nothing() -> None:
    bench = open_bench(NEAR, 4)
    endpoint = PtyEndpoint()
    server = Server(bench, endpoint, 200.0)
    with running(server, endpoint):
        client = os.open(endpoint.name, os.O_RDWR | os.O_NOCTTY)
        os.write(client, HELLO)
        start = encode_frame(m.TlmStart.ID, 1, 9, 0, m.TlmStart(1000, 1, m.PulseLog.OFF).pack())
        os.write(client, start)
        assert until(lambda: server.traffic.dropped_frames > 100)
        os.write(client, encode_frame(m.TlmStop.ID, 2, 9, 0, m.TlmStop().pack()))
        os.set_blocking(client, False)
        decoder, counters = FrameDecoder(watch_for_abort=False), list[int]()

        def drained() -> bool:
            try:
                frames = decoder.feed(os.read(client, 65536))
            except BlockingIOError:
                return not server._waiting and server.traffic.frames_in == 3
            counters.extend(m.Tlm.unpack(f.payload).counter for f in frames if f.type_id == m.Tlm.ID)
            return False

        assert until(drained)
        os.close(client)
    assert decoder.bad == 0
    assert counters == sorted(counters)
    assert server.traffic.frames_in == 3


def test_a_machine_whose_driving_host_died_becomes_safe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edmctl.simulator.serve.ORPHANED_S", 0.05)
    monkeypatch.setattr("edmctl.simulator.serve._IDLE_S", 0.02)
    bench = open_bench(NEAR, 4)
    with serving(bench) as path:
        session = Session(open_line(path), Random(1))
        session.open()
        session.request(m.Arm(m.param_crc({})))
        session.request(m.PiezoSet(30.0, 600.0))
        session.pump(0.1)
        tick = bench.controller.tick
        time.sleep(0.2)
        assert (bench.controller.tick, bench.controller.armed) == (tick, True)  # the host has the port open
        session.close()
        assert until(lambda: bench.is_safe)
    assert bench.controller.fault == 1001


ADVANCE = encode_frame(m.Advance.ID, 0, 9, 0, m.Advance(1000).pack())
ARM = encode_frame(m.Arm.ID, 1, 9, 0, m.Arm(m.param_crc({})).pack())


@pytest.mark.parametrize(
    ("pieces", "fault"),
    [((ADVANCE, b"\1" + bytes(5), bytes(4) + ADVANCE), 1002), ((ARM, b"\1\1\1\0" * 100 + ADVANCE), 1003)],
    ids=["abort run in two reads", "bad frames"],
)
def test_what_bytes_bring_about_comes_before_the_frame_behind_them(
    pieces: tuple[bytes, ...], fault: int
) -> None:
    bench = open_bench(NEAR, 4)
    server = Server(bench, endpoint := PtyEndpoint(), None)
    client = os.open(endpoint.name, os.O_RDWR | os.O_NOCTTY)
    for data in (HELLO, *pieces):
        server._take(data)
        server._transmit()
    frames = replies(lambda: os.read(client, 4096), 4)
    os.close(client)
    endpoint.close()
    assert [f.type_id for f in frames[-2:]] == [m.Fault.ID, m.Advance.ID | 0x40]
    assert bench.controller.fault == fault


def test_a_session_survives_when_one_frame_in_twenty_is_damaged() -> None:
    bench = open_bench(NEAR, 4)
    bench.line.noise = 0.05
    with serving(bench) as path:
        session = Session(open_line(path), Random(1))
        session.open()
        for _ in range(100):
            assert session.request(m.GetStatus()).state == m.State.IDLE
        session.close()
    assert bench.controller.link.rx_bad > 3
    assert bench.controller.fault == 0


def test_an_unplugged_line_ends_the_server_and_the_client_is_told() -> None:
    bench = open_bench(NEAR, 4)
    endpoint = PtyEndpoint()
    server = Server(bench, endpoint, None)

    def serve() -> None:
        server.run(lambda: False)
        endpoint.close()

    thread = threading.Thread(target=serve, name="server")
    thread.start()
    try:
        session = Session(open_line(endpoint.name), Random(1))
        session.open()
        session.request(m.Arm(m.param_crc({})))
        bench.inject(parse_injection("UNPLUG@0"))
        with pytest.raises(LinkLost):
            session.pump(0.1)
        session.close()
    finally:
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


def test_news_of_faults_and_injections() -> None:
    bench, said, rests = open_bench(NEAR, 4), list[str](), list[int]()
    news = EventMonitor(bench, said.append, lambda: rests.append(bench.controller.tick))
    session = Session(bench.transport, Random(1))
    session.open()
    session.request(m.Arm(m.param_crc({})))
    bench.inject(parse_injection("DOOR@0.1"))
    for _ in range(20):
        session.pump(0.01)
        news()
    bench.clear_injections()
    session.request(m.ClearFault(4002))
    news()
    assert [text.partition(" s: ")[2] for text in said] == [
        "DOOR@0.1 happened",
        "fault 4002 DOOR latched",
        "fault 4002 DOOR cleared",
    ]
    assert (news.faults, len(rests)) == ([4002], 1)


def test_a_link_is_published_and_removed_and_only_a_dangling_one_replaced(tmp_path: Path) -> None:
    link, other = tmp_path / "edm", tmp_path / "other"
    link.symlink_to(tmp_path / "gone")
    endpoint = PtyEndpoint(link)
    assert link.readlink() == Path(endpoint.device)
    with pytest.raises(LinkLost, match="Cannot make the link"):
        PtyEndpoint(link)
    other.write_text("mine")
    with pytest.raises(LinkLost, match="exists"):
        PtyEndpoint(other)
    assert other.read_text() == "mine"
    link.unlink()
    second = PtyEndpoint(link)
    endpoint.close()
    assert link.exists(), "it is another server's by now"
    second.close()
    assert not os.path.lexists(link)


def test_a_pty_tells_whether_somebody_has_it_open() -> None:
    endpoint = PtyEndpoint()
    assert not endpoint.has_client()
    client = os.open(endpoint.device, os.O_RDWR | os.O_NOCTTY)
    os.write(client, b"\0abc\r\n\x03")
    assert endpoint.has_client()
    assert endpoint.receive() == b"\0abc\r\n\x03"
    endpoint.transmit(b"\0\x11\x13\n")
    assert os.read(client, 10) == b"\0\x11\x13\n"
    os.close(client)
    assert not endpoint.has_client()
    endpoint.close()


def test_an_address_in_use_is_named() -> None:
    endpoint = SocketEndpoint("127.0.0.1", 0)
    port = int(endpoint.name.rsplit(":", 1)[1])
    with pytest.raises(LinkLost, match=f"Cannot serve on 127.0.0.1:{port}"):
        SocketEndpoint("127.0.0.1", port)
    endpoint.close()


def test_a_computer_that_is_too_slow_says_so_once(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = open_bench(NEAR, 4)
    endpoint, said = PtyEndpoint(), list[str]()
    server = Server(bench, endpoint, 1.0, say=said.append)
    now_s = time.monotonic()
    for late_s in (0.01, 0.1, 5.0, 10.0):
        monkeypatch.setattr("edmctl.simulator.serve.monotonic", lambda late_s=late_s: now_s + late_s)
        server._follow_clock(1.0)
    endpoint.close()
    assert len(said) == 1
    assert "too slow for 1x" in said[0]
    assert server.traffic.slowest_s > 1.0
    assert server.traffic.paused_s > 8.0
    assert bench.controller.tick < 200


def armed_at_a_speed(said: list[str]) -> tuple[Server, PtyEndpoint, int]:
    """A server at 1x with an armed machine, tool out at 20 V, and its client's file; nothing waits in the line."""
    bench = open_bench(NEAR, 4)
    server = Server(bench, endpoint := PtyEndpoint(), 1.0, say=said.append)
    client = os.open(endpoint.name, os.O_RDWR | os.O_NOCTTY)
    ramp = encode_frame(m.PiezoSet.ID, 2, 9, 0, m.PiezoSet(20.0, 10_000.0).pack())
    server._take(HELLO + encode_frame(m.Arm.ID, 1, 9, 0, m.Arm(m.param_crc({})).pack()) + ramp)
    bench.controller.advance(100)
    server._transmit()
    os.read(client, 4096)
    return server, endpoint, client


@pytest.mark.parametrize(("away_s", "trips"), [(0.2, False), (0.3, True), (2.0, True)])
def test_a_server_that_stood_still_trips_the_watchdog_before_it_reads_what_piled_up(
    monkeypatch: pytest.MonkeyPatch, away_s: float, trips: bool
) -> None:
    said: list[str] = []
    server, endpoint, client = armed_at_a_speed(said)
    controller = server._bench.controller
    now_s = time.monotonic()
    monkeypatch.setattr("edmctl.simulator.serve.monotonic", lambda: now_s)
    server.turn()
    beats = [encode_frame(m.Heartbeat.ID, n, 9, 0, m.Heartbeat(n, 0).pack()) for n in range(140)]
    os.write(client, b"".join(beats[:40]) + encode_frame(m.ServoStop.ID, 3, 9, 0, m.ServoStop().pack()))
    now_s += away_s
    server.turn()
    frames = FrameDecoder(watch_for_abort=False).feed(os.read(client, 8192))
    (stopped,) = [f.flags for f in frames if f.type_id == m.ServoStop.ID | 0x40]
    assert (controller.fault == 1001, stopped == m.Status.BAD_STATE, len(said) > 0) == (trips, trips, trips)
    for beat in beats[40:]:
        now_s += 0.01
        os.write(client, beat)
        server.turn()
    assert controller.armed is not trips
    assert controller.loop.command_v == (0.0 if trips else 20.0)
    os.close(client)
    endpoint.close()


def test_a_driven_clock_has_no_watchdog_on_the_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    server, endpoint, client = armed_at_a_speed([])
    server._speed = None
    now_s = time.monotonic() + 10.0
    monkeypatch.setattr("edmctl.simulator.serve.monotonic", lambda: now_s)
    server.turn()
    assert server._bench.controller.armed
    os.close(client)
    endpoint.close()
