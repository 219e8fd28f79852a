"""Rows arrive whole and in order, whatever the sizes they came in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from edmctl.record import layout
from edmctl.record import rows as kinds
from edmctl.record.reader import open_run
from edmctl.record.rows import EventLevel, EventRow, NullRecorder, Row, RunMeta, Summary, TruthMap
from edmctl.record.writer import RunWriter
from tests.record.samples import a_site_row, a_touch, fill, finished, servo_block, slow_row, train
from tests.tiers import tiers


@pytest.fixture
def writer(tmp_path: Path, meta: RunMeta) -> RunWriter:
    return RunWriter.create(tmp_path / "run.h5", meta)


def test_rows_come_back_as_they_went_in(run_path: Path) -> None:
    with open_run(run_path) as run:
        servo, box, (site,) = (
            run.columns("/entry/servo"),
            run.columns("/entry/black_box"),
            run.table("/entry/results"),
        )
    k = np.arange(10_000)
    np.testing.assert_array_equal(servo["time"], 0.01 * k)
    np.testing.assert_array_equal(servo["v_gap_avg"], (k + 0.4).astype(np.float32))
    np.testing.assert_array_equal(servo["dir"], k % 3 - 1)
    assert [servo["dir"].dtype.name, servo["state"].dtype.name] == ["int8", "uint8"]
    np.testing.assert_array_equal(box["time"], 0.001 * k[:2048])
    np.testing.assert_array_equal(box["n_short"], k[:2048] % 5)
    np.testing.assert_array_equal(box["flags"], k[:2048] % 32)
    names = ("energy", "wear_ratio_lin", "wear_ratio_vol", "mrr", "depth_model_error", "wear_model_error")
    assert [site[name] for name in names] == [610.0, 0.39, 0.34, 0.7, -2.0, -1.0]


@pytest.mark.parametrize("block", tiers(7, 5000, slow=(1,)))
def test_the_size_of_blocks_leaves_no_trace(tmp_path: Path, block: int) -> None:
    rows = 4 * layout.SERVO.chunk_rows + 616
    blocks = [servo_block(first, min(block, rows - first)) for first in range(0, rows, block)]
    with open_run(finished(tmp_path / "run.h5", *blocks)) as run:
        servo = run.columns("/entry/servo")
    np.testing.assert_array_equal(servo["time"], 0.01 * np.arange(rows))
    np.testing.assert_array_equal(servo["z_model"], (np.arange(rows) + 0.3).astype(np.float32))


def test_only_whole_chunks_are_written_before_a_flush_is_due(writer: RunWriter) -> None:
    def stored(path: str) -> int:
        with h5py.File(writer.path, "r", swmr=True) as file:
            return int(file[path].shape[0])

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


@pytest.mark.parametrize(
    ("row", "path", "at_once"),
    [
        *(
            (EventRow(0.1, 3001, level, "short for 3.0 s", {"short_s": 3.0}), layout.EVENTS.path, at_once)
            for level, at_once in zip(EventLevel, (False, False, True, True), strict=True)
        ),
        (a_touch(), layout.TOUCHES.path, True),
        (a_site_row(), layout.RESULTS.path, True),
    ],
)
def test_what_a_kill_must_not_lose_is_on_disk_at_once(
    writer: RunWriter, row: Row, path: str, at_once: bool
) -> None:
    writer.append(servo_block(0, 10))
    writer.append(row)
    with open_run(writer.path) as run:
        assert len(run.table(path)) == at_once
    writer.finish("done", 0)


def test_a_reading_that_later_ones_refute_is_marked_at_once(writer: RunWriter) -> None:
    for time_s in (1.5, 2.5, 3.5):
        writer.append(a_touch(time_s))
    writer.append(kinds.RejectedTouch(2.5))
    with open_run(writer.path) as run:
        rows = run.table("/entry/touches")
    assert rows["accepted"].tolist() == [1, 0, 1]
    assert [rows[0][name] for name in ("kind", "site", "z_sensor", "n")] == [b"Z1", b"A1", 50.0, 3]
    writer.append(a_touch(4.5))
    with open_run(writer.finish("done", 0)) as run:
        assert run.table("/entry/touches")["accepted"].tolist() == [1, 0, 1, 1]


def test_events_are_numbered_and_texts_cut_between_characters(tmp_path: Path) -> None:
    long = EventRow(0.1, 1, EventLevel.INFO, "x" + "µ" * 100)
    full = EventRow(0.2, 2, EventLevel.INFO, "second", {f"key{i:02d}": i for i in range(40)})
    with open_run(finished(tmp_path / "run.h5", long, full)) as run:
        first, second = run.table("/entry/events")
    assert first["message"].decode() == "x" + "µ" * 79
    assert (first["seq"], second["seq"]) == (0, 1)
    assert second["args"].decode().endswith("}")
    assert b'"key00":0' in second["args"]


def test_pulse_times_are_rebuilt_from_segments(tmp_path: Path) -> None:
    trains = [
        train(0, 100, 1.0),
        train(100, 50, 1.0 + 100 * 4e-4 + 1e-6),
        train(150, 50, 5.0),
        train(900, 10, 5.0 + 50 * 4e-4),
        train(910, 10, 5.0 + 60 * 4e-4, period_s=5e-4),
    ]
    with open_run(finished(tmp_path / "run.h5", *trains)) as run:
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


def test_a_period_rounded_to_nanoseconds_does_not_drift(tmp_path: Path) -> None:
    period_s = 1 / 2300
    trains = [train(k, 1000, k * period_s, round(period_s, 9)) for k in range(0, 200_000, 1000)]
    with open_run(finished(tmp_path / "run.h5", *trains)) as run:
        error_s = run.pulse_times_s() - period_s * np.arange(200_000)
    assert np.abs(error_s).max() < 3e-6


def test_pulses_that_wait_while_whole_chunks_are_written_keep_their_values(writer: RunWriter) -> None:
    """A long train fills chunks and leaves a rest, which is written by the next flush."""
    pulses = 2 * layout.PULSES.chunk_rows + 1000
    values = train(0, pulses, 0.0)
    delay_us = values.delay_us % 130.0
    writer.append(
        type(values)(0, 0.0, 4e-4, values.pulse_class, delay_us, 130.0 - delay_us, values.plateau_v)
    )
    with open_run(writer.finish("done", 0)) as run:
        read = run.columns(layout.PULSES.path)
    assert np.abs(read["td"].astype(np.float64) - delay_us).max() <= 0.051
    assert np.abs(read["te"].astype(np.float64) - (130.0 - delay_us)).max() <= 0.051
    assert np.all(read["u"] == 22.5)


def test_a_true_floor_is_read_back_with_its_axes(tmp_path: Path, run_path: Path) -> None:
    x_um, y_um = np.arange(0.0, 1000.0, 5.0), np.arange(-10.0, 700.0, 5.0)
    depth_um = np.add.outer(y_um, 2.0 * x_um)
    earlier = TruthMap(x_um[:2], y_um[:3], depth_um[:3, :2])
    path = finished(tmp_path / "channel.h5", earlier, TruthMap(x_um, y_um, depth_um))
    with open_run(path) as run, open_run(run_path) as other:
        found = run.truth_map()
        assert other.truth_map() is None
    assert found is not None
    assert np.array_equal(found.x_um, x_um)
    assert np.array_equal(found.y_um, y_um)
    assert np.array_equal(found.depth_um, depth_um)
    with h5py.File(path) as file:
        truth = file["/entry/truth"]
        assert (truth.attrs["signal"], list(truth.attrs["axes"])) == ("depth", ["y", "x"])
        assert [truth["depth"].dims[k][0].name for k in (0, 1)] == ["/entry/truth/y", "/entry/truth/x"]


def test_the_end_is_written_in_place_and_the_wear_of_all_sites_adds_up(writer: RunWriter) -> None:
    with open_run(writer.path) as run:
        assert (run.text("/entry/status"), run.number("/entry/exit_code")) == ("running", -1)
        assert run.number("/entry/tool/length_wear_total") == 0.0
        assert (run.is_finished, run.summary()) == (False, None)
    for wear_um in (70.0, 12.5):
        writer.append(replace(a_site_row(), wear_um=wear_um))
    writer.append(Summary('{"ok": false}'))
    writer.append(Summary('{"ok": true, "depth_um": 180.0}'))
    with open_run(writer.finish("depth reached", 0)) as run:
        assert (run.text("/entry/status"), run.number("/entry/exit_code")) == ("depth reached", 0)
        assert (run.is_finished, run.summary()) == (True, {"ok": True, "depth_um": 180.0})
        assert run.number("/entry/tool/length_wear_total") == 82.5
    assert writer.finish("interrupted", 130) == writer.path
    with open_run(writer.path) as run:
        assert run.text("/entry/status") == "depth reached"


def test_a_recorder_without_a_file_takes_the_same_calls(tmp_path: Path, writer: RunWriter) -> None:
    fill(NullRecorder())
    fill(writer)
    assert [p.name for p in tmp_path.iterdir()] == ["run.h5.partial"]
