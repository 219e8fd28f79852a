"""The file of a kept bench: what goes in comes out, and nothing else is taken for one or written over."""

from __future__ import annotations

import hashlib
import os
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.record.bench_file import SCHEMA, bench_lock, read_bench, write_bench

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

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
    path = tmp_path / "bench.h5"
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
    text, empty, run = tmp_path / "notes.txt", tmp_path / "empty", tmp_path / "run.h5"
    pipe, folder, device = tmp_path / "pipe", tmp_path / "folder", tmp_path / "device"
    text.write_text("my notes")
    empty.write_bytes(b"")
    with h5py.File(run, "w") as file:
        file.attrs["schema"] = "edmctl-run/1"
    os.mkfifo(pipe)
    folder.mkdir()
    device.symlink_to(os.devnull)
    for other, what in (
        (text, "it is not an HDF5 file"),
        (empty, "it is not an HDF5 file"),
        (run, "not the file of a bench"),
        (pipe, "it is a pipe, a device or a socket"),
        (folder, "it is a folder"),
        (device, "it is a pipe, a device or a socket"),
    ):
        before = other.read_bytes() if other.is_file() else b""
        error = refusal(other)
        assert (error.code, what in error.message) == ("E9020", True)
        with pytest.raises(RunFileError, match=what):
            write_bench(other, STATE)
        assert not before or other.read_bytes() == before
    assert pipe.is_fifo()


def vast(file: h5py.File) -> None:
    del file["arrays"]
    file.create_dataset("arrays", shape=(10**13,), dtype="u1", chunks=(1000,))


def cyclic(file: h5py.File) -> None:
    del file["state"]
    file["state"] = file["/"]


def dangling(file: h5py.File) -> None:
    del file["arrays"]
    file["arrays"] = h5py.SoftLink("/nowhere")


def no_text(file: h5py.File) -> None:
    """A text that is none, with the sum that belongs to it."""
    del file["state"]
    text = b"{'plant'"
    file["state"] = np.frombuffer(text, np.uint8)
    file.attrs["sha256"] = hashlib.sha256(text + b"\0" + file["arrays"][()].tobytes()).hexdigest()


def no_check_sum(file: h5py.File) -> None:
    del file.attrs["sha256"]


@pytest.mark.parametrize("spoil", [vast, cyclic, dangling, no_text, no_check_sum])
def test_what_hdf5_allows_and_a_bench_never_has_is_refused_in_words(
    spoil: Callable[[h5py.File], None], path: Path
) -> None:
    with h5py.File(path, "r+") as file:
        spoil(file)
    error = refusal(path)
    assert error.code == "E9020"
    assert error.message.endswith(("its parts are not those of a bench.", "and does not contain them."))


def test_a_damaged_or_cut_file_is_refused_in_words(path: Path) -> None:
    whole = path.read_bytes()
    at = whole.index(np.arange(6.0).tobytes()) + 20
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    assert "check sum" in refusal(path).message
    for length in range(0, len(whole), len(whole) // 40):
        path.write_bytes(whole[:length])
        assert refusal(path).code == "E9020"


def test_the_file_of_a_later_version_is_refused_and_stays(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = SCHEMA + 1
    before = path.read_bytes()
    error = refusal(path)
    assert error.code == "E9022"
    assert f"schema {SCHEMA + 1}, this one knows {SCHEMA}" in error.message
    with pytest.raises(RunFileError):
        write_bench(path, STATE)
    assert path.read_bytes() == before


def test_one_program_at_a_time(path: Path, tmp_path: Path) -> None:
    (tmp_path / "other.h5").symlink_to(path)
    for name in (path, tmp_path / "other.h5"):
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
    path = tmp_path / "none" / "bench.h5"
    with pytest.raises(RunFileError, match="No such file") as caught, bench_lock(path):
        raise AssertionError("locked nothing")
    assert caught.value.code == "E9024"
    with pytest.raises(RunFileError, match="No such file"):
        write_bench(path, STATE)


def test_a_value_without_a_place_in_the_file_is_a_bug(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="bytes has no place"):
        write_bench(tmp_path / "bench.h5", {"what": b"bytes"})
