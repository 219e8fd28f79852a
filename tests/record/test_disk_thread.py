"""Writes beside the line: it is attended to while the disk stands still, and the job waits for what it must."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

from edmctl.errors import EdmError, LinkLost, MachineFault, RunFileError
from edmctl.record import disk as disks
from edmctl.record.disk import DiskThread

PATH = Path("a.journal")
LONG_S = 30.0


class Line:
    """A line to a machine, and a disk that stands still until the line was attended to so many times."""

    def __init__(self) -> None:
        self.attended, self.frees_at = 0, 5
        self.free = threading.Event()

    def attend(self, is_done: Callable[[], bool]) -> None:
        self.attended += 1
        if self.attended >= self.frees_at:
            self.free.set()

    def write(self) -> None:
        assert self.free.wait(LONG_S)


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[Line]:
    monkeypatch.setattr(disks, "PROMPT_S", 0.0)
    line = Line()
    yield line
    line.free.set()
    join_disk()


def join_disk() -> None:
    for thread in threading.enumerate():
        if thread.name == "disk":
            thread.join(LONG_S)


def test_writes_keep_their_order_and_what_nothing_waits_for_is_left_out(line: Line) -> None:
    disk, written = DiskThread(line.attend), list[int]()

    def slowly() -> None:
        line.write()
        written.append(1)

    assert disk.start(slowly)
    assert not disk.start(lambda: written.append(-1))
    disk.run(PATH, lambda: written.append(2))
    assert line.attended >= line.frees_at
    assert disk.start(lambda: written.append(3))
    disk.close()
    assert written == [1, 2, 3]
    assert "disk" not in {thread.name for thread in threading.enumerate()}


def refused() -> None:
    raise OSError(28, "No space left on device")


def test_what_a_write_raises_comes_out(line: Line) -> None:
    disk = DiskThread(line.attend)
    with pytest.raises(OSError, match="No space left"):
        disk.run(PATH, refused)
    assert disk.start(refused)
    disk.close()
    with pytest.raises(OSError, match="No space left"):
        disk.start(lambda: None)
    assert disk.start(lambda: None)


def test_a_disk_that_hangs_ends_the_job_and_takes_what_is_left_when_it_comes_back(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disks, "GIVE_UP_S", 0.05)
    line.frees_at = 10**12
    disk, written = DiskThread(line.attend), list[int]()
    with pytest.raises(RunFileError, match=r"a\.journal is not written") as hung:
        disk.run(PATH, line.write)
    assert hung.value.code == "E9009"
    begun_s = time.monotonic()
    monkeypatch.setattr(disks, "GIVE_UP_S", LONG_S)
    with pytest.raises(RunFileError, match="is not written"):
        disk.run(PATH, line.write)
    disk.close()
    assert time.monotonic() - begun_s < LONG_S
    line.free.set()
    join_disk()
    monkeypatch.setattr(disks, "PROMPT_S", 0.01)
    disk.run(PATH, lambda: written.append(1))
    assert written == [1]


def test_where_time_stands_still_nothing_runs_beside(line: Line) -> None:
    ran_in = list[int]()
    disk = DiskThread()
    disk.run(PATH, lambda: ran_in.append(threading.get_ident()))
    assert disk.start(lambda: ran_in.append(threading.get_ident()))
    assert ran_in == [threading.get_ident()] * 2


@pytest.mark.parametrize("error", [LinkLost("gone"), MachineFault("a fault")])
def test_what_the_line_raises_meanwhile_stops_no_write(line: Line, error: EdmError) -> None:
    def attend(_: Callable[[], bool]) -> None:
        line.free.set()
        raise error

    disk, written = DiskThread(attend), list[int]()
    disk.start(line.write)
    with nullcontext() if isinstance(error, LinkLost) else pytest.raises(MachineFault, match="a fault"):
        disk.run(PATH, lambda: written.append(1))
    assert written == [1]
    disk.run(PATH, lambda: written.append(2))
    assert written == [1, 2]


def test_a_write_that_begins_while_the_line_is_read_is_waited_for_by_the_next(line: Line) -> None:
    disk, written, later = DiskThread(None), list[int](), Line()

    def periodic() -> None:
        later.write()
        written.append(2)

    def attend(is_done: Callable[[], bool]) -> None:
        line.free.set()
        while not is_done():
            pass
        if not written:
            written.append(1)
            assert disk.start(periodic)
        later.free.set()

    disk._attend = attend
    disk.run(PATH, line.write)
    disk.run(PATH, lambda: written.append(3))
    assert written == [1, 2, 3]
