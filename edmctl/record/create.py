"""Builds the tree of a run file: one that grows, for a writer, or a compressed one whose rows are known.

SWMR forbids new objects once it is on, so everything that a run may write exists before its first row. A file has
105 datasets with two texts each: h5py's low-level calls take a third of the time off that every run spends here.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5g, h5p, h5s, h5t
from numpy.typing import NDArray

from edmctl.dataclasses import dataclass
from edmctl.record import layout
from edmctl.record.layout import Grid, Scalar, Table
from edmctl.record.opening import image_of
from edmctl.record.rows import Leaf, RunMeta, unit_of
from edmctl.results.declared import PURE

RUNNING = "running"
NO_EXIT_CODE = -1
NO_SEED = -1
LIBRARY_VERSIONS = ("v110", "v110")
"""The oldest format that can be written in SWMR mode, and read by every HDF5 since 1.10."""
CHUNK_ROWS = 1 << 16
GZIP_LEVEL = 4
"""Level 9 takes ten times as long and saves 3 % of the pulses."""
SMALLEST_BYTES = 2048
"""Smaller datasets are not worth a chunk."""

_TEXT = h5py.string_dtype()
_TEXT_TYPE, _TEXT_IN_MEMORY = h5t.py_create(_TEXT, logical=True), h5t.py_create(_TEXT)
_ONE = h5s.create(h5s.SCALAR)
_UNLIMITED = h5s.UNLIMITED
UNKNOWN = {"f8": np.nan, "i4": NO_EXIT_CODE, "i8": NO_SEED, "u1": 0, "text": "", "texts": (), "json": b""}
"""Scalars without a value, by their type; texts of fixed length are empty."""


@dataclass(frozen=True, slots=True)
class Content:
    """Content of a new run file, without its rows.

    values : scalars by their paths, and arrays of grids, as far as they are known
    profile : values of the profile and their units by dotted keys
    rows : of each table; None for a file that grows
    """

    values: dict[str, Any]
    profile: Mapping[str, Leaf]
    rows: Mapping[str, int] | None = None


def empty_run_file(meta: RunMeta) -> bytes:
    """Return the bytes of a run file without rows, which grows."""
    values = {scalar.path: getattr(meta, scalar.source) for scalar in layout.SCALARS if scalar.source}
    values |= {
        "/entry/command": json.dumps(list(meta.command)),
        "/entry/status": RUNNING.encode(),
        "/entry/simulated": int(meta.simulated),
        "/entry/seed": NO_SEED if meta.seed is None else meta.seed,
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
    profile = dict(meta.profile_leaves)
    for key, value in meta.profile_leaves.items():
        if not isinstance(value, bool | str) and (unit := unit_of(key)) != PURE:
            profile[f"{key}_units"] = unit
    return image_of(lambda file: build_tree(file, Content(values, profile)), libver=LIBRARY_VERSIONS)


def build_tree(file: h5py.File, content: Content) -> None:
    """Create every object of a run file, with the values of the scalars and grids, but without rows."""
    attributes = {
        "NX_class": "NXroot",
        "default": "entry",
        "creator": "edmctl",
        "edmctl_version": content.values["/entry/software/version"],
        "file_time": content.values["/entry/start_time"],
        "schema": layout.SCHEMA,
    }
    _put_attributes(file.id, attributes)
    for group in layout.GROUPS:
        _put_attributes(h5g.create(file.id, group.path.encode()), {"NX_class": group.nx_class})
    _put_attributes(file["/entry"].id, {"default": layout.DEFAULT_PLOT.rpartition("/")[2]})
    _put_attributes(file["/entry/profile/values"].id, content.profile)
    for scalar in layout.SCALARS:
        _create_scalar(file, scalar, content.values.get(scalar.path), grows=content.rows is None)
    for table in layout.TABLES:
        rows = None if content.rows is None else content.rows[table.path]
        if table.is_compound:
            _create_compound(file, table, rows)
        else:
            _create_columns(file, table, rows, attributes["file_time"])
    for grid in layout.GRIDS:
        _create_grid(file, grid, content.values)
    _link_default_plot(file)


def compound_dtype(table: Table) -> np.dtype[np.void]:
    """Row type of a compound table."""
    return np.dtype([(column.name, stored_type(column.dtype)) for column in table.columns])


def stored_type(dtype: str) -> np.dtype[np.generic]:
    """The type itself; texts of fixed length are marked as UTF-8."""
    kind: np.dtype[np.generic] = np.dtype(dtype)
    return h5py.string_dtype("utf-8", kind.itemsize) if kind.kind == "S" else kind


def fit_utf8(text: str, width: int) -> bytes:
    """Return `text` as UTF-8 of at most `width` bytes, cut between characters."""
    return text.encode()[:width].decode(errors="ignore").encode()


def _create_scalar(file: h5py.File, scalar: Scalar, value: Any, *, grows: bool) -> None:
    if value is None:
        value = UNKNOWN.get(scalar.dtype, b"")
    if scalar.dtype == "json" and grows:
        dataset = _create_rows(file.id, scalar.path, np.dtype("u1"), 1024)
    elif scalar.dtype == "json":
        dataset = _create_array(file.id, scalar.path, np.frombuffer(value, "u1"))
    elif scalar.dtype == "texts":
        dataset = _create_array(file.id, scalar.path, _texts(value))
    elif scalar.dtype == "text":
        dataset = _create_array(file.id, scalar.path, _texts([value]).reshape(()))
    else:
        dataset = _create_array(file.id, scalar.path, np.array(value, stored_type(scalar.dtype)))
    _describe(dataset, scalar)


def _texts(texts: Sequence[str]) -> NDArray[np.bytes_]:
    """Texts as UTF-8 of one length, shape (n,).

    Texts of variable length would lie in HDF5's global heap, which has no check sums.
    """
    utf8 = [text.encode() for text in texts]
    return np.array(utf8, h5py.string_dtype("utf-8", max([1, *map(len, utf8)])))


def _create_columns(file: h5py.File, table: Table, rows: int | None, start_time: str) -> None:
    group = h5g.create(file.id, table.path.encode())
    time = None
    for column in table.columns:
        dataset = _create_rows(group, column.name, np.dtype(column.dtype), table.chunk_rows, rows)
        _describe(dataset, column)
        if column.name == table.axis:
            _put_attributes(dataset, {"start": start_time})
            h5ds.set_scale(dataset, column.name.encode())
            time = dataset
        elif time is not None:
            h5ds.attach_scale(dataset, time, 0)
    _put_attributes(group, {"NX_class": table.nx_class})
    if table.signal:
        _make_plottable(group, table.signal, table.axis, table.auxiliary)


def _create_compound(file: h5py.File, table: Table, rows: int | None) -> None:
    dataset = _create_rows(file.id, table.path, compound_dtype(table), table.chunk_rows, rows)
    units, names = ([getattr(one, name) for one in table.columns] for name in ("units", "long_name"))
    _put_attributes(dataset, {"units": units, "long_name": names})


def _create_grid(file: h5py.File, grid: Grid, values: Mapping[str, Any]) -> None:
    """Create a map and its axes: with their arrays where they are given, else growing."""
    group = h5g.create(file.id, grid.path.encode())
    made: list[h5d.DatasetID] = []
    for column, dimensions in ((grid.signal, 2), *((axis, 1) for axis in grid.axes)):
        array = values.get(f"{grid.path}/{column.name}")
        if array is not None:
            made.append(_create_array(group, column.name, np.array(array, column.dtype)))
        else:
            chunked = h5p.create(h5p.DATASET_CREATE)
            chunked.set_chunk((grid.chunk,) * dimensions)
            empty = h5s.create_simple((0,) * dimensions, (_UNLIMITED,) * dimensions)
            made.append(
                h5d.create(group, column.name.encode(), _type_of(np.dtype(column.dtype)), empty, chunked)
            )
        _describe(made[-1], column)
    signal, *axes = made
    for dimension, (axis, column) in enumerate(zip(axes, grid.axes, strict=True)):
        h5ds.set_scale(axis, column.name.encode())
        h5ds.attach_scale(signal, axis, dimension)
    names = [axis.name for axis in grid.axes]
    _put_attributes(group, {"NX_class": "NXdata", "axes": names, "signal": grid.signal.name})


def _link_default_plot(file: h5py.File) -> None:
    plot, servo = file[layout.DEFAULT_PLOT].id, file[layout.SERVO.path].id
    for name in (layout.DEFAULT_AXIS, layout.DEFAULT_SIGNAL, *layout.DEFAULT_AUXILIARY):
        plot.links.create_hard(name.encode(), servo, name.encode())
    _make_plottable(plot, layout.DEFAULT_SIGNAL, layout.DEFAULT_AXIS, layout.DEFAULT_AUXILIARY)


def _make_plottable(group: h5g.GroupID, signal: str, axis: str, auxiliary: Sequence[str]) -> None:
    """Tell viewers what to plot in an NXdata; without an axis, against the number of the row."""
    _put_attributes(group, {"signal": signal})
    if axis:
        _put_attributes(group, {"axes": [axis]})
    if auxiliary:
        _put_attributes(group, {"auxiliary_signals": list(auxiliary)})


def _create_rows(
    parent: h5g.GroupID, name: str, dtype: np.dtype[np.generic], chunk_rows: int, rows: int | None = None
) -> h5d.DatasetID:
    """Create a dataset that grows, or one of so many rows: chunks with the filters shuffle and gzip."""
    properties = h5p.create(h5p.DATASET_CREATE)
    if rows is None:
        space = h5s.create_simple((0,), (_UNLIMITED,))
        properties.set_chunk((chunk_rows,))
    else:
        space = h5s.create_simple((rows,))
        if rows * dtype.itemsize > SMALLEST_BYTES:
            properties.set_chunk((min(rows, CHUNK_ROWS),))
            if dtype.itemsize > 1:
                properties.set_shuffle()
            properties.set_deflate(GZIP_LEVEL)
    return h5d.create(parent, name.encode(), _type_of(dtype), space, properties)


def _create_array(parent: h5g.GroupID, name: str, values: NDArray[np.generic]) -> h5d.DatasetID:
    space = h5s.create_simple(values.shape) if values.shape else _ONE
    dataset = h5d.create(parent, name.encode(), _type_of(values.dtype), space)
    if values.size:
        dataset.write(h5s.ALL, h5s.ALL, values)
    return dataset


@cache
def _type_of(dtype: np.dtype[np.generic]) -> h5t.TypeID:
    return h5t.py_create(dtype, logical=True)


def _describe(dataset: h5d.DatasetID, item: Scalar | layout.Column) -> None:
    _put_attributes(dataset, {"units": item.units, "long_name": item.long_name})


def _put_attributes(
    target: h5g.GroupID | h5d.DatasetID, attributes: Mapping[str, str | Sequence[str] | float | bool]
) -> None:
    """Write numbers, texts, and lists of texts; these of variable length.

    Of a text of fixed length h5py and silx would make bytes, and show them as such.
    """
    for name, value in attributes.items():
        is_number = isinstance(value, int | float)
        values = np.array(value) if is_number else np.array(value, _TEXT)
        kind = _type_of(values.dtype) if is_number else _TEXT_TYPE
        space = h5s.create_simple(values.shape) if values.shape else _ONE
        attribute = h5a.create(target, name.encode(), kind, space)
        attribute.write(values, kind if is_number else _TEXT_IN_MEMORY)
