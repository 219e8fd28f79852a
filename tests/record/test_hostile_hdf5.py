"""HDF5 that cannot be meant (rows that are not there, links to a pipe) or that another program has open for writing.

No reader waits for it, and none calls a file in use damaged.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from edmctl.errors import EdmError, RunFileError
from edmctl.jobs.runs.opening import recover_file
from edmctl.jobs.runs.summary import summary_of
from edmctl.record import layout
from edmctl.record.columns import read_record
from edmctl.record.opening import verify_checksum
from edmctl.record.reader import heads_of, open_run, read_head, reading
from edmctl.results.run_file import Unreadable
from tests.tiers import tiers

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
    tiers(
        (vast, PLACES[0]),
        (KINDS[1], "/entry/summary"),
        (endless, "/entry/servo/time"),
        slow=[
            *((vast, place) for place in PLACES[1:]),
            *((kind, "/entry/summary") for kind in KINDS[2:]),
        ],
    ),
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
def test_a_record_of_that_kind_is_refused(tmp_path: Path, spoil: Callable[[h5py.File, str], None]) -> None:
    record = tmp_path / "record.h5"
    with h5py.File(record, "w") as file:
        for name in ("t_s", "u_V", "y_um"):
            file[name] = np.arange(10.0)
        spoil(file, "u_V")
    assert code_of(partial(read_record, record)) == "E3606"


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
    assert verify_checksum(run_path)
    with open_run(run_path) as run:
        assert run.rows("/entry/servo")


def test_a_file_of_holes_is_not_read_to_its_end(run_path: Path) -> None:
    with run_path.open("r+b") as file:
        file.truncate(1 << 40)
    for read in (open_run, read_head, recover_file):
        with pytest.raises(RunFileError, match="almost nothing was written") as error:
            read(run_path)
        assert error.value.code == "E9005"


def test_readers_do_not_keep_each_other_out(run_path: Path) -> None:
    with h5py.File(run_path, "r"), open_run(run_path) as run:
        assert run.rows("/entry/servo")
