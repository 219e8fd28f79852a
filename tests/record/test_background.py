"""A disk that is slow, hangs or fails never holds up the control loop, and costs no row that it took."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.record import layout
from edmctl.record import writer as writing
from edmctl.record.reader import open_run
from edmctl.record.rows import EventLevel, EventRow, Row, RunMeta, Summary
from edmctl.record.writer import BackgroundWriter, RunWriter
from tests.record.samples import a_site_row, a_touch, fill, servo_block, slow_row, train

LONG_S = 30.0
"""Of a wait that ends with an event long before, unless something is broken."""


class Disk:
    """A disk whose `fsync` hangs until it is let go."""

    def __init__(self) -> None:
        self.asked = threading.Event()
        self.free = threading.Event()

    def fsync(self, descriptor: int) -> None:
        self.asked.set()
        assert self.free.wait(LONG_S)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    """Hang at the first `fsync`, which is asked for at once."""
    hanging = Disk()
    monkeypatch.setattr(os, "fsync", hanging.fsync)
    monkeypatch.setattr(writing, "SYNC_INTERVAL_S", 0.0)
    monkeypatch.setattr(writing, "GIVE_UP_S", 0.05)
    yield hanging
    hanging.free.set()
    for thread in threading.enumerate():
        if thread.name == "run file":
            thread.join(LONG_S)


@pytest.fixture
def flushed(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Is set whenever rows were flushed."""
    done, flush = threading.Event(), RunWriter._flush

    def noted(writer: RunWriter) -> None:
        flush(writer)
        done.set()

    monkeypatch.setattr(RunWriter, "_flush", noted)
    return done


def of_this_file() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name == "run file"]


@pytest.fixture
def writer(tmp_path: Path, meta: RunMeta) -> BackgroundWriter:
    return BackgroundWriter.create(tmp_path / "run.h5", meta)


@pytest.fixture
def hung(disk: Disk, writer: BackgroundWriter) -> BackgroundWriter:
    """A writer of ten rows whose disk hangs."""
    writer.append(servo_block(0, 10))
    assert disk.asked.wait(LONG_S)
    return writer


def test_the_file_holds_the_same_rows_as_one_that_is_waited_for(
    write_run: Callable[[str], Path], writer: BackgroundWriter
) -> None:
    fill(writer)
    with h5py.File(write_run("waited.h5")) as one, h5py.File(writer.finish("done", 0)) as other:
        for path in (path for table in layout.TABLES for path in table.datasets):
            assert one[path][()].tobytes() == other[path][()].tobytes(), path
    assert of_this_file() == []


@pytest.mark.parametrize(
    ("row", "path", "flush_s"),
    [
        (a_touch(), "/entry/touches", LONG_S),
        (a_site_row(), "/entry/results", LONG_S),
        (EventRow(0.1, 3001, EventLevel.WARNING, "arc"), "/entry/events", LONG_S),
        (slow_row(1), "/entry/slow", writing.FLUSH_INTERVAL_S),
    ],
)
def test_rows_are_flushed_without_a_further_call_and_urgent_ones_at_once(
    tmp_path: Path,
    meta: RunMeta,
    monkeypatch: pytest.MonkeyPatch,
    flushed: threading.Event,
    row: Row,
    path: str,
    flush_s: float,
) -> None:
    monkeypatch.setattr(writing, "FLUSH_INTERVAL_S", flush_s)
    writer = BackgroundWriter.create(tmp_path / "run.h5", meta)
    writer.append(row)
    assert flushed.wait(LONG_S / 2)
    with open_run(writer.path) as run:
        assert run.rows(path) == 1
    writer.finish("done", 0)


def test_a_disk_that_hangs_holds_up_nobody_and_loses_nothing(
    hung: BackgroundWriter, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "GIVE_UP_S", LONG_S)
    with open_run(hung.path) as run:
        assert run.rows("/entry/servo") == 10
    for first in range(10, 5000, 10):
        hung.append(servo_block(first, 10))
        hung.append(a_touch())
    disk.free.set()
    with open_run(hung.finish("done", 0)) as run:
        np.testing.assert_array_equal(run.column("/entry/servo", "time"), 0.01 * np.arange(5000))
        assert len(run.table("/entry/touches")) == 499


def test_a_backlog_beyond_its_bound_ends_a_real_job_once(
    tmp_path: Path, hung: BackgroundWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "BACKLOG_BYTES", 1 << 20)
    block, handed, errors = servo_block(10, 1000), 0, []
    for _ in range(100):
        try:
            hung.append(block)
        except RunFileError as raised:
            errors.append(raised)
        handed += not errors
    (error,) = errors
    # 1 MiB at 8 bytes for each of 9 values.
    assert handed == 15
    assert (error.code, error.exit_code) == ("E9009", 9)
    assert "1 MB wait" in error.message
    assert str(hung.path) in error.hint
    hung.append(Summary("{}"))
    with pytest.raises(RunFileError) as refusal:
        hung.finish("done", 0)
    assert refusal.value is error
    assert hung.abandon("run file or disk", 9) == tmp_path / "run.h5.partial"
    with open_run(hung.path) as run:
        assert run.rows("/entry/servo") == 10


def test_a_disk_that_comes_back_after_the_job_was_ended_still_gets_the_rows(
    hung: BackgroundWriter, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "BACKLOG_BYTES", 1 << 20)
    monkeypatch.setattr(writing, "GIVE_UP_S", LONG_S)
    for k in range(15):
        hung.append(servo_block(10 + 1000 * k, 1000))
    with pytest.raises(RunFileError, match="has not taken rows"):
        hung.append(servo_block(15_010, 1000))
    disk.free.set()
    with open_run(hung.abandon("run file or disk", 9)) as run:
        assert (run.text("/entry/status"), run.number("/entry/exit_code")) == ("run file or disk", 9)
        np.testing.assert_array_equal(run.column("/entry/servo", "time"), 0.01 * np.arange(15_010))
    assert of_this_file() == []


def test_a_virtual_machine_waits_for_a_slow_disk(
    tmp_path: Path, meta: RunMeta, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "BACKLOG_BYTES", 1 << 20)
    writer = BackgroundWriter.create(tmp_path / "run.h5", meta, waits=True)
    writer.append(servo_block(0, 10))
    assert disk.asked.wait(LONG_S)
    handed: list[int] = []

    def control() -> None:
        for k in range(40):
            writer.append(servo_block(10 + 1000 * k, 1000))
            handed.append(k)
            if k == 14:
                held_up.set()

    held_up, loop = threading.Event(), threading.Thread(target=control)
    loop.start()
    assert held_up.wait(LONG_S)
    loop.join(0.05)
    assert len(handed) == 15
    disk.free.set()
    loop.join(LONG_S)
    with open_run(writer.finish("done", 0)) as run:
        np.testing.assert_array_equal(run.column("/entry/servo", "time"), 0.01 * np.arange(40_010))


@pytest.mark.parametrize("waits", [False, True])
def test_an_error_of_the_disk_is_raised_once_and_later_rows_are_ignored(
    tmp_path: Path, meta: RunMeta, monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    def full(descriptor: int, offset: int, length: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(writing, "BACKLOG_BYTES", 1000)
    writer = BackgroundWriter.create(tmp_path / "run.h5", meta, waits=waits)
    monkeypatch.setattr(os, "posix_fallocate", full)
    writer.append(a_touch())
    writer._thread.join(LONG_S)
    with pytest.raises(RunFileError, match="No space left on device") as refusal:
        writer.append(servo_block(0, 10))
    assert (refusal.value.code, refusal.value.exit_code) == ("E9003", 9)
    fill(writer, rows=100)
    with pytest.raises(RunFileError, match="No space left"):
        writer.finish("done", 0)
    assert writer.abandon("run file or disk", 9) == tmp_path / "run.h5.partial"
    assert of_this_file() == []


def test_a_mistake_in_the_rows_reaches_the_caller(writer: BackgroundWriter) -> None:
    good = servo_block(0, 3)
    writer.append(type(good)(good.time_s[:2], *[getattr(good, n) for n in good.__slots__[1:]]))
    with pytest.raises(TypeError, match="differ in length"):
        writer.finish("done", 0)
    assert of_this_file() == []


def test_an_abandoned_run_has_its_rows_as_they_were_handed_over_and_its_status(
    writer: BackgroundWriter, tmp_path: Path, meta: RunMeta
) -> None:
    args: dict[str, float | int | str | bool] = {"depth_um": 1.0}
    writer.append(EventRow(0.1, 1, EventLevel.INFO, "depth", args))
    args["depth_um"] = 2.0
    writer.append(train(0, 300, 0.0))
    writer.append(Summary('{"ok": false}'))
    path = writer.abandon("interrupted", 130)
    assert path == writer.abandon("again", 1) == tmp_path / "run.h5"
    with open_run(path) as run:
        assert (run.text("/entry/status"), run.number("/entry/exit_code")) == ("interrupted", 130)
        assert run.table("/entry/events")["args"][0] == b'{"depth_um":1.0}'
        assert (run.rows("/entry/pulses/full"), run.summary()) == (300, {"ok": False})
    with pytest.raises(RunFileError, match="exists already"):
        BackgroundWriter.create(path, meta)
    assert of_this_file() == []
