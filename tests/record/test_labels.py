"""What results rest on, in files of today and in those from before it was written."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from edmctl.labels import Basis, Verdict
from edmctl.record.layout import RESULTS
from edmctl.record.reader import open_run
from edmctl.record.results import Labels, labels_of
from edmctl.record.rows import TouchRow
from edmctl.record.run_index import read_head
from edmctl.record.writer import RunWriter
from edmctl.report.numbers import numbers_of
from tests.record.samples import a_meta, a_site_row

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.results.job import SiteResult

NEW = ("depth_basis", "wear_basis", "verdict")


def a_run(folder: Path, *rows: SiteResult, z_sensor_um: float = 50.0) -> Path:
    writer = RunWriter.create(folder / "run.h5", a_meta())
    writer.append(TouchRow(1.0, "Z1", "A1", 20.0, z_sensor_um, 49.0, 3, 0.3, 0.0, 1.0))
    for row in rows:
        writer.append(row)
    return writer.finish("done", 0)


def older(path: Path, *left_out: str) -> Path:
    """Take columns off the results, as a version had it that did not know them."""
    with h5py.File(path, "r+") as file:
        rows = file[RESULTS.path][:]
        names = [name for name in rows.dtype.names if name not in left_out]
        del file[RESULTS.path]
        kept = np.empty(len(rows), [(name, rows.dtype[name]) for name in names])
        for name in names:
            kept[name] = rows[name]
        file.create_dataset(RESULTS.path, data=kept)
    return path


def labels(path: Path) -> list[Labels]:
    with open_run(path) as run:
        found = labels_of(run)
        assert [(n.depth_basis, n.wear_basis, n.verdict) for n in numbers_of(run).sites] == [
            (one.depth_basis, one.wear_basis, one.verdict) for one in found
        ]
    return found


def test_what_was_written_is_read(tmp_path: Path) -> None:
    row = replace(
        a_site_row(), depth_basis=Basis.ESTIMATED, wear_basis=Basis.TOUCHED, verdict=Verdict.NOT_SHOWN
    )
    assert labels(a_run(tmp_path, row)) == [Labels("estimated", "touched", "not shown")]


@pytest.mark.parametrize(
    ("stops", "estimated_um", "through", "depth_basis", "wear_basis"),
    [
        (2, 0.0, False, "touched", "touched"),
        (1, 2.5, False, "estimated", "estimated"),
        (0, 20.0, False, "estimated", "estimated"),
        (1, 0.0, True, "", "touched"),
    ],
)
def test_an_older_file_tells_by_its_touches(
    tmp_path: Path, stops: int, estimated_um: float, through: bool, depth_basis: str, wear_basis: str
) -> None:
    row = replace(a_site_row(), measuring_stops=stops, estimated_um=estimated_um, through=through)
    path = older(a_run(tmp_path, row), *NEW)
    assert labels(path) == [Labels(depth_basis, wear_basis, "")]


def test_an_older_file_without_a_sensor_has_touches_by_the_model(tmp_path: Path) -> None:
    row = replace(a_site_row(), measuring_stops=1)
    path = older(a_run(tmp_path, row, z_sensor_um=float("nan")), *NEW)
    assert labels(path) == [Labels("model", "model", "")]


def test_the_head_of_a_run_has_the_weakest_basis_and_the_worst_verdict(tmp_path: Path) -> None:
    good = replace(a_site_row(), depth_basis=Basis.TOUCHED, wear_basis=Basis.TOUCHED, verdict=Verdict.SHOWN)
    path = a_run(
        tmp_path,
        good,
        replace(good, name="A2", depth_basis=Basis.ESTIMATED, verdict=Verdict.MISSED),
        replace(good, name="A3", verdict=Verdict.NOT_SHOWN),
    )
    head = read_head(path)
    assert (head.depth_basis, head.wear_basis, head.verdict) == ("estimated", "touched", "missed")
