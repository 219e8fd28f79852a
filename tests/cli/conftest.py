"""Recorded run files for the commands that read them."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import pytest

from tests.report.conftest import array_run_file, faulted_run_file, run_file

__all__ = ["array_run_file", "faulted_run_file", "run_file"]


@pytest.fixture
def run(run_file: Path, tmp_path: Path) -> Path:
    """Return a copy of the file of a shallow hole, seed 3, in a folder of its own."""
    return Path(shutil.copy(run_file, tmp_path / "one.h5"))


@pytest.fixture
def unfinished(run: Path) -> Path:
    """Return the same file as its writer leaves it when it is killed."""
    partial = run.rename(run.with_name("one.h5.partial"))
    with h5py.File(partial, "r+") as file:
        file["/entry/end_time"][()] = b""
    return partial
