"""Builds the empty tree of a run file.

SWMR forbids new objects once it is on, so everything that a run may write exists before its first row.
"""

from __future__ import annotations

import hashlib
import json
import platform
from typing import TYPE_CHECKING

import h5py
import numpy as np

from . import layout
from .layout import PURE, TEXT, Scalar, Table

if TYPE_CHECKING:
    from .rows import RunMeta

RUNNING = "running"
NO_EXIT_CODE = -1
NO_SEED = -1
NO_WEAR_YET = 0.0
LIBRARY_VERSIONS = ("v110", "v110")
"""The oldest format that can be written in SWMR mode, and read by every HDF5 since 1.10."""

_TEXT = h5py.string_dtype()
_TEXT_TYPE = h5py.h5t.py_create(_TEXT, logical=True)
_ONE = h5py.h5s.create(h5py.h5s.SCALAR)


def empty_run_file(meta: RunMeta) -> bytes:
    """Return the bytes of a run file without rows.

    It is built in memory, because HDF5 does not survive a disk that fills up while it creates objects.
    """
    with h5py.File("empty", "w", driver="core", backing_store=False, libver=LIBRARY_VERSIONS) as file:
        _build_tree(file, meta)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _build_tree(file: h5py.File, meta: RunMeta) -> None:
    file.attrs.update(
        {
            "NX_class": "NXroot",
            "default": "entry",
            "creator": "edmctl",
            "edmctl_version": meta.edmctl_version,
            "file_time": meta.start_time,
            "schema": layout.SCHEMA,
        }
    )
    for group in layout.GROUPS:
        file.create_group(group.path).attrs["NX_class"] = group.nx_class
    file["/entry"].attrs["default"] = layout.DEFAULT_PLOT.rpartition("/")[2]
    values = _scalar_values(meta)
    for scalar in layout.SCALARS:
        _create_scalar(file, scalar, values[scalar.path])
    _write_leaves(file["/entry/profile/values"], meta)
    for table in layout.TABLES:
        if table.is_compound:
            _create_compound(file, table)
        else:
            _create_columns(file, table, meta.start_time)
    _link_default_plot(file)


def compound_dtype(table: Table) -> np.dtype[np.void]:
    """Row type of a compound table."""
    return np.dtype([(column.name, column.dtype) for column in table.columns])


def _scalar_values(meta: RunMeta) -> dict[str, object]:
    values = {scalar.path: getattr(meta, scalar.source) for scalar in layout.SCALARS if scalar.source}
    return values | {
        "/entry/command": json.dumps(list(meta.command)),
        "/entry/end_time": b"",
        "/entry/status": RUNNING.encode(),
        "/entry/exit_code": NO_EXIT_CODE,
        "/entry/simulated": int(meta.simulated),
        "/entry/seed": NO_SEED if meta.seed is None else meta.seed,
        "/entry/recovery": b"",
        "/entry/summary": None,
        "/entry/tool/length_wear_total": NO_WEAR_YET,
        "/entry/profile/sha256": hashlib.sha256(meta.profile_text.encode()).hexdigest(),
        "/entry/profile/parents": [parent.text for parent in meta.profile_parents],
        "/entry/profile/parent_paths": [parent.path for parent in meta.profile_parents],
        "/entry/profile/overrides": "\n".join(meta.profile_overrides),
        "/entry/software/program": "edmctl",
        "/entry/software/python": platform.python_version(),
        "/entry/software/h5py": h5py.version.version,
        "/entry/software/hdf5": h5py.version.hdf5_version,
    }


def _create_scalar(file: h5py.File, scalar: Scalar, value: object) -> None:
    if scalar.dtype == "json":
        dataset = _create_growing(file, scalar.path, np.dtype("u1"), 1024)
    else:
        kind = _TEXT if scalar.dtype in ("text", "texts") else np.dtype(scalar.dtype)
        values = np.array(value, kind)
        space = h5py.h5s.create_simple(values.shape) if values.shape else _ONE
        dataset = h5py.h5d.create(
            file.id, scalar.path.encode(), h5py.h5t.py_create(kind, logical=True), space
        )
        if values.size:
            dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, values)
    _describe(dataset, scalar.units, scalar.long_name)


def _create_columns(file: h5py.File, table: Table, start_time: str) -> None:
    group = file.create_group(table.path)
    group.attrs["NX_class"] = table.nx_class
    for column in table.columns:
        dataset = _create_growing(group, column.name, np.dtype(column.dtype), table.chunk_rows)
        _describe(dataset, column.units, column.long_name)
    if "time" in group:
        _make_time_axis(group, start_time)


def _create_compound(file: h5py.File, table: Table) -> None:
    _create_growing(file, table.path, compound_dtype(table), table.chunk_rows)
    attributes = file[table.path].attrs
    attributes["units"] = [column.units for column in table.columns]
    attributes["long_name"] = [column.long_name for column in table.columns]


# A file has 70 datasets with two texts each. h5py's low-level calls, used in the next two functions, take a
# third of the time of `create_dataset` and `attrs[name] = text`: 30 ms of every run.


def _create_growing(
    parent: h5py.Group, name: str, dtype: np.dtype[np.generic], chunk_rows: int
) -> h5py.h5d.DatasetID:
    chunked = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    chunked.set_chunk((chunk_rows,))
    empty = h5py.h5s.create_simple((0,), (h5py.h5s.UNLIMITED,))
    return h5py.h5d.create(parent.id, name.encode(), h5py.h5t.py_create(dtype, logical=True), empty, chunked)


def _describe(dataset: h5py.h5d.DatasetID, units: str, long_name: str) -> None:
    for name, text in ((b"units", units), (b"long_name", long_name)):
        attribute = h5py.h5a.create(dataset, name, _TEXT_TYPE, _ONE)
        attribute.write(np.array(text, _TEXT))


def _write_leaves(group: h5py.Group, meta: RunMeta) -> None:
    for leaf in meta.profile_leaves:
        group.attrs[leaf.key] = leaf.value
        if leaf.units not in (PURE, TEXT):
            group.attrs[f"{leaf.key}_units"] = leaf.units


def _make_time_axis(group: h5py.Group, start_time: str) -> None:
    time = group["time"]
    time.attrs["start"] = start_time
    time.make_scale("time")
    for name, dataset in group.items():
        if name != "time":
            dataset.dims[0].attach_scale(time)


def _link_default_plot(file: h5py.File) -> None:
    plot = file[layout.DEFAULT_PLOT]
    servo = file[layout.SERVO.path]
    for name in (layout.DEFAULT_AXIS, layout.DEFAULT_SIGNAL, *layout.DEFAULT_AUXILIARY):
        plot[name] = servo[name]
    plot.attrs["signal"] = layout.DEFAULT_SIGNAL
    plot.attrs["axes"] = [layout.DEFAULT_AXIS]
    plot.attrs["auxiliary_signals"] = list(layout.DEFAULT_AUXILIARY)
