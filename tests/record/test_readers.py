"""Other people's programs read a run file: finished, recovered, and while it is written."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from edmctl.record import layout
from edmctl.record.recovery import recover
from edmctl.record.rows import TruthMap
from edmctl.record.writer import RunWriter
from tests.record.samples import a_meta, fill
from tests.tiers import tiers

PLOTS = [table for table in layout.TABLES if table.signal]


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A file with 10,000 rows of the servo whose writer goes on."""
    writer = RunWriter.create(tmp_path_factory.mktemp("live") / "run.h5", a_meta())
    fill(writer)
    writer.append(TruthMap(np.arange(4.0), np.arange(3.0), np.arange(12.0).reshape(3, 4)))
    writer.flush()
    yield writer.path
    writer.finish("done", 0)


@pytest.fixture(scope="module")
def recovered(live: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What is made of the same file when its writer was killed."""
    left = tmp_path_factory.mktemp("recovered") / "run.h5.partial"
    shutil.copyfile(live, left)
    return recover(left).path


@pytest.fixture(params=tiers("real_run", slow=("recovered",)))
def path(request: pytest.FixtureRequest) -> Path:
    found: Path = request.getfixturevalue(request.param)
    return found


def rows(path: Path, name: str) -> int:
    with h5py.File(path) as file:
        return int(file[name].shape[0])


def test_h5py_finds_a_unit_on_every_dataset_and_str_for_texts(path: Path) -> None:
    items: dict[str, h5py.Dataset | h5py.Group] = {}
    with h5py.File(path) as file:
        file.visititems(items.__setitem__)
        for name, item in items.items():
            ours = set(item.attrs) - {"CLASS", "NAME"}  # of HDF5's own dimension scales
            assert not [key for key in ours if isinstance(item.attrs[key], bytes)], name
        datasets = {name: item for name, item in items.items() if isinstance(item, h5py.Dataset)}
        assert len(datasets) > 100
        for name, dataset in datasets.items():
            units = dataset.attrs["units"]
            if dataset.dtype.names:
                assert len(units) == len(dataset.dtype.names), name
            elif name != "entry/summary":
                assert (units == "") == (dataset.dtype.kind == "S"), name


@pytest.mark.needs("nexusformat")
def test_nexusformat_finds_plots_texts_and_tables(path: Path) -> None:
    from nexusformat.nexus import nxload

    root = nxload(path)
    plot = root.plottable_data
    assert (plot.nxpath, plot.nxsignal.nxname) == ("/entry/data", "z_sensor")
    assert plot.nxsignal.attrs["units"] == "um"
    assert [axis.nxname for axis in plot.nxaxes] == ["time"]
    assert plot.nxsignal.shape == (rows(path, "/entry/servo/time"),)
    for table in PLOTS:
        group = root[table.path]
        assert (group.nxclass, group.plottable_data.nxsignal.nxname) == ("NXdata", table.signal)
        axes = [axis.nxname for axis in group.plottable_data.nxaxes or []]
        assert not table.axis or axes == [table.axis]
    with h5py.File(path) as file:
        assert root["entry/title"].nxvalue == file["entry/title"].asstr()[()]
        assert root["entry/profile/toml"].nxvalue == file["entry/profile/toml"].asstr()[()].strip()
        assert root["entry/touches"].nxdata["kind"].tolist() == file["entry/touches"]["kind"].tolist()


@pytest.mark.needs("silx")
def test_silx_finds_every_plot(path: Path) -> None:
    from silx.io import open as silx_open
    from silx.io.nxdata import get_default

    with silx_open(str(path)) as file:
        plot = get_default(file)
        assert plot.is_valid
        assert plot.is_curve
        assert (plot.signal_dataset_name, plot.signal.attrs["units"]) == ("z_sensor", "um")
        assert (plot.axes_dataset_names, plot.axes[0].attrs["units"]) == (["time"], "s")
        assert plot.auxiliary_signals_dataset_names == ["z_model"]
        assert {signal.attrs["units"] for signal in plot.auxiliary_signals} == {"um"}
        for table in PLOTS:
            plot = get_default(file[table.path])
            assert plot.is_valid
            names = {column.name: column.long_name for column in table.columns}
            assert (plot.signal_dataset_name, plot.signal_name) == (table.signal, names[table.signal])
            assert plot.axes_dataset_names == [table.axis or None]
            assert plot.auxiliary_signals_dataset_names == list(table.auxiliary)


def test_pandas_takes_groups_of_columns_and_compound_tables(path: Path) -> None:
    import pandas as pd

    with h5py.File(path) as file:
        for table in (*PLOTS, layout.SEGMENTS):
            frame = pd.DataFrame({name: column[:] for name, column in file[table.path].items()})
            assert sorted(frame) == sorted(column.name for column in table.columns)
            assert len(frame) == len(file[table.datasets[0]])
        touches = pd.DataFrame.from_records(file["/entry/touches"][:])
    assert list(touches) == [column.name for column in layout.TOUCHES.columns]
    assert "Z1" in touches["kind"].str.decode("utf-8").tolist()
    assert touches["z_sensor"].dtype == np.float64


@pytest.mark.needs("xarray")
def test_xarray_finds_times_and_units_and_takes_the_whole_file_for_a_tree(path: Path) -> None:
    import xarray as xr

    with xr.open_datatree(path, engine="h5netcdf", phony_dims="sort") as tree:
        assert {table.path for table in PLOTS} <= set(tree.groups)
    for table in (table for table in PLOTS if table.axis):
        with xr.open_dataset(path, engine="h5netcdf", group=table.path, phony_dims="sort") as dataset:
            assert dict(dataset.sizes) == {"time": rows(path, f"{table.path}/time")}
            assert list(dataset.coords) == ["time"]
            assert dataset["time"].attrs["units"] == "s"
            for column in table.columns:
                assert dataset[column.name].dims == ("time",)
                assert dataset[column.name].attrs["units"] == column.units


@pytest.mark.needs("nexusformat", "silx", "xarray")
def test_readers_find_the_axes_of_a_map(recovered: Path) -> None:
    import xarray as xr
    from nexusformat.nexus import nxload
    from silx.io import open as silx_open
    from silx.io.nxdata import get_default

    with silx_open(str(recovered)) as file:
        plot = get_default(file["/entry/truth"])
        assert plot.is_valid
        assert plot.is_image
        assert plot.axes_dataset_names == ["y", "x"]
    assert [axis.nxname for axis in nxload(recovered)["entry/truth"].plottable_data.nxaxes] == ["y", "x"]
    with xr.open_dataset(recovered, engine="h5netcdf", group="/entry/truth", phony_dims="sort") as dataset:
        assert dataset["depth"].dims == ("y", "x")
        assert float(dataset["depth"].sel(y=2.0, x=1.0)) == 9.0


@pytest.mark.parametrize(
    "program",
    [
        """import h5py
with h5py.File(path, "r", swmr=True) as file:
    print(len(file["/entry/servo/time"]))""",
        pytest.param(
            """import silx.io
from silx.io.nxdata import get_default
with silx.io.open(path) as file:
    print(len(get_default(file).signal))""",
            marks=pytest.mark.needs("silx"),
        ),
        pytest.param(
            """import xarray
options = {"engine": "h5netcdf", "phony_dims": "sort", "driver_kwds": {"swmr": True}}
with xarray.open_dataset(path, group="/entry/servo", **options) as dataset:
    print(dataset.sizes["time"])""",
            marks=[pytest.mark.needs("xarray"), pytest.mark.slow],
        ),
    ],
    ids=["h5py", "silx", "xarray"],
)
def test_a_file_that_is_being_written_can_be_read(live: Path, program: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"path = {str(live)!r}\n{program}"],
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("10000\n", "")
