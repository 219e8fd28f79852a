"""Builds the empty tree of a run file.

SWMR forbids new objects once it is on, so everything that a run may write exists before its first row.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from functools import cache

import h5py
import numpy as np
from numpy.typing import NDArray

from edmctl.record import layout
from edmctl.record.layout import Grid, Scalar, Table
from edmctl.record.opening import image_of
from edmctl.record.run_meta import RunMeta
from edmctl.results.declared import PURE, TEXT

RUNNING = "running"
NO_EXIT_CODE = -1
NO_SEED = -1
LIBRARY_VERSIONS = ("v110", "v110")
"""The oldest format that can be written in SWMR mode, and read by every HDF5 since 1.10."""

_TEXT = h5py.string_dtype()
_TEXT_TYPE, _TEXT_IN_MEMORY = h5py.h5t.py_create(_TEXT, logical=True), h5py.h5t.py_create(_TEXT)
_ONE = h5py.h5s.create(h5py.h5s.SCALAR)
_NO_ROWS = h5py.h5s.create_simple((0,), (h5py.h5s.UNLIMITED,))


def empty_run_file(meta: RunMeta) -> bytes:
    """Return the bytes of a run file without rows."""
    return image_of(lambda file: _build_tree(file, meta), libver=LIBRARY_VERSIONS)


def _build_tree(file: h5py.File, meta: RunMeta) -> None:
    _put_attributes(
        file.id,
        {
            "NX_class": "NXroot",
            "default": "entry",
            "creator": "edmctl",
            "edmctl_version": meta.edmctl_version,
            "file_time": meta.start_time,
            "schema": layout.SCHEMA,
        },
    )
    for group in layout.GROUPS:
        _put_attributes(_create_group(file, group.path), {"NX_class": group.nx_class})
    _put_attributes(file["/entry"].id, {"default": layout.DEFAULT_PLOT.rpartition("/")[2]})
    values = _scalar_values(meta)
    for scalar in layout.SCALARS:
        _create_scalar(file, scalar, values[scalar.path])
    values_group = file["/entry/profile/values"].id
    for leaf in meta.profile_leaves:
        _put_attributes(values_group, {leaf.key: leaf.value})
        if leaf.units not in (PURE, TEXT):
            _put_attributes(values_group, {f"{leaf.key}_units": leaf.units})
    for table in layout.TABLES:
        if table.is_compound:
            _create_compound(file, table)
        else:
            _create_columns(file, table, meta.start_time)
    for grid in layout.GRIDS:
        _create_grid(file, grid)
    _link_default_plot(file)


def compound_dtype(table: Table) -> np.dtype[np.void]:
    """Row type of a compound table."""
    return np.dtype([(column.name, _stored_type(column.dtype)) for column in table.columns])


def _stored_type(dtype: str) -> np.dtype[np.generic]:
    """The type itself; texts of fixed length are marked as UTF-8."""
    kind: np.dtype[np.generic] = np.dtype(dtype)
    return h5py.string_dtype("utf-8", kind.itemsize) if kind.kind == "S" else kind


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
        "/entry/tool/length_wear_total": 0.0,
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
        dataset = _create_growing(file.id, scalar.path, np.dtype("u1"), 1024)
    else:
        if isinstance(value, str):
            values: NDArray[np.generic] = _texts([value]).reshape(())
        elif isinstance(value, list):
            values = _texts(value)
        else:
            values = np.array(value, _stored_type(scalar.dtype))
        space = h5py.h5s.create_simple(values.shape) if values.shape else _ONE
        kind = h5py.h5t.py_create(values.dtype, logical=True)
        dataset = h5py.h5d.create(file.id, scalar.path.encode(), kind, space)
        if values.size:
            dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, values)
    _describe(dataset, scalar.units, scalar.long_name)


def _texts(texts: Sequence[str]) -> NDArray[np.bytes_]:
    """Texts as UTF-8 of one length, shape (n,).

    Texts of variable length would lie in HDF5's global heap, which has no check sums.
    """
    utf8 = [text.encode() for text in texts]
    longest = max((len(text) for text in utf8), default=0)
    return np.array(utf8, h5py.string_dtype("utf-8", max(1, longest)))


def _create_columns(file: h5py.File, table: Table, start_time: str) -> None:
    group = _create_group(file, table.path)
    time = None
    for column in table.columns:
        dataset = _create_growing(group, column.name, np.dtype(column.dtype), table.chunk_rows)
        _describe(dataset, column.units, column.long_name)
        if column.name == table.axis:
            _put_attributes(dataset, {"start": start_time})
            h5py.h5ds.set_scale(dataset, column.name.encode())
            time = dataset
        elif time is not None:
            h5py.h5ds.attach_scale(dataset, time, 0)
    _put_attributes(group, {"NX_class": table.nx_class})
    if table.signal:
        _make_plottable(group, table.signal, table.axis, table.auxiliary)


def _create_compound(file: h5py.File, table: Table) -> None:
    dataset = _create_growing(file.id, table.path, compound_dtype(table), table.chunk_rows)
    _put_attributes(
        dataset,
        {
            "units": [column.units for column in table.columns],
            "long_name": [column.long_name for column in table.columns],
        },
    )


def _create_grid(file: h5py.File, grid: Grid) -> None:
    group = _create_group(file, grid.path)
    signal = grid.signal
    growing = (h5py.h5s.UNLIMITED, h5py.h5s.UNLIMITED)
    chunked = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    chunked.set_chunk((grid.chunk, grid.chunk))
    kind = h5py.h5t.py_create(np.dtype(signal.dtype), logical=True)
    empty = h5py.h5s.create_simple((0, 0), growing)
    depth = h5py.h5d.create(group, signal.name.encode(), kind, empty, chunked)
    _describe(depth, signal.units, signal.long_name)
    for dimension, axis in enumerate(grid.axes):
        dataset = _create_growing(group, axis.name, np.dtype(axis.dtype), grid.chunk)
        _describe(dataset, axis.units, axis.long_name)
        h5py.h5ds.set_scale(dataset, axis.name.encode())
        h5py.h5ds.attach_scale(depth, dataset, dimension)
    _put_attributes(group, {"NX_class": "NXdata", "axes": [axis.name for axis in grid.axes]})
    _put_attributes(group, {"signal": signal.name})


def _link_default_plot(file: h5py.File) -> None:
    plot, servo = file[layout.DEFAULT_PLOT].id, file[layout.SERVO.path].id
    for name in (layout.DEFAULT_AXIS, layout.DEFAULT_SIGNAL, *layout.DEFAULT_AUXILIARY):
        plot.links.create_hard(name.encode(), servo, name.encode())
    _make_plottable(plot, layout.DEFAULT_SIGNAL, layout.DEFAULT_AXIS, layout.DEFAULT_AUXILIARY)


def _make_plottable(group: h5py.h5g.GroupID, signal: str, axis: str, auxiliary: tuple[str, ...]) -> None:
    """Tell viewers what to plot in an NXdata; without an axis, against the number of the row."""
    _put_attributes(group, {"signal": signal})
    if axis:
        _put_attributes(group, {"axes": [axis]})
    if auxiliary:
        _put_attributes(group, {"auxiliary_signals": list(auxiliary)})


# A file has 105 datasets with two texts each. h5py's low-level calls take a third of the time off that every run
# spends here, in comparison with `create_dataset` and `attrs[name] = text`.


def _create_group(file: h5py.File, path: str) -> h5py.h5g.GroupID:
    return h5py.h5g.create(file.id, path.encode())


def _create_growing(
    parent: h5py.h5g.GroupID, name: str, dtype: np.dtype[np.generic], chunk_rows: int
) -> h5py.h5d.DatasetID:
    return h5py.h5d.create(parent, name.encode(), _type_of(dtype), _NO_ROWS, _chunks_of(chunk_rows))


@cache
def _type_of(dtype: np.dtype[np.generic]) -> h5py.h5t.TypeID:
    return h5py.h5t.py_create(dtype, logical=True)


@cache
def _chunks_of(rows: int) -> h5py.h5p.PropDCID:
    chunked = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    chunked.set_chunk((rows,))
    return chunked


def _describe(dataset: h5py.h5d.DatasetID, units: str, long_name: str) -> None:
    _put_attributes(dataset, {"units": units, "long_name": long_name})


def _put_attributes(
    target: h5py.h5g.GroupID | h5py.h5d.DatasetID, attributes: Mapping[str, str | list[str] | float | bool]
) -> None:
    """Write numbers, texts, and lists of texts; these of variable length.

    Of a text of fixed length h5py and silx would make bytes, and show them as such.
    """
    for name, value in attributes.items():
        is_number = isinstance(value, int | float)
        values = np.array(value) if is_number else np.array(value, _TEXT)
        kind = _type_of(values.dtype) if is_number else _TEXT_TYPE
        space = h5py.h5s.create_simple(values.shape) if values.shape else _ONE
        attribute = h5py.h5a.create(target, name.encode(), kind, space)
        attribute.write(values, kind if is_number else _TEXT_IN_MEMORY)
