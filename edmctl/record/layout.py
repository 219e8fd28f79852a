"""The run file's layout: every group, dataset, unit and type, in one place, and the functions that create them.

NeXus classes and attributes (`default`, `signal`, `axes`, `auxiliary_signals`, `units`, `long_name`) let
generic viewers plot at once; HDF5 dimension scales let xarray find the time axis. Signals are columns, one
dataset each, and their group is an NXdata that plots by itself; only what is not plotted (events, touches, results)
is a compound table.

Full pulses are stored as the line carries them, in steps that their unit names (`0.1 us`): 6 bytes a pulse, of which
compression leaves 3. Everything else is in its plain unit.

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

from edmctl.dataclasses import dataclass, fields
from edmctl.record import rows as kinds
from edmctl.record.rows import EventLevel, EventRow, Row, RunMeta, Segment, ServoBlock, SlowRow, TouchRow
from edmctl.results.declared import PURE, TEXT, stored_columns
from edmctl.results.job import SiteResult
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain, TelemetryBlock, WaveformBatch

SCHEMA = "edmctl-run/2"
RUNNING = "running"
NO_EXIT_CODE = -1
NO_SEED = -1
LIBRARY_VERSIONS = ("v110", "v110")
"""The oldest format that can be written in SWMR mode, and read by every HDF5 since 1.10."""
CHUNK_ROWS = 1 << 16
"""Of a complete file, whose rows are compressed."""
GZIP_LEVEL = 4
"""Level 9 takes ten times as long and saves 3 % of the pulses."""
SMALLEST_BYTES = 2048
"""Smaller datasets are not worth a chunk."""


@dataclass(frozen=True, slots=True)
class Column:
    """A dataset or field: `field` is its name in a row, `step` the unit in which it is stored, as in `0.1 us`."""

    name: str
    field: str
    dtype: str
    units: str
    long_name: str
    step: float = 1.0


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of one length: a group of datasets, or one compound dataset.

    nx_class : class of the group; empty for a compound dataset
    signal : column of an NXdata that viewers plot
    auxiliary : columns that they plot beside it, all in its unit, because a viewer has one ordinate
    in_blocks : rows are handed over as arrays, one for each column
    at_once : rows are flushed as soon as they are handed over
    """

    path: str
    nx_class: str
    chunk_rows: int
    note: str
    columns: tuple[Column, ...]
    signal: str = ""
    auxiliary: tuple[str, ...] = ()
    in_blocks: bool = False
    at_once: bool = False

    @property
    def is_compound(self) -> bool:
        return not self.nx_class

    @property
    def datasets(self) -> tuple[str, ...]:
        """Their paths: of each column, or of the compound one."""
        return (self.path,) if self.is_compound else tuple(f"{self.path}/{one.name}" for one in self.columns)

    @property
    def axis(self) -> str:
        """Column that the others are plotted against; empty if rows have no time."""
        return "time" if self.columns[0].name == "time" else ""

    @property
    def row_type(self) -> np.dtype[np.void]:
        """Type of a row of a compound table."""
        return np.dtype([(column.name, stored_type(column.dtype)) for column in self.columns])


@dataclass(frozen=True, slots=True)
class Scalar:
    """One value. `source` is the RunMeta field it comes from; empty when it is written at the end.

    `dtype` is a numpy type, `text` (UTF-8, as long as the text is), `texts` (a list of them, of one length),
    or `json` (UTF-8 bytes as u1, resizable).
    """

    path: str
    source: str
    dtype: str
    units: str
    long_name: str


@dataclass(frozen=True, slots=True)
class Group:
    path: str
    nx_class: str
    note: str


GROUPS = (
    Group("/entry", "NXentry", "the run"),
    Group("/entry/user", "NXuser", "who ran it"),
    Group("/entry/sample", "NXsample", "the work"),
    Group("/entry/tool", "NXcollection", "the tool electrode"),
    Group("/entry/profile", "NXcollection", "the recipe, verbatim and after overrides"),
    Group(
        "/entry/profile/values",
        "NXcollection",
        "each value in effect, also of `[sim]`: attribute `key`, unit `key_units`",
    ),
    Group("/entry/machine", "NXinstrument", "machine and controller"),
    Group("/entry/software", "NXprocess", "what wrote the file"),
    Group("/entry/pulses", "NXcollection", "discharge pulses"),
    Group("/entry/data", "NXdata", "default plot: hard links to columns of `/entry/servo`"),
)

_OF_THE_END_AND_THE_WRITER = (
    Scalar("/entry/end_time", "", "S40", TEXT, "end, ISO 8601; empty while running"),
    Scalar("/entry/status", "", "S32", TEXT, "`running` until the end"),
    Scalar("/entry/exit_code", "", "i4", PURE, "exit code; −1 while running"),
    Scalar("/entry/recovery", "", "S160", TEXT, "what the file was recovered from, and when; empty without"),
    Scalar("/entry/summary", "", "json", TEXT, "the result, one JSON object as UTF-8 bytes"),
    Scalar("/entry/tool/length_wear_total", "", "f8", "um", "length lost in this run, all sites"),
    Scalar("/entry/profile/sha256", "", "text", TEXT, "SHA-256 of the text in `toml`"),
    Scalar("/entry/profile/parents", "", "texts", TEXT, "files it extends, verbatim, nearest first"),
    Scalar("/entry/profile/parent_paths", "", "texts", TEXT, "where those were found"),
    Scalar("/entry/software/program", "", "text", TEXT, "program"),
    Scalar("/entry/software/python", "", "text", TEXT, "version of Python"),
    Scalar("/entry/software/h5py", "", "text", TEXT, "version of h5py"),
    Scalar("/entry/software/hdf5", "", "text", TEXT, "version of HDF5"),
)


def _scalars() -> tuple[Scalar, ...]:
    """Return every single value, in the order of the groups."""
    declared = [(one.name, one.metadata["scalar"]) for one in fields(RunMeta) if "scalar" in one.metadata]
    of_meta = [Scalar(path, name, dtype, units, title) for name, (path, dtype, units, title) in declared]
    order = [group.path for group in GROUPS]
    every = (*of_meta, *_OF_THE_END_AND_THE_WRITER)
    return tuple(sorted(every, key=lambda one: order.index(one.path.rpartition("/")[0])))


SCALARS = _scalars()


def _columns_of(kind: type) -> tuple[Column, ...]:
    return tuple(
        Column(one.name, one.source, one.quantity.dtype, one.quantity.units, one.quantity.title)
        for one in stored_columns(kind)
    )


SERVO = Table(
    "/entry/servo", "NXdata", 4096, "gap servo, at the telemetry rate", _columns_of(ServoBlock),
    signal="v_gap_avg", in_blocks=True,
)  # fmt: skip
SLOW = Table(
    "/entry/slow", "NXdata", 1024, "the supervisor's view, 10 Hz on a live line, 2 Hz where time is virtual",
    _columns_of(SlowRow), signal="est_depth", auxiliary=("est_wear",),
)  # fmt: skip
PULSE_BLOCKS = Table(
    "/entry/pulses/blocks", "NXdata", 4096,
    "sums over consecutive pulses; `time` is the first pulse of a block",
    _columns_of(PulseBlockBatch), signal="n_normal", auxiliary=("n_open", "n_arc", "n_short"), in_blocks=True,
)  # fmt: skip
PULSES = Table(
    "/entry/pulses/full", "NXdata", 65536, "every pulse; its time follows from `/entry/pulses/segments`",
    (
        Column("pulse_class", "pulse_class", "u1", PURE, "0 open, 1 normal, 2 arc, 3 short"),
        Column("td", "delay_us", "u2", "0.1 us", "ignition delay; the on-time when open", 0.1),
        Column("te", "discharge_us", "u2", "0.1 us", "discharge time; 0 when open", 0.1),
        Column("u", "plateau_v", "u1", "0.5 V", "plateau voltage; the open voltage when open", 0.5),
    ),
    signal="td", auxiliary=("te",), in_blocks=True,
)  # fmt: skip
SEGMENTS = Table(
    "/entry/pulses/segments", "NXcollection", 256,
    "runs of consecutive pulses: row first_row + i of `full` has time t0 + i × period",
    _columns_of(Segment),
)  # fmt: skip
EVENTS = Table(
    "/entry/events", "", 64, "states, jumps, faults, decisions",
    (
        Column("time", "time_s", "f8", "s", "time since start"),
        Column("seq", "seq", "u4", PURE, "running number"),
        Column("code", "code", "u2", PURE, "code"),
        Column("level", "level", "u1", PURE, "0 debug, 1 info, 2 warning, 3 error"),
        Column("message", "message", "S160", TEXT, "for people"),
        Column("args", "args", "S200", TEXT, "values, as a JSON object"),
    ),
)  # fmt: skip
TOUCHES = Table(
    "/entry/touches", "", 32, "readings of surface and bottom", _columns_of(TouchRow), at_once=True
)
RESULTS = Table("/entry/results", "", 32, "one row per site", _columns_of(SiteResult), at_once=True)
BLACK_BOX = Table(
    "/entry/black_box", "NXdata", 2048,
    "the last two seconds before a fault that the controller latched, every millisecond; empty without one",
    _columns_of(TelemetryBlock), signal="v_gap_avg", in_blocks=True, at_once=True,
)  # fmt: skip
WAVEFORMS = Table(
    "/entry/waveforms", "NXdata", 4096,
    "the gap about a fault that the controller latched, sample by sample: up to 64 pulses before and 16 periods "
    "after; empty without one, or where the controller keeps no waveforms",
    _columns_of(WaveformBatch), signal="v_gap", in_blocks=True, at_once=True,
)  # fmt: skip
LINK = Table(
    "/entry/link", "NXdata", 256,
    "the line between host and controller, every ten seconds; counts since it was opened",
    _columns_of(kinds.LinkRow), signal="rtt_p50", auxiliary=("rtt_p99",),
)  # fmt: skip

TABLE_OF: Mapping[type, Table] = {
    ServoBlock: SERVO,
    SlowRow: SLOW,
    PulseBlockBatch: PULSE_BLOCKS,
    PulseTrain: PULSES,
    Segment: SEGMENTS,
    EventRow: EVENTS,
    TouchRow: TOUCHES,
    SiteResult: RESULTS,
    TelemetryBlock: BLACK_BOX,
    WaveformBatch: WAVEFORMS,
    kinds.LinkRow: LINK,
}
"""The table that rows of a type go to."""
TABLES = tuple(TABLE_OF.values())

TRUTH = Table(
    "/entry/truth", "NXdata", 128,
    "the floor of a channel as the virtual machine knows it: centres of cells of the smallest rectangle with all "
    "that was cut; empty for holes, and for every other machine",
    (
        Column("depth", "depth_um", "f4", "um", "true depth below the face"),
        Column("y", "y_um", "f8", "um", "y of a row"),
        Column("x", "x_um", "f8", "um", "x of a column"),
    ),
    signal="depth",
)  # fmt: skip
"""A map: one dataset with two dimensions in square chunks, over an axis for rows and one for columns."""

DEFAULT_PLOT = "/entry/data"
DEFAULT_SIGNAL, DEFAULT_AXIS, DEFAULT_AUXILIARY = "z_sensor", "time", ("z_model",)


def is_urgent(row: Row) -> bool:
    """Whether a row is flushed as soon as it is handed over: what a killed process must not lose."""
    table = TABLE_OF.get(type(row))
    if table is None:
        return isinstance(row, kinds.RejectedTouch)
    return row.level >= EventLevel.WARNING if isinstance(row, EventRow) else table.at_once


UNKNOWN = {"f8": np.nan, "i4": NO_EXIT_CODE, "i8": NO_SEED, "u1": 0, "text": "", "texts": (), "json": b""}
"""Scalars without a value, by their type; texts of fixed length are empty."""
_TEXT = h5py.string_dtype()
_TEXT_TYPE, _TEXT_IN_MEMORY = h5t.py_create(_TEXT, logical=True), h5t.py_create(_TEXT)
_UNLIMITED = h5s.UNLIMITED


@dataclass(frozen=True, slots=True)
class Content:
    """Content of a new run file, without its rows.

    values : scalars by their paths, and arrays of the true floor, as far as they are known
    profile : values of the profile and their units by dotted keys
    rows : of each table; None for a file that grows
    """

    values: dict[str, Any]
    profile: Mapping[str, kinds.Leaf]
    rows: Mapping[str, int] | None = None


def initial_content(meta: RunMeta) -> Content:
    """Return the content of a run that has not begun."""
    values = {scalar.path: getattr(meta, scalar.source) for scalar in SCALARS if scalar.source}
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
        if not isinstance(value, bool | str) and (unit := kinds.unit_of(key)) != PURE:
            profile[f"{key}_units"] = unit
    return Content(values, profile)


def build_tree(file: h5py.File, content: Content) -> None:
    """Create every object of a run file, with the values of the scalars and the true floor, but without rows."""
    start_time = content.values["/entry/start_time"]
    attributes = {
        "NX_class": "NXroot",
        "default": "entry",
        "creator": "edmctl",
        "edmctl_version": content.values["/entry/software/version"],
        "file_time": start_time,
        "schema": SCHEMA,
    }
    _put_attributes(file.id, attributes)
    for group in GROUPS:
        _put_attributes(h5g.create(file.id, group.path.encode()), {"NX_class": group.nx_class})
    _put_attributes(file["/entry"].id, {"default": DEFAULT_PLOT.rpartition("/")[2]})
    _put_attributes(file["/entry/profile/values"].id, content.profile)
    for scalar in SCALARS:
        _create_scalar(file, scalar, content.values.get(scalar.path), grows=content.rows is None)
    for table in TABLES:
        rows = None if content.rows is None else content.rows[table.path]
        if table.is_compound:
            dataset = _create_rows(file.id, table.path, table.row_type, table.chunk_rows, rows)
            texts = {name: [getattr(one, name) for one in table.columns] for name in ("units", "long_name")}
            _put_attributes(dataset, texts)
        else:
            _create_columns(file, table, rows, start_time)
    _create_truth(file, content.values)
    plot, servo = file[DEFAULT_PLOT].id, file[SERVO.path].id
    for name in (DEFAULT_AXIS, DEFAULT_SIGNAL, *DEFAULT_AUXILIARY):
        plot.links.create_hard(name.encode(), servo, name.encode())
    _make_plottable(plot, DEFAULT_SIGNAL, DEFAULT_AXIS, DEFAULT_AUXILIARY)


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
    elif scalar.dtype in ("text", "texts"):
        # Texts of variable length would lie in HDF5's global heap, which has no check sums.
        utf8 = [text.encode() for text in ([value] if scalar.dtype == "text" else value)]
        texts = np.array(utf8, h5py.string_dtype("utf-8", max([1, *map(len, utf8)])))
        dataset = _create_array(file.id, scalar.path, texts.reshape(()) if scalar.dtype == "text" else texts)
    else:
        dataset = _create_array(file.id, scalar.path, np.array(value, stored_type(scalar.dtype)))
    _describe(dataset, scalar)


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


def _create_truth(file: h5py.File, values: Mapping[str, Any]) -> None:
    """Create the map of a channel's floor and its axes: with their arrays if they are known, else growing."""
    group = h5g.create(file.id, TRUTH.path.encode())
    made: list[h5d.DatasetID] = []
    for column, dimensions in zip(TRUTH.columns, (2, 1, 1), strict=True):
        array = values.get(f"{TRUTH.path}/{column.name}")
        if array is not None:
            dataset = _create_array(group, column.name, np.array(array, column.dtype))
        else:
            chunked = h5p.create(h5p.DATASET_CREATE)
            chunked.set_chunk((TRUTH.chunk_rows,) * dimensions)
            empty = h5s.create_simple((0,) * dimensions, (_UNLIMITED,) * dimensions)
            kind = _type_of(np.dtype(column.dtype))
            dataset = h5d.create(group, column.name.encode(), kind, empty, chunked)
        _describe(dataset, column)
        made.append(dataset)
    signal, *axes = made
    names = [column.name for column in TRUTH.columns[1:]]
    for dimension, (axis, name) in enumerate(zip(axes, names, strict=True)):
        h5ds.set_scale(axis, name.encode())
        h5ds.attach_scale(signal, axis, dimension)
    _put_attributes(group, {"NX_class": "NXdata", "axes": names, "signal": TRUTH.signal})


def _make_plottable(group: h5g.GroupID, signal: str, axis: str, auxiliary: Sequence[str]) -> None:
    """Name what viewers plot in an NXdata; without an axis, against the number of the row."""
    lists = {"axes": [axis] if axis else [], "auxiliary_signals": list(auxiliary)}
    _put_attributes(group, {"signal": signal, **{name: value for name, value in lists.items() if value}})


def _create_rows(
    parent: h5g.GroupID, name: str, dtype: np.dtype[Any], chunk_rows: int, rows: int | None = None
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
    dataset = h5d.create(parent, name.encode(), _type_of(values.dtype), _space_of(values))
    if values.size:
        dataset.write(h5s.ALL, h5s.ALL, values)
    return dataset


@cache
def _type_of(dtype: np.dtype[Any]) -> h5t.TypeID:
    return h5t.py_create(dtype, logical=True)


def _space_of(values: NDArray[np.generic]) -> h5s.SpaceID:
    return h5s.create_simple(values.shape) if values.shape else h5s.create(h5s.SCALAR)


def _describe(dataset: h5d.DatasetID, item: Scalar | Column) -> None:
    _put_attributes(dataset, {"units": item.units, "long_name": item.long_name})


def _put_attributes(
    target: h5g.GroupID | h5d.DatasetID, attributes: Mapping[str, str | Sequence[str] | float | bool]
) -> None:
    """Write numbers, and texts of variable length: those of fixed length would be read as bytes by h5py and silx."""
    for name, value in attributes.items():
        is_number = isinstance(value, int | float)
        values = np.array(value) if is_number else np.array(value, _TEXT)
        kind = _type_of(values.dtype) if is_number else _TEXT_TYPE
        attribute = h5a.create(target, name.encode(), kind, _space_of(values))
        attribute.write(values, kind if is_number else _TEXT_IN_MEMORY)
