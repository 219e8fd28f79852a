"""The file of a persistent bench: what is written is read back, and nothing else is accepted or overwritten."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.record.bench_file import SCHEMA, bench_lock, read_bench, write_bench

STATE = {
    "plant": {
        "st": {"DEPTH": 0.1 + 0.2, "TICK": 2**62},
        "holes": np.zeros((0, 3)),
        "plays": np.arange(6.0).reshape(2, 3),
        "far": float("inf"),
    },
    "serial": "SIM-µ",
    "fault": 2001,
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "bench.edm"
    write_bench(path, STATE)
    return path


def refusal(path: Path) -> RunFileError:
    with pytest.raises(RunFileError) as caught:
        read_bench(path)
    assert str(path) in caught.value.message
    assert caught.value.hint
    return caught.value


def test_what_goes_in_comes_out_until_a_newer_state_takes_its_place(path: Path) -> None:
    state = read_bench(path)
    plant = state["plant"]
    assert isinstance(plant, dict)
    assert plant["st"] == STATE["plant"]["st"]  # type: ignore[index]
    assert plant["far"] == float("inf")
    assert plant["holes"].shape == (0, 3)
    np.testing.assert_array_equal(plant["plays"], np.arange(6.0).reshape(2, 3))
    assert (state["serial"], state["fault"]) == ("SIM-µ", 2001)
    write_bench(path, {**STATE, "fault": 0})
    assert read_bench(path)["fault"] == 0
    assert list(path.parent.iterdir()) == [path]


def test_what_is_no_bench_is_refused_unopened_and_never_written_over(tmp_path: Path) -> None:
    text, empty, pipe = tmp_path / "notes.txt", tmp_path / "empty", tmp_path / "pipe"
    folder, device = tmp_path / "folder", tmp_path / "device"
    text.write_text("my notes")
    empty.write_bytes(b"")
    os.mkfifo(pipe)
    folder.mkdir()
    device.symlink_to(os.devnull)
    for other, what in (
        (text, "is not the file of a bench"),
        (empty, "is not the file of a bench"),
        (pipe, "it is a pipe, a device or a socket"),
        (folder, "it is a folder"),
        (device, "it is a pipe, a device or a socket"),
    ):
        before = other.read_bytes() if other.is_file() else b""
        error = refusal(other)
        assert (error.code, what in error.message) == ("E9020", True), error
        with pytest.raises(RunFileError, match=what):
            write_bench(other, STATE)
        assert not before or other.read_bytes() == before
    assert pipe.is_fifo()


def test_a_damaged_or_cut_file_is_refused_in_words(path: Path) -> None:
    whole = path.read_bytes()
    for at in (whole.index(np.arange(6.0).tobytes()) + 20, whole.index(b"SIM-"), 20):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        assert "check sum" in refusal(path).message
    for length in range(0, len(whole), len(whole) // 40):
        path.write_bytes(whole[:length])
        assert refusal(path).code in ("E9020", "E9021")


@pytest.mark.parametrize(("version", "code"), [(SCHEMA + 1, "E9022"), (SCHEMA - 1, "E9021")])
def test_the_file_of_another_version_is_refused_and_stays(path: Path, version: int, code: str) -> None:
    before = path.read_bytes().replace(b"edmctl-bench %d" % SCHEMA, b"edmctl-bench %d" % version)
    path.write_bytes(before)
    assert refusal(path).code == code
    with pytest.raises(RunFileError):
        write_bench(path, STATE)
    assert path.read_bytes() == before


def test_one_program_at_a_time(path: Path, tmp_path: Path) -> None:
    (tmp_path / "other.edm").symlink_to(path)
    for name in (path, tmp_path / "other.edm"):
        with (
            bench_lock(path),
            pytest.raises(RunFileError, match="is in use: process") as caught,
            bench_lock(name),
        ):
            raise AssertionError("two had the lock")
        assert caught.value.code == "E9023"
    with bench_lock(path):
        pass
    assert not list(tmp_path.glob(".*"))


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none" / "bench.edm"
    with pytest.raises(RunFileError, match="No such file") as caught, bench_lock(path):
        raise AssertionError("locked nothing")
    assert caught.value.code == "E9024"
    with pytest.raises(RunFileError, match="No such file"):
        write_bench(path, STATE)


def test_a_value_without_a_place_in_the_file_is_a_bug(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="bytes has no place"):
        write_bench(tmp_path / "bench.edm", {"what": b"bytes"})
