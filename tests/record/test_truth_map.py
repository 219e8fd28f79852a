"""The true floor of a channel in the run file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np

from edmctl.record.reader import open_run
from edmctl.record.rows import TruthMap
from edmctl.record.writer import RunWriter

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.record.rows import RunMeta


def test_a_map_is_read_back_with_its_axes_and_viewers_find_it(tmp_path: Path, meta: RunMeta) -> None:
    x_um, y_um = np.arange(0.0, 1000.0, 5.0), np.arange(-10.0, 700.0, 5.0)
    depth_um = np.add.outer(y_um, 2.0 * x_um)
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    writer.append(TruthMap(x_um[:2], y_um[:3], depth_um[:3, :2]))
    writer.append(TruthMap(x_um, y_um, depth_um))
    path = writer.finish("done", 0)
    with open_run(path) as run:
        found = run.truth_map()
    assert found is not None
    assert np.array_equal(found.x_um, x_um)
    assert np.array_equal(found.y_um, y_um)
    assert np.array_equal(found.depth_um, depth_um)
    with h5py.File(path) as file:
        truth = file["/entry/truth"]
        assert truth.attrs["signal"] == "depth"
        assert list(truth.attrs["axes"]) == ["y", "x"]
        assert [truth["depth"].dims[k][0].name for k in (0, 1)] == ["/entry/truth/y", "/entry/truth/x"]


def test_a_run_without_a_channel_has_no_map(run_path: Path) -> None:
    with open_run(run_path) as run:
        assert run.truth_map() is None
