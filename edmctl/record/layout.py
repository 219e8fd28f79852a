"""The run file's layout: every group, dataset, unit and type, in one place.

NeXus classes and attributes (`default`, `signal`, `axes`, `auxiliary_signals`, `units`, `long_name`) let
generic viewers plot at once; HDF5 dimension scales let xarray find the time axis. Signals are columns, one
dataset each, and their group is an NXdata that plots by itself; only what is not plotted (events, touches, results)
is a compound table.

Full pulses are stored as the line carries them, in steps that their unit names (`0.1 us`): 6 bytes a pulse, of which
compression leaves 3. Everything else is in its plain unit.
"""

from __future__ import annotations

from collections.abc import Mapping

from edmctl.dataclasses import dataclass, fields
from edmctl.record.rows import (
    EventLevel,
    EventRow,
    LinkRow,
    RejectedTouch,
    Row,
    RunMeta,
    ServoBlock,
    SlowRow,
    TouchRow,
)
from edmctl.results.declared import PURE, TEXT, stored_columns
from edmctl.results.job import SiteResult
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain, TelemetryBlock, WaveformBatch

SCHEMA = "edmctl-run/2"


@dataclass(frozen=True, slots=True)
class Column:
    """One dataset of a columnar group, or one field of a compound table."""

    name: str
    field: str
    """Name of the value in the row or block that is handed over, with dots where it lies deeper."""
    dtype: str
    units: str
    long_name: str
    step: float = 1.0
    """What is stored is the value over this step, rounded; `units` then names both, for instance `0.1 us`."""


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of one length: a group of datasets, or one compound dataset."""

    path: str
    nx_class: str
    """Class of the group; empty for a compound dataset."""
    chunk_rows: int
    note: str
    columns: tuple[Column, ...]
    signal: str = ""
    """Column of an NXdata that viewers plot."""
    auxiliary: tuple[str, ...] = ()
    """Columns that they plot beside it: all in its unit, because a viewer has one ordinate."""
    in_blocks: bool = False
    """Rows are handed over as arrays, one for each column."""
    at_once: bool = False
    """Rows are flushed as soon as they are handed over."""

    @property
    def is_compound(self) -> bool:
        return not self.nx_class

    @property
    def datasets(self) -> tuple[str, ...]:
        """Their paths: of each column, or of the compound one."""
        return (self.path,) if self.is_compound else tuple(f"{self.path}/{one.name}" for one in self.columns)

    @property
    def axis(self) -> str:
        """Column that the others are plotted against; empty where only their number is left."""
        return "time" if self.columns[0].name == "time" else ""


@dataclass(frozen=True, slots=True)
class Grid:
    """A map: an NXdata of one dataset with two dimensions, over an axis for each, in square chunks."""

    path: str
    chunk: int
    note: str
    signal: Column
    axes: tuple[Column, Column]
    """Of the rows, and of the columns."""


@dataclass(frozen=True, slots=True)
class Scalar:
    """One value. `source` is the RunMeta field it comes from; empty when it is written at the end."""

    path: str
    source: str
    dtype: str
    """A numpy type, `text` (UTF-8, as long as the text is), `texts` (a list of them, as long as the longest), or
    `json` (UTF-8 bytes as u1, resizable)."""
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


_AT_THE_END = (
    Scalar("/entry/end_time", "", "S40", TEXT, "end, ISO 8601; empty while running"),
    Scalar("/entry/status", "", "S32", TEXT, "`running` until the end"),
    Scalar("/entry/exit_code", "", "i4", PURE, "exit code; −1 while running"),
    Scalar("/entry/recovery", "", "S160", TEXT, "what the file was recovered from, and when; empty without"),
    Scalar("/entry/summary", "", "json", TEXT, "the result, one JSON object as UTF-8 bytes"),
    Scalar("/entry/tool/length_wear_total", "", "f8", "um", "length lost in this run, all sites"),
)
_OF_THE_WRITER = (
    Scalar("/entry/profile/sha256", "", "text", TEXT, "SHA-256 of the text in `toml`"),
    Scalar("/entry/profile/parents", "", "texts", TEXT, "files it extends, verbatim, nearest first"),
    Scalar("/entry/profile/parent_paths", "", "texts", TEXT, "where those were found"),
    Scalar("/entry/software/program", "", "text", TEXT, "program"),
    Scalar("/entry/software/python", "", "text", TEXT, "version of Python"),
    Scalar("/entry/software/h5py", "", "text", TEXT, "version of h5py"),
    Scalar("/entry/software/hdf5", "", "text", TEXT, "version of HDF5"),
)


def _scalars() -> tuple[Scalar, ...]:
    """Every single value, in the order of the groups."""
    declared = [(one.name, one.metadata["scalar"]) for one in fields(RunMeta) if "scalar" in one.metadata]
    known = [Scalar(path, name, dtype, units, title) for name, (path, dtype, units, title) in declared]
    groups = [group.path for group in GROUPS]
    found = (*known, *_OF_THE_WRITER, *_AT_THE_END)
    return tuple(sorted(found, key=lambda one: groups.index(one.path.rpartition("/")[0])))


SCALARS = _scalars()


def _columns_of(kind: type) -> tuple[Column, ...]:
    return tuple(
        Column(one.name, one.source, one.quantity.dtype, one.quantity.units, one.quantity.title)
        for one in stored_columns(kind)
    )


SERVO = Table(
    "/entry/servo",
    "NXdata",
    4096,
    "gap servo, at the telemetry rate",
    _columns_of(ServoBlock),
    signal="v_gap_avg",
    in_blocks=True,
)

SLOW = Table(
    "/entry/slow",
    "NXdata",
    1024,
    "the supervisor's view, 10 Hz on a live line, 2 Hz where time is virtual",
    _columns_of(SlowRow),
    signal="est_depth",
    auxiliary=("est_wear",),
)

PULSE_BLOCKS = Table(
    "/entry/pulses/blocks",
    "NXdata",
    4096,
    "sums over consecutive pulses; `time` is the first pulse of a block",
    _columns_of(PulseBlockBatch),
    signal="n_normal",
    auxiliary=("n_open", "n_arc", "n_short"),
    in_blocks=True,
)

PULSES = Table(
    "/entry/pulses/full",
    "NXdata",
    65536,
    "every pulse; its time follows from `/entry/pulses/segments`",
    (
        Column("pulse_class", "pulse_class", "u1", PURE, "0 open, 1 normal, 2 arc, 3 short"),
        Column("td", "delay_us", "u2", "0.1 us", "ignition delay; the on-time when open", 0.1),
        Column("te", "discharge_us", "u2", "0.1 us", "discharge time; 0 when open", 0.1),
        Column("u", "plateau_v", "u1", "0.5 V", "plateau voltage; the open voltage when open", 0.5),
    ),
    signal="td",
    auxiliary=("te",),
    in_blocks=True,
)

SEGMENTS = Table(
    "/entry/pulses/segments",
    "NXcollection",
    256,
    "runs of consecutive pulses: row first_row + i of `full` has time t0 + i × period",
    (
        Column("first_row", "first_row", "u8", PURE, "first row in `/entry/pulses/full`"),
        Column("first_pulse", "first_pulse", "u8", PURE, "number of that pulse since the controller started"),
        Column("t0", "start_s", "f8", "s", "time of that pulse since start"),
        Column("period", "period_s", "f8", "s", "pulse period"),
    ),
)

EVENTS = Table(
    "/entry/events",
    "",
    64,
    "states, jumps, faults, decisions",
    (
        Column("time", "time_s", "f8", "s", "time since start"),
        Column("seq", "seq", "u4", PURE, "running number"),
        Column("code", "code", "u2", PURE, "code"),
        Column("level", "level", "u1", PURE, "0 debug, 1 info, 2 warning, 3 error"),
        Column("message", "message", "S160", TEXT, "for people"),
        Column("args", "args", "S200", TEXT, "values, as a JSON object"),
    ),
)

TOUCHES = Table(
    "/entry/touches",
    "",
    32,
    "readings of surface and bottom",
    _columns_of(TouchRow),
    at_once=True,
)

RESULTS = Table(
    "/entry/results",
    "",
    32,
    "one row per site",
    _columns_of(SiteResult),
    at_once=True,
)

BLACK_BOX = Table(
    "/entry/black_box",
    "NXdata",
    2048,
    "the last two seconds before a fault that the controller latched, every millisecond; empty without one",
    _columns_of(TelemetryBlock),
    signal="v_gap_avg",
    in_blocks=True,
    at_once=True,
)

WAVEFORMS = Table(
    "/entry/waveforms",
    "NXdata",
    4096,
    "the gap about a fault that the controller latched, sample by sample: up to 64 pulses before and 16 periods "
    "after; empty without one, or where the controller keeps no waveforms",
    _columns_of(WaveformBatch),
    signal="v_gap",
    in_blocks=True,
    at_once=True,
)

LINK = Table(
    "/entry/link",
    "NXdata",
    256,
    "the line between host and controller, every ten seconds; counts since it was opened",
    _columns_of(LinkRow),
    signal="rtt_p50",
    auxiliary=("rtt_p99",),
)

TABLES = (
    SERVO,
    SLOW,
    PULSE_BLOCKS,
    PULSES,
    SEGMENTS,
    EVENTS,
    TOUCHES,
    RESULTS,
    BLACK_BOX,
    WAVEFORMS,
    LINK,
)

TABLE_OF: Mapping[type, Table] = {
    ServoBlock: SERVO,
    SlowRow: SLOW,
    PulseBlockBatch: PULSE_BLOCKS,
    PulseTrain: PULSES,
    EventRow: EVENTS,
    TouchRow: TOUCHES,
    SiteResult: RESULTS,
    TelemetryBlock: BLACK_BOX,
    WaveformBatch: WAVEFORMS,
    LinkRow: LINK,
}
"""The table that rows of a type go to."""

TRUTH = Grid(
    "/entry/truth",
    128,
    "the floor of a channel as the virtual machine knows it: centres of cells of the smallest rectangle with all "
    "that was cut; empty for holes, and for every other machine",
    Column("depth", "depth_um", "f4", "um", "true depth below the face"),
    (Column("y", "y_um", "f8", "um", "y of a row"), Column("x", "x_um", "f8", "um", "x of a column")),
)

GRIDS = (TRUTH,)

DEFAULT_PLOT = "/entry/data"
DEFAULT_SIGNAL = "z_sensor"
DEFAULT_AXIS = "time"
DEFAULT_AUXILIARY = ("z_model",)


def is_urgent(row: Row) -> bool:
    """Whether a row is flushed as soon as it is handed over: what a killed process must not lose."""
    table = TABLE_OF.get(type(row))
    if table is None:
        return isinstance(row, RejectedTouch)
    return row.level >= EventLevel.WARNING if isinstance(row, EventRow) else table.at_once
