"""HDF5 that is well formed and cannot be meant: rows that are not there, links to a pipe. No reader waits for it."""

from __future__ import annotations

import os
from functools import partial
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest

from edmctl.errors import EdmError, RunFileError
from edmctl.jobs.runs.opening import recover_file
from edmctl.jobs.runs.summary import summary_of
from edmctl.record import layout
from edmctl.record.bench_file import read_bench, write_bench
from edmctl.record.columns import read_record
from edmctl.record.reader import reading
from edmctl.record.run_index import heads_of
from edmctl.results.run_file import Unreadable

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

VAST = 10**13


def vast(file: h5py.File, path: str) -> None:
    kind = file[path].dtype
    del file[path]
    file.create_dataset(path, (VAST,), kind, chunks=(4096,))


def elsewhere(file: h5py.File, path: str) -> None:
    pipe = f"{file.filename}.pipe"
    os.mkfifo(pipe)
    del file[path]
    file[path] = h5py.ExternalLink(pipe, "/")


def endless(file: h5py.File, path: str) -> None:
    kind = file[path].dtype
    del file[path]
    file.create_dataset(path, (1000,), kind, external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])


def composed(file: h5py.File, path: str) -> None:
    kind = file[path].dtype
    del file[path]
    rows = h5py.VirtualLayout((1000,), kind)
    rows[:] = h5py.VirtualSource(f"{file.filename}.none", "x", (1000,))
    file.create_virtual_dataset(path, rows)


KINDS = (vast, elsewhere, endless, composed)
PLACES = (
    "/entry/servo/v_cmd",
    "/entry/servo/time",
    layout.RESULTS.path,
    layout.TOUCHES.path,
    "/entry/summary",
)


@pytest.mark.parametrize(
    ("spoil", "place"),
    [(vast, place) for place in PLACES]
    + [(kind, "/entry/summary") for kind in KINDS[1:]]
    + [(endless, "/entry/servo/time")],
)
def test_every_reader_of_a_run_file_says_so_or_does_not_need_it(
    run_path: Path, spoil: Callable[[h5py.File, str], None], place: str
) -> None:
    with h5py.File(run_path, "r+") as file:
        spoil(file, place)
    for read in (summary_of, _all_of):
        assert code_of(partial(_read, run_path, read)) in {"", "E9007"}
    (head,) = heads_of(run_path.parent)
    assert not isinstance(head, Unreadable) or head.error.code == "E9007"
    assert code_of(lambda: read_record(run_path)) in {"", "E3606"}
    if code_of(lambda: recover_file(run_path)) == "":
        _read(run_path.with_name("run.recovered.h5"), _all_of)


def code_of(call: Callable[[], object]) -> str:
    """Return the code of the error that a call ends with; empty without one."""
    try:
        call()
    except EdmError as error:
        return error.code
    return ""


def _read(path: Path, read: Callable[[Any], object]) -> None:
    with reading(path) as run:
        read(run)


def _all_of(run: Any) -> None:
    for table in layout.TABLES:
        if not table.is_compound:
            run.columns(table.path)
        elif table.path in run._file:
            run.table(table.path)
    run.summary()
    run.truth_map()


@pytest.mark.parametrize("spoil", KINDS)
def test_a_bench_of_that_kind_is_refused(tmp_path: Path, spoil: Callable[[h5py.File, str], None]) -> None:
    path = tmp_path / "bench.edm"
    write_bench(path, {"one": np.zeros(5)})
    with h5py.File(path, "r+") as file:
        spoil(file, "arrays")
    with pytest.raises(RunFileError) as error:
        read_bench(path)
    assert error.value.code == "E9020"


@pytest.mark.parametrize("spoil", KINDS)
def test_a_record_of_that_kind_is_refused(tmp_path: Path, spoil: Callable[[h5py.File, str], None]) -> None:
    path = tmp_path / "record.h5"
    with h5py.File(path, "w") as file:
        for name in ("t_s", "u_V", "y_um"):
            file[name] = np.arange(10.0)
        spoil(file, "u_V")
    with pytest.raises(EdmError) as error:
        read_record(path)
    assert error.value.code == "E3606"
