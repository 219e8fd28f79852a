"""A file that another program has open for writing: every reader names the holder, and none calls it damaged."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import h5py
import pytest

from edmctl.errors import EdmError, RunFileError
from edmctl.jobs.runs.opening import recover_file
from edmctl.record.bench_file import read_bench, write_bench
from edmctl.record.columns import read_record
from edmctl.record.opening import Checksum, verify_checksum
from edmctl.record.reader import open_run
from edmctl.record.run_index import heads_of, read_head
from edmctl.results.run_file import Unreadable

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def in_use(call: Callable[[], Any]) -> str:
    with pytest.raises(EdmError) as error:
        call()
    assert f"process {os.getpid()} (" in error.value.message
    assert error.value.hint
    return error.value.code


def test_every_reader_of_a_run_file_names_the_holder(run_path: Path) -> None:
    before = run_path.read_bytes()
    with h5py.File(run_path, "r+"):
        held = run_path.read_bytes()
        assert held != before
        assert in_use(lambda: open_run(run_path)) == "E9016"
        assert in_use(lambda: read_head(run_path)) == "E9016"
        assert in_use(lambda: recover_file(run_path)) == "E9016"
        assert in_use(lambda: read_record(run_path)) == "E3601"
        (head,) = heads_of(run_path.parent)
        assert isinstance(head, Unreadable)
        assert head.error.code == "E9016"
    # The holder was killed: nothing but its mark has changed.
    run_path.write_bytes(held)
    assert verify_checksum(run_path) is Checksum.FITS
    with open_run(run_path) as run:
        assert run.rows("/entry/servo")


def test_a_file_of_holes_is_not_read_to_its_end(run_path: Path) -> None:
    with run_path.open("r+b") as file:
        file.truncate(1 << 40)
    for read in (open_run, read_head, recover_file):
        with pytest.raises(RunFileError, match="almost nothing was written") as error:
            read(run_path)
        assert error.value.code == "E9005"


def test_a_bench_in_use_is_not_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "bench.edm"
    write_bench(path, {"one": 1})
    with h5py.File(path, "r+"):
        assert in_use(lambda: read_bench(path)) == "E9023"
    assert read_bench(path) == {"one": 1}


def test_readers_do_not_keep_each_other_out(run_path: Path) -> None:
    with h5py.File(run_path, "r"), open_run(run_path) as run:
        assert run.rows("/entry/servo")
