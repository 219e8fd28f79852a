"""The heartbeat of a live line: it beats by itself, and not for a host that hangs."""

from __future__ import annotations

import threading

from edmctl.errors import LinkLost
from edmctl.link.heartbeat import HUNG_S, HeartbeatThread

PATIENCE_S = 10.0


class Counter:
    """Counts calls and tells when there were five."""

    def __init__(self) -> None:
        self.calls = 0
        self.five = threading.Event()

    def __call__(self) -> None:
        self.calls += 1
        if self.calls >= 5:
            self.five.set()


def test_it_beats_until_it_is_stopped() -> None:
    beat = Counter()
    thread = HeartbeatThread(beat, lambda: 0.0, 0.001)
    thread.start()
    assert beat.five.wait(PATIENCE_S)
    thread.stop()
    calls = beat.calls
    assert "heartbeat" not in {thread.name for thread in threading.enumerate()}
    assert beat.calls == calls


def test_a_main_loop_that_hangs_silences_it() -> None:
    beat, looked = Counter(), Counter()

    def idle_s() -> float:
        looked()
        return HUNG_S + 0.1

    thread = HeartbeatThread(beat, idle_s, 0.001)
    thread.start()
    assert looked.five.wait(PATIENCE_S)
    thread.stop()
    assert beat.calls == 0


def test_a_main_loop_that_comes_back_is_heard_again() -> None:
    beat, idle_s = Counter(), [HUNG_S + 1.0] * 5

    thread = HeartbeatThread(beat, lambda: idle_s.pop() if idle_s else 0.0, 0.001)
    thread.start()
    assert beat.five.wait(PATIENCE_S)
    thread.stop()


def test_a_dead_line_ends_it_quietly() -> None:
    gone = threading.Event()

    def beat() -> None:
        gone.set()
        raise LinkLost("gone")

    thread = HeartbeatThread(beat, lambda: 0.0, 0.001)
    thread.start()
    assert gone.wait(PATIENCE_S)
    thread.stop()
    assert "heartbeat" not in {thread.name for thread in threading.enumerate()}


def test_stopping_before_the_start_is_no_mistake() -> None:
    HeartbeatThread(lambda: None, lambda: 0.0, 1.0).stop()
