"""What can be opened, and what is said about the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.record.reader import open_run

if TYPE_CHECKING:
    from pathlib import Path


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RunFileError, match=r"no run file .*gone\.h5") as refusal:
        open_run(tmp_path / "gone.h5")
    assert refusal.value.code == "E9005"


def test_the_hint_knows_the_unfinished_file(tmp_path: Path) -> None:
    (tmp_path / "run.h5.partial").write_bytes(b"")
    with pytest.raises(RunFileError) as refusal:
        open_run(tmp_path / "run.h5")
    assert "run.h5.partial" in refusal.value.hint


@pytest.mark.parametrize(
    ("content", "why"), [(b"", "is empty"), (b"not HDF5 at all" * 100, "not an HDF5 file")]
)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, content: bytes, why: str) -> None:
    (tmp_path / "x.h5").write_bytes(content)
    with pytest.raises(RunFileError, match=why):
        open_run(tmp_path / "x.h5")


def test_an_hdf5_file_of_another_schema_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file.attrs["schema"] = "other/9"
    with pytest.raises(RunFileError, match="not a run file of edmctl"):
        open_run(tmp_path / "x.h5")


def test_columns_are_cut_to_the_shortest(run_path: Path) -> None:
    with h5py.File(run_path, "r+") as file:
        file["/entry/servo/s"].resize((9_000,))
    with open_run(run_path) as run:
        servo = run.columns("/entry/servo")
    assert {len(column) for column in servo.values()} == {9_000}
    np.testing.assert_array_equal(servo["time"], 0.01 * np.arange(9_000))
