from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.record.writer import RunWriter
from tests.record.samples import a_meta, fill

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from edmctl.record.rows import RunMeta


@pytest.fixture
def meta() -> RunMeta:
    return a_meta()


@pytest.fixture
def write_run(tmp_path: Path, meta: RunMeta) -> Callable[[str], Path]:
    """Write a complete run file of the given name and return its path."""

    def write(name: str) -> Path:
        writer = RunWriter.create(tmp_path / name, meta)
        fill(writer)
        return writer.finish("done", 0)

    return write


@pytest.fixture
def run_path(write_run: Callable[[str], Path]) -> Path:
    return write_run("run.h5")
