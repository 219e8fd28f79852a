"""Rows arrive whole and in order, whatever the sizes they came in."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from edmctl.record import layout
from edmctl.record.reader import open_run
from edmctl.record.rows import EventLevel, EventRow, NullRecorder, Recorder, RejectedTouch, Summary, TouchRow
from edmctl.record.writer import FLUSH_INTERVAL_S, RunWriter
from tests.record.samples import a_site_row, fill, servo_block, slow_row, train
from tests.tiers import tiers

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from edmctl.record.rows import RunMeta


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_servo_rows_come_back_as_they_went_in(run_path: Path) -> None:
    with open_run(run_path) as run:
        servo = run.columns("/entry/servo")
    k = np.arange(10_000)
    np.testing.assert_array_equal(servo["time"], 0.01 * k)
    np.testing.assert_array_equal(servo["v_gap_avg"], (k + 0.4).astype(np.float32))
    np.testing.assert_array_equal(servo["dir"], k % 3 - 1)
    assert servo["dir"].dtype == np.int8
    assert servo["state"].dtype == np.uint8


def test_the_black_box_is_kept_in_columns(run_path: Path) -> None:
    with open_run(run_path) as run:
        box = run.columns("/entry/black_box")
    k = np.arange(2048)
    np.testing.assert_array_equal(box["time"], 0.001 * k)
    np.testing.assert_array_equal(box["n_short"], k % 5)
    np.testing.assert_array_equal(box["flags"], k % 32)


@pytest.mark.parametrize("block", tiers(7, 5000, slow=(1,)))
def test_the_size_of_blocks_leaves_no_trace(tmp_path: Path, meta: RunMeta, block: int) -> None:
    rows = 4 * layout.SERVO.chunk_rows + 616
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    for first in range(0, rows, block):
        writer.append(servo_block(first, min(block, rows - first)))
    with open_run(writer.finish("done", 0)) as run:
        servo = run.columns("/entry/servo")
    np.testing.assert_array_equal(servo["time"], 0.01 * np.arange(rows))
    np.testing.assert_array_equal(servo["z_model"], (np.arange(rows) + 0.3).astype(np.float32))


def test_only_whole_chunks_are_written_before_a_flush_is_due(tmp_path: Path, meta: RunMeta) -> None:
    def stored(path: str) -> int:
        with h5py.File(writer.path, "r", swmr=True) as file:
            return int(file[path].shape[0])

    writer = RunWriter.create(tmp_path / "run.h5", meta, Clock())
    servo_chunk, slow_chunk = layout.SERVO.chunk_rows, layout.SLOW.chunk_rows
    writer.flush()
    writer.append(servo_block(0, 5 * servo_chunk + 5))
    for k in range(3):
        writer.append(slow_row(k))
    writer.flush()
    for k in range(4 * slow_chunk):
        writer.append(slow_row(k))
    assert stored("/entry/slow/time") == 4 * slow_chunk
    writer.append(servo_block(0, 4 * servo_chunk))
    assert stored("/entry/servo/time") == 9 * servo_chunk
    writer.flush()
    assert stored("/entry/servo/time") == 9 * servo_chunk + 5
    assert stored("/entry/slow/time") == 4 * slow_chunk + 3
    writer.finish("done", 0)


def test_rows_reach_the_disk_when_the_flush_is_due(tmp_path: Path, meta: RunMeta) -> None:
    clock = Clock()
    writer = RunWriter.create(tmp_path / "run.h5", meta, clock)
    writer.append(servo_block(0, 10))
    with open_run(writer.path) as run:
        assert len(run.columns("/entry/servo")["time"]) == 0
    clock.now_s += FLUSH_INTERVAL_S
    writer.append(servo_block(10, 10))
    with open_run(writer.path) as run:
        assert len(run.columns("/entry/servo")["time"]) == 20
    writer.finish("done", 0)


def test_a_flush_is_due_at_least_once_a_second() -> None:
    assert FLUSH_INTERVAL_S <= 1.0


@pytest.mark.parametrize("level", list(EventLevel))
def test_important_events_are_on_disk_at_once(tmp_path: Path, meta: RunMeta, level: EventLevel) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", meta, Clock())
    writer.append(servo_block(0, 10))
    writer.append(EventRow(0.1, 3001, level, "short circuit for 3.0 s", {"short_s": 3.0}))
    with open_run(writer.path) as run:
        events = run.table("/entry/events")
    assert len(events) == (1 if level >= EventLevel.WARNING else 0)
    writer.finish("done", 0)


def test_touches_are_on_disk_at_once(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", meta, Clock())
    writer.append(TouchRow(1.0, "Z1", "A1", 20.0, 50.0, 49.0, 3, 0.3, 0.0, 1.0))
    with open_run(writer.path) as run:
        row = run.table("/entry/touches")[0]
    assert (row["kind"], row["site"], row["z_sensor"], row["n"], row["accepted"]) == (
        b"Z1",
        b"A1",
        50.0,
        3,
        1,
    )
    writer.finish("done", 0)


def test_a_reading_that_later_ones_refute_is_marked_at_once(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    for time_s in (1.5, 2.5, 3.5):
        writer.append(TouchRow(time_s, "Z1", "A1", 20.0, 50.0, 49.0, 3, 0.3, 0.0, 1.0))
    writer.append(RejectedTouch(2.5))
    with open_run(writer.path) as run:
        assert run.table("/entry/touches")["accepted"].tolist() == [1, 0, 1]
    writer.append(TouchRow(4.5, "Z1", "A1", 20.0, 50.0, 49.0, 3, 0.3, 0.0, 1.0))
    with open_run(writer.finish("done", 0)) as run:
        assert run.table("/entry/touches")["accepted"].tolist() == [1, 0, 1, 1]


def test_events_are_numbered_and_texts_cut_between_characters(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    writer.append(EventRow(0.1, 1, EventLevel.INFO, "x" + "µ" * 100))
    writer.append(EventRow(0.2, 2, EventLevel.INFO, "second", {f"key{i:02d}": i for i in range(40)}))
    with open_run(writer.finish("done", 0)) as run:
        first, second = run.table("/entry/events")
    assert first["message"].decode() == "x" + "µ" * 79
    assert (first["seq"], second["seq"]) == (0, 1)
    assert second["args"].decode().endswith("}")
    assert b'"key00":0' in second["args"]


def test_pulse_times_are_rebuilt_from_segments(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    writer.append(train(0, 100, 1.0))
    writer.append(train(100, 50, 1.0 + 100 * 4e-4 + 1e-6))
    writer.append(train(150, 50, 5.0))
    writer.append(train(900, 10, 5.0 + 50 * 4e-4))
    writer.append(train(910, 10, 5.0 + 60 * 4e-4, period_s=5e-4))
    with open_run(writer.finish("done", 0)) as run:
        segments = run.columns("/entry/pulses/segments")
        times_s = run.pulse_times_s()
        full = run.columns("/entry/pulses/full")
    assert segments["first_row"].tolist() == [0, 150, 200, 210]
    assert segments["first_pulse"].tolist() == [0, 150, 900, 910]
    expected_s = np.concatenate(
        [1.0 + 4e-4 * np.arange(150), 5.0 + 4e-4 * np.arange(60), 5.024 + 5e-4 * np.arange(10)]
    )
    np.testing.assert_allclose(times_s, expected_s, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(full["pulse_class"][150:200], np.arange(150, 200) % 4)
    np.testing.assert_array_equal(full["td"][:100], (0.1 * np.arange(100)).astype(np.float32))


def test_a_period_rounded_to_nanoseconds_does_not_drift(tmp_path: Path, meta: RunMeta) -> None:
    period_s = 1 / 2300
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    for first in range(0, 200_000, 200):
        writer.append(train(first, 200, first * period_s, round(period_s, 9)))
    with open_run(writer.finish("done", 0)) as run:
        error_s = run.pulse_times_s() - period_s * np.arange(200_000)
    assert np.abs(error_s).max() < 3e-6


def test_columns_of_different_length_are_refused(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    good = servo_block(0, 3)
    writer.append(type(good)(good.time_s[:2], *[getattr(good, n) for n in good.__slots__[1:]]))
    with pytest.raises(TypeError, match="differ in length"):
        writer.flush()


def test_the_end_is_written_in_place(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    with open_run(writer.path) as run:
        assert run.text("/entry/status") == "running"
        assert run.number("/entry/exit_code") == -1
        assert not run.is_finished
        assert run.summary() is None
    writer.append(Summary('{"ok": false}'))
    writer.append(Summary('{"ok": true, "depth_um": 180.0}'))
    with open_run(writer.finish("depth reached", 0)) as run:
        assert run.text("/entry/status") == "depth reached"
        assert run.number("/entry/exit_code") == 0
        assert run.is_finished
        assert run.summary() == {"ok": True, "depth_um": 180.0}


def test_the_same_input_makes_the_same_datasets(write_run: Callable[[str], Path]) -> None:
    first, second = write_run("a.h5"), write_run("b.h5")
    compared = 0
    with h5py.File(first) as one, h5py.File(second) as other:
        paths: list[str] = []
        one.visit(paths.append)
        paths.remove("entry/end_time")
        for path in paths:
            if isinstance(one[path], h5py.Dataset) and one[path].dtype != object:
                assert str(one[path][()].tolist()) == str(other[path][()].tolist()), path
                compared += 1
    assert compared > 100


def test_a_recorder_without_a_file_takes_the_same_calls(tmp_path: Path, meta: RunMeta) -> None:
    recorders: list[Recorder] = [NullRecorder(), RunWriter.create(tmp_path / "run.h5", meta)]
    for recorder in recorders:
        fill(recorder)
    assert [p.name for p in tmp_path.iterdir()] == ["run.h5.partial"]


def test_the_wear_of_all_sites_adds_up_in_the_tool(tmp_path: Path, meta: RunMeta) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    with open_run(writer.path) as run:
        assert run.number("/entry/tool/length_wear_total") == 0.0
    for wear_um in (70.0, 12.5):
        writer.append(replace(a_site_row(), wear_um=wear_um))
    with open_run(writer.finish("done", 0)) as run:
        assert run.number("/entry/tool/length_wear_total") == 82.5


def test_a_site_keeps_its_energy_ratios_and_model_errors(run_path: Path) -> None:
    with open_run(run_path) as run:
        (row,) = run.table("/entry/results")
    assert (row["energy"], row["wear_ratio_lin"], row["wear_ratio_vol"], row["mrr"]) == (
        610.0,
        0.39,
        0.34,
        0.7,
    )
    assert (row["depth_model_error"], row["wear_model_error"]) == (-2.0, -1.0)
