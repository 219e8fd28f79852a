"""The line over pyserial: bytes as they come, one error for every way in which a port fails, nothing left behind."""

from __future__ import annotations

import os
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep

import pytest

from edmctl.errors import LinkLost
from edmctl.link import serial_line
from edmctl.link.heartbeat import HUNG_S
from edmctl.link.messages import Arm, GetStatus, State, param_crc
from edmctl.link.serial_line import SerialLine, open_port
from edmctl.link.session import HEARTBEAT_S, Session
from edmctl.machine.interface import default_settings
from edmctl.simulator import BenchConfig, open_bench
from tests.serving import serving

BAUD = 500_000
PATIENCE_S = 10.0
SPEED = 5.0


@dataclass(slots=True)
class Terminal:
    """A pty without a controller: our end of it, and the name that is opened."""

    ours: int
    theirs: int
    name: str

    def unplug(self) -> None:
        """Close both ends of ours."""
        for number in (self.ours, self.theirs):
            if number >= 0:
                os.close(number)
        self.ours = self.theirs = -1


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    """Return a raw pty."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    made = Terminal(ours, theirs, os.ttyname(theirs))
    yield made
    made.unplug()


@contextmanager
def opened(name: str) -> Iterator[SerialLine]:
    line = SerialLine(name, open_port(name, BAUD))
    try:
        yield line
    finally:
        line.close()


def resources() -> tuple[int, int]:
    """How many threads and file descriptors this process has."""
    return threading.active_count(), sum(1 for _ in Path("/proc/self/fd").iterdir())


@contextmanager
def later(action: Callable[[], object]) -> Iterator[None]:
    """Do something from another thread while the block waits."""
    timer = threading.Timer(0.03, action)
    timer.start()
    try:
        yield
    finally:
        timer.join()


def repeatedly(action: Callable[[], object]) -> None:
    """Do something until it raises."""
    end_s = monotonic() + PATIENCE_S
    while monotonic() < end_s:
        action()


def test_bytes_go_both_ways_as_they_are(terminal: Terminal) -> None:
    every = bytes(range(256))
    with opened(terminal.name) as line:
        os.write(terminal.ours, every)
        got = b""
        while len(got) < len(every):
            got += line.read(PATIENCE_S)
        assert got == every
        line.write(every)
        assert os.read(terminal.ours, 1000) == every
        assert line.read(0.0) == b""
        assert line.live


def test_a_read_ends_as_soon_as_anything_comes(terminal: Terminal) -> None:
    with opened(terminal.name) as line, later(lambda: os.write(terminal.ours, b"news")):
        begin_s = line.now_s()
        assert line.read(PATIENCE_S) == b"news"
        assert line.now_s() - begin_s < 0.5 * PATIENCE_S


def test_a_read_that_gets_nothing_ends_in_time(terminal: Terminal) -> None:
    with opened(terminal.name) as line:
        begin_s = line.now_s()
        assert line.read(0.02) == b""
        assert 0.019 < line.now_s() - begin_s < PATIENCE_S


def test_unplugging_wakes_the_reader_and_every_later_call_says_so(terminal: Terminal) -> None:
    with opened(terminal.name) as line:
        with later(terminal.unplug):
            begin_s = line.now_s()
            with pytest.raises(LinkLost, match="broke") as lost:
                line.read(PATIENCE_S)
            assert line.now_s() - begin_s < 0.5 * PATIENCE_S
        assert lost.value.code == "E4003"
        assert terminal.name in lost.value.message
        for again in (lambda: line.read(0.0), lambda: line.write(b"x")):
            with pytest.raises(LinkLost) as later_lost:
                again()
            assert later_lost.value is lost.value


def test_a_write_into_a_line_that_broke_is_the_same_error(terminal: Terminal) -> None:
    with opened(terminal.name) as line:
        terminal.unplug()
        with pytest.raises(LinkLost) as lost:
            repeatedly(lambda: line.write(b"x"))
        assert lost.value.code == "E4003"


def test_what_came_before_the_line_broke_is_still_read(terminal: Terminal) -> None:
    with opened(terminal.name) as line:
        os.write(terminal.ours, b"last words")
        while not line._arrived:
            sleep(0.0)
        terminal.unplug()
        assert line.read(PATIENCE_S) == b"last words"
        with pytest.raises(LinkLost):
            line.read(PATIENCE_S)


def test_a_line_that_takes_nothing_is_lost_soon(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_line, "WRITE_TIMEOUT_S", 0.05)
    with opened(terminal.name) as line:
        begin_s = monotonic()
        with pytest.raises(LinkLost, match="takes no more bytes") as lost:
            line.write(bytes(1_000_000))
        assert monotonic() - begin_s < 2.0
        assert lost.value.code == "E4003"
        with pytest.raises(LinkLost):
            line.write(b"x")


def test_a_computer_that_stands_still_while_it_writes_has_lost_nothing(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = os.write

    def slowly(number: int, data: bytes) -> int:
        """Come back from a write that took everything only when its time is long over."""
        length = taken(number, data)
        sleep(0.05)
        return length

    monkeypatch.setattr(serial_line, "WRITE_TIMEOUT_S", 0.01)
    with opened(terminal.name) as line:
        with monkeypatch.context() as still:
            still.setattr(os, "write", slowly)
            line.write(b"all of it")
        assert os.read(terminal.ours, 100) == b"all of it"


@pytest.mark.parametrize("unplugged", [False, True])
def test_closing_leaves_nothing_behind_and_may_be_done_twice(terminal: Terminal, unplugged: bool) -> None:
    before = resources()
    line = SerialLine(terminal.name, open_port(terminal.name, BAUD))
    assert resources() > before
    if unplugged:
        terminal.unplug()
        before = before[0], before[1] - 2
    line.close()
    line.close()
    assert resources() == before
    for call in (lambda: line.read(1.0), lambda: line.write(b"x")):
        with pytest.raises(LinkLost) as lost:
            call()
        assert lost.value.code == "E4003"


def test_closing_ends_a_read_of_another_thread(terminal: Terminal) -> None:
    line = SerialLine(terminal.name, open_port(terminal.name, BAUD))
    with later(line.close), pytest.raises(LinkLost, match="closed"):
        line.read(PATIENCE_S)


def test_a_socket_that_is_closed_is_a_line_that_broke() -> None:
    before = resources()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"socket://127.0.0.1:{listener.getsockname()[1]}"
        with opened(url) as line:
            other, _ = listener.accept()
            other.sendall(b"hello")
            assert line.read(PATIENCE_S) == b"hello"
            line.write(b"back")
            assert other.recv(10) == b"back"
            with later(other.close), pytest.raises(LinkLost) as lost:
                line.read(PATIENCE_S)
            assert lost.value.code == "E4003"
    assert resources() == before


def test_small_frames_on_a_socket_do_not_wait_for_each_other() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = open_port(f"socket://127.0.0.1:{listener.getsockname()[1]}", BAUD)
        with socket.socket(fileno=os.dup(port.fileno())) as same:
            assert same.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        port.close()


def test_urls_without_a_file_descriptor_work() -> None:
    before = resources()
    with opened("loop://") as line:
        line.write(b"round")
        got = b""
        while len(got) < 5:
            got += line.read(PATIENCE_S)
        assert got == b"round"
    assert resources() == before


def test_a_spy_sees_both_ways(terminal: Terminal, capsys: pytest.CaptureFixture[str]) -> None:
    with opened(f"spy://{terminal.name}") as line:
        line.write(b"out")
        os.write(terminal.ours, b"in")
        assert line.read(PATIENCE_S)
    shown = capsys.readouterr().err
    assert " TX " in shown
    assert " RX " in shown


@contextmanager
def session_at(name: str) -> Iterator[Session]:
    session = Session(SerialLine(name, open_port(name, BAUD)))
    try:
        session.open(PATIENCE_S)
        yield session
    finally:
        session.close()


@contextmanager
def armed_session(name: str) -> Iterator[Session]:
    with session_at(name) as session:
        session.request(Arm(param_crc(default_settings())))
        yield session


def state_of(session: Session) -> tuple[State, int]:
    status = session.request(GetStatus())
    return State(status.state), status.fault


def test_an_armed_machine_stays_armed_while_the_main_thread_is_away() -> None:
    with serving(open_bench(BenchConfig(), 1), SPEED) as name, armed_session(name) as session:
        beats = session.statistics.heartbeats_sent
        # Being away is what is tested: longer than the watchdog of 0.25 s, shorter than what counts as hanging.
        sleep(0.4)
        assert session.statistics.heartbeats_sent >= beats + 0.4 / HEARTBEAT_S / 2
        assert state_of(session) == (State.ARMED, 0)


def test_a_main_loop_that_hangs_does_not_look_alive() -> None:
    bench = open_bench(BenchConfig(), 1)
    with serving(bench, SPEED) as name, armed_session(name) as session:
        session._moved_s -= 2.0 * HUNG_S
        end_s = monotonic() + PATIENCE_S
        while bench.controller.state is not State.FAULT:
            assert monotonic() < end_s
            sleep(0.005)
        assert state_of(session) == (State.FAULT, 1001)


def test_a_controller_that_is_gone_while_its_port_stays_is_missed_soon() -> None:
    bench = open_bench(BenchConfig(), 1)
    with serving(bench, SPEED) as name, armed_session(name) as session:
        # The server stops serving; its pty is closed only at the end of the block.
        bench.line.unplugged = True
        with pytest.raises(LinkLost) as lost:
            repeatedly(lambda: session.pump(0.1))
        assert "heartbeat" not in {thread.name for thread in threading.enumerate()}
    assert lost.value.code == "E4012"
