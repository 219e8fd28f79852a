"""Results are read as they were written; an earlier layout is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.labels import Basis, Verdict
from edmctl.record.layout import RESULTS
from edmctl.record.reader import open_run, reading
from edmctl.record.rows import TouchRow
from edmctl.record.run_index import read_head, sites_of
from edmctl.record.writer import RunWriter
from edmctl.results.declared import quantities, stored_columns
from edmctl.results.job import SiteResult
from tests.record.samples import a_meta, a_site_row

if TYPE_CHECKING:
    from pathlib import Path


STORED = {one.source.partition(".")[0] for one in stored_columns(SiteResult)}


def a_run(folder: Path, *rows: SiteResult) -> Path:
    writer = RunWriter.create(folder / "run.h5", a_meta())
    writer.append(TouchRow(1.0, "Z1", "A1", 20.0, 50.0, 49.0, 3, 0.3, 0.0, 1.0))
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


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    row = replace(
        a_site_row(),
        depth_basis=Basis.ESTIMATED,
        verdict=Verdict.NOT_SHOWN,
        drift_by_rests=True,
        depth_u_um=0.4,
    )
    with open_run(a_run(tmp_path, row)) as run:
        (site,) = sites_of(run)
    read = {name: getattr(site, name) for name in quantities(SiteResult) if name in STORED}
    assert str(read) == str({name: getattr(row, name) for name in read})  # NaN is NaN
    assert site.length_um == row.depth_um
    assert not site.truth.is_known


def test_columns_that_a_file_does_not_have_are_unknown(tmp_path: Path) -> None:
    path = older(a_run(tmp_path, a_site_row()), "wear_basis", "face", "stops")
    with reading(path, verify=False) as run:
        (site,) = sites_of(run)
    assert (site.wear_basis, site.measuring_stops, site.depth_um) == (Basis.ESTIMATED, 0, 180.0)
    assert math.isnan(site.face_um)


def test_an_earlier_layout_is_refused(tmp_path: Path) -> None:
    path = a_run(tmp_path, a_site_row())
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = "edmctl-run/1"
    with pytest.raises(RunFileError, match="earlier version") as refused, reading(path, verify=False):
        pass
    assert refused.value.code == "E9006"
    assert "export" in refused.value.hint


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
