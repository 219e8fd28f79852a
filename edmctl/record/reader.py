"""Reads a run file: its tables, events and results, the estimate of a hole without one; an overview of a folder."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from enum import IntEnum
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from h5py import h5s
from numpy.typing import NDArray

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError, RunFileError
from edmctl.labels import Basis, weakest, worst
from edmctl.record import layout
from edmctl.record.disk import PARTIAL, is_live, partial_path
from edmctl.record.json_rows import record_of
from edmctl.record.layout import NO_EXIT_CODE, RESULTS, SLOW, TOUCHES, Column, Table
from edmctl.record.opening import is_whole, open_file, plain, read_value, refuse_endless
from edmctl.record.recovery import CLOSING
from edmctl.record.rows import RunEvent, TruthMap
from edmctl.results.declared import ONLY_JSON, quantities
from edmctl.results.job import SiteResult, SiteTruth
from edmctl.results.run_file import RecordedSite, RunHead, Sites, Unreadable
from edmctl.results.telemetry import PulseShares
from edmctl.wording import did_you_mean, plain_number

TABLES = {table.path: table for table in layout.TABLES}
_WORD = h5py.string_dtype("utf-8", 128)
"""No text of the table of results is longer."""
BLOCK_ROWS = 1 << 18
"""Rows that are read at a time where a whole column would not fit into memory."""

ENDINGS = (".h5", f".h5{PARTIAL}")
RUNNING, INTERRUPTED = "running", "interrupted"
DEPTH_EVENTS = (
    RunEvent.SITE_MEASURED,
    RunEvent.SITE_ESTIMATED,
    RunEvent.CHANNEL_MEASURED,
    RunEvent.LEFT_UNMEASURED,
)
"""Events with the depth of a hole or channel; that of one left unmeasured counts if it has an interval."""
_ONLY_JSON = [name for name, one in quantities(SiteResult).items() if one.group == ONLY_JSON]
_UNKNOWN: dict[str, Any] = {"f": math.nan, "u": 0, "S": ""}
"""Values of columns that the file does not have, by type: columns are added without a new version of the layout."""
_LAST_ROWS = 100
"""An estimate is searched in so many last rows of the supervisor: the very last may have none."""
_LENGTHS = ("depth", "depth_u95", "wear", "wear_u95")
_TEXTS = ("run_id", "parent_run", "title", "start_time", "end_time")
_WORDS = ("depth_basis", "wear_basis", "verdict")


class RunFile:
    """An open run file, a context manager. Values are without a step: a column in `0.1 us` is read in µs."""

    def __init__(self, file: h5py.File, path: Path) -> None:
        self._file = file
        self.path = path
        self._opened: dict[str, list[h5py.Dataset]] = {}
        self._checked: dict[str, h5py.Dataset] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        if not self._file:
            return f"<RunFile {self.path}, closed>"
        status = self.text("/entry/status") if self.is_finished else "not finished"
        return f"<RunFile {self.path}: {self.text('/entry/title')}, {status}>"

    def close(self) -> None:
        self._file.close()

    def _refuse_closed(self) -> None:
        if not self._file:
            raise failures.run_file_closed(path=self.path)

    @property
    def is_finished(self) -> bool:
        """Whether its writer came to the end, or it was recovered; False for a live or killed run."""
        return self.text("/entry/end_time") != ""

    @property
    def is_simulated(self) -> bool:
        """Whether the virtual machine made the run."""
        return self.number("/entry/simulated") == 1.0

    @property
    def seed(self) -> int | None:
        """The seed of the virtual machine; None on a real one, and where another process served it."""
        seed = int(self.number("/entry/seed"))
        return seed if seed >= 0 else None

    def refresh(self) -> None:
        """Read what a live writer has added since. Raises RunFileError E9015 once it is closed."""
        self._refuse_closed()
        for table in layout.TABLES:
            for dataset in self._datasets(table):
                dataset.refresh()
        for scalar in ("end_time", "status", "exit_code", "summary"):
            self._file[f"/entry/{scalar}"].refresh()

    def rows(self, path: str) -> int:
        """Return the rows of a table, in a file without an end of its shortest column. Raises RunFileError E9015."""
        if path not in TABLES:
            raise _unknown(f"There is no table {path!r}", path, list(TABLES))
        return min((dataset.shape[0] for dataset in self._datasets(TABLES[path])), default=0)

    def column(self, path: str, name: str, start: int = 0, stop: int | None = None) -> NDArray[np.generic]:
        """Return rows `start` to `stop` of one column of a group, shape (n,). Raises RunFileError E9015."""
        self._refuse_closed()
        column = _column(path, name)
        if f"{path}/{name}" not in self._file:
            return np.empty(0, "f4" if column.step != 1.0 else column.dtype)
        stop = self.rows(path) if stop is None else min(stop, self.rows(path))
        stored: NDArray[np.generic] = self._dataset(f"{path}/{name}")[start:stop]
        return stored if column.step == 1.0 else np.multiply(stored, column.step, dtype="f8").astype("f4")

    def columns(self, path: str, names: Sequence[str] | None = None) -> dict[str, NDArray[np.generic]]:
        """Return columns of a group of the layout, all of one length; every column where none is named."""
        wanted = [column.name for column in TABLES[path].columns] if names is None else names
        return {name: self.column(path, name) for name in wanted}

    def blocks(
        self, path: str, names: Sequence[str], rows: int = BLOCK_ROWS
    ) -> Iterator[dict[str, NDArray[np.generic]]]:
        """Yield columns of a group, `rows` rows at a time: for files that do not fit into memory."""
        for start in range(0, self.rows(path), rows):
            yield {name: self.column(path, name, start, start + rows) for name in names}

    def table(self, path: str, start: int = 0) -> NDArray[np.void]:
        """Return a compound table from row `start` on, with texts as UTF-8 bytes. Raises RunFileError E9015."""
        self._refuse_closed()
        if path not in self._file or not isinstance(self._file[path], h5py.Dataset):
            if path in TABLES and TABLES[path].nx_class:
                raise failures.not_a_table_of_rows(path=path)
            tables = [known for known in TABLES if isinstance(self._file.get(known), h5py.Dataset)]
            raise _unknown(f"There is no table {path!r}", path, tables)
        rows: NDArray[np.void] = self._dataset(path)[start:]
        return rows

    def fields(self, path: str, numbers: Sequence[str], words: Sequence[str] = ()) -> NDArray[np.void]:
        """Return fields of a compound table: numbers, and words as bytes; 0 or empty if an older file lacks them."""
        dataset = self._dataset(path).id
        fields: NDArray[np.void] = np.zeros(
            dataset.shape, [*((name, "f8") for name in numbers), *((name, _WORD) for name in words)]
        )
        if fields.size:
            dataset.read(h5s.ALL, h5s.ALL, fields)
        return fields

    def text(self, path: str) -> str:
        """Return a text, for instance `/entry/status`; empty where an older file has none."""
        value = read_value(self._file, path)
        text = b"" if value is None else value.item()
        if not isinstance(text, bytes):
            raise TypeError(f"{path} is no text")
        return text.decode()

    def number(self, path: str) -> float:
        """Return a number, for instance `/entry/exit_code`; NaN where an older file has none."""
        value = read_value(self._file, path)
        return math.nan if value is None else float(value.item())

    def profile_values(self) -> dict[str, float | int | str | bool]:
        """Return every profile value by its dotted key, and units by `key_units`."""
        attributes = self._file["/entry/profile/values"].attrs.items()
        return {key: plain(value) for key, value in attributes if key != "NX_class"}

    def profile_value(self, key: str) -> float | int | str | bool | None:
        """Return one profile value by its dotted key; None if the profile does not have it."""
        value: float | int | str | bool | None = plain(self._file["/entry/profile/values"].attrs.get(key))
        return value

    def summary(self) -> dict[str, object] | None:
        """Return the result object; None when the run wrote none."""
        utf8 = self._dataset("/entry/summary")[:].tobytes()
        if not utf8:
            return None
        summary: dict[str, object] = json.loads(utf8)
        return summary

    def truth_map(self) -> TruthMap | None:
        """Return the true floor of a channel; None if the run has none, as on every real machine."""
        if layout.TRUTH.path not in self._file:
            return None
        depth_um, y_um, x_um = (self._dataset(path)[:] for path in layout.TRUTH.datasets)
        depth_um = depth_um.astype(np.float64)
        if min(depth_um.shape) < 2 or depth_um.shape != (len(y_um), len(x_um)):
            return None
        return TruthMap(x_um, y_um, depth_um)

    def pulse_times_s(self, start: int = 0, stop: int | None = None) -> NDArray[np.float64]:
        """Return the times of pulses `start` to `stop` of `/entry/pulses/full`, shape (n,)."""
        rows = self.rows(layout.PULSES.path)
        stop = rows if stop is None else min(stop, rows)
        segments = self.columns(layout.SEGMENTS.path)
        first_rows = segments["first_row"].astype(np.int64)
        start_s, period_s = segments["t0"].astype(np.float64), segments["period"].astype(np.float64)
        row = np.arange(start, stop)
        segment = np.searchsorted(first_rows, row, side="right") - 1
        times: NDArray[np.float64] = start_s[segment] + (row - first_rows[segment]) * period_s[segment]
        return times

    def _datasets(self, table: Table) -> list[h5py.Dataset]:
        # To open nine of them for every part that is read would take longer than to read it.
        if table.path not in self._opened:
            there = [path for path in table.datasets if path in self._file]
            self._opened[table.path] = [self._dataset(path) for path in there]
        return self._opened[table.path]

    def _dataset(self, path: str) -> h5py.Dataset:
        """Return a dataset. Raises KeyError if there is none, RunFileError E9007 if it is endless."""
        if path not in self._checked:
            dataset = self._file[path]
            try:
                refuse_endless(dataset.id)
            except ValueError as error:
                raise failures.run_file_damaged(path=self.path, why=str(error)) from None
            self._checked[path] = dataset
        return self._checked[path]


def open_run(path: Path) -> RunFile:
    """Open a run file for reading. Raises RunFileError: E9005 no run file, E9006 other version, E9007 damaged."""
    return RunFile(open_file(path), path)


@contextmanager
def reading(path: Path, *, verify: bool = True) -> Iterator[RunFile]:
    """Open a run file for a block. Exceptions in it become E9007, except of a whole file, where they are a bug."""
    try:
        with RunFile(open_file(path, verify=verify), path) as run:
            yield run
    except EdmError:
        raise
    except Exception as error:
        if is_whole(path):
            raise
        why = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise failures.run_file_damaged(path=path, why=why.rstrip(".")) from error


LONGEST_CLOSING_LOOKS = 240
"""How often to look for the final name of a file that is being compressed."""


def present_name(path: Path) -> Path:
    """Return the present name of a run file: with `.partial` until it is finished; as it is if there is neither."""
    if path.exists():
        return path
    other = path.with_suffix("") if path.suffix == PARTIAL else partial_path(path)
    return other if other.exists() else path


def follow(path: Path, pause: Callable[[], None]) -> Iterator[RunFile]:
    """Yield the run file after each `pause` until it has an end. Raises RunFileError E9008 if its writer died."""
    with reading(path) as run:
        while True:
            # Checked first: rows that were flushed between the two are seen, however the writer ended.
            lives = is_live(path)
            if not run.is_finished:
                run.refresh()
            yield run
            if run.is_finished or (not lives and not path.exists()):
                return
            if not lives:
                raise failures.run_file_without_end(path=path)
            pause()


def final_name(path: Path, pause: Callable[[], None]) -> Path:
    """Return the name of the run file at `path` after its end; wait while it is being compressed."""
    if path.suffix != PARTIAL:
        return path
    complete = path.with_suffix("")
    closing = complete.with_name(complete.name + CLOSING)
    for _ in range(LONGEST_CLOSING_LOOKS):
        if complete.exists() or not closing.exists():
            break
        pause()
    return complete if complete.exists() else path


def _column(path: str, name: str) -> Column:
    """Return the column of a group. Raises RunFileError E9015 if the layout does not have it."""
    groups = {known: one.columns for known, one in TABLES.items() if not one.is_compound}
    if path not in groups:
        raise _unknown(f"There are no columns under {path!r}", path, list(groups))
    columns = {column.name: column for column in groups[path]}
    if name not in columns:
        raise _unknown(f"{path} has no column {name!r}", name, list(columns))
    return columns[name]


def _unknown(message: str, name: str, known: Sequence[str]) -> RunFileError:
    return failures.nothing_of_that_name(
        problem=message, meant=did_you_mean(name, known), known=", ".join(known)
    )


class RecordedState(IntEnum):
    """States of the controller, by the names of the protocol."""

    BOOT = 0
    IDLE = 1
    ARMED = 2
    APPROACH = 3
    MACHINING = 4
    JUMP = 5
    TOUCH = 6
    MOVING = 7
    FAULT = 8
    ESTOP = 9


JUMP_DONE, TOUCH = 5, 6
"""Codes of two events of the controller; procedures use `RunEvent`."""


@dataclass(frozen=True, slots=True)
class RecordedEvent:
    time_s: float
    code: int
    level: int
    message: str
    values: Mapping[str, object]

    def number(self, name: str) -> float:
        """Return one of its numbers; NaN if it has none of that name."""
        value = self.values.get(name, math.nan)
        return float(value) if isinstance(value, int | float) else math.nan


def recorded_events(run: RunFile, *wanted: int, start: int = 0) -> list[RecordedEvent]:
    """Return the events of the `wanted` codes, or all, from row `start` on; without values that are damaged."""
    events = []
    for row in run.table(layout.EVENTS.path, start):
        if wanted and int(row["code"]) not in wanted:
            continue
        try:
            values = json.loads(row["args"])
        except ValueError:
            values = {}
        numbers = float(row["time"]), int(row["code"]), int(row["level"])
        message = row["message"].decode(errors="ignore")
        events.append(RecordedEvent(*numbers, message, values if isinstance(values, dict) else {}))
    return events


def error_code_of(run: RunFile) -> str:
    """Return the code of the error that ended a run early, or an empty text."""
    ends = recorded_events(run, RunEvent.ENDED_EARLY)
    return str(ends[-1].values.get("code", "")) if ends else ""


def sites_of(run: RunFile) -> Sites:
    """Return the results of a run: the row of each site in its table, and the rest from its summary."""
    summary = run.summary() or {}
    sites = summary.get("sites")
    places = [*(sites if isinstance(sites, list) else ()), summary.get("channel")]
    by_name = {str(place.get("name")): place for place in places if isinstance(place, Mapping)}
    thickness_um = run.number("/entry/sample/thickness")
    return Sites(_site(row, by_name, thickness_um) for row in run.table(RESULTS.path))


def _site(row: np.void, places: Mapping[str, Mapping[str, object]], thickness_um: float) -> RecordedSite:
    present = row.dtype.names or ()
    stored = {
        one.field: row[one.name].item() if one.name in present else _UNKNOWN[one.dtype[0]]
        for one in RESULTS.columns
    }
    values = {name: v.decode(errors="ignore") if isinstance(v, bytes) else v for name, v in stored.items()}
    place = places.get(str(values["name"]), {})
    truth = place.get("truth")
    known = {name: values[name] for name in quantities(SiteResult) if name in values}
    known |= {name: bool(values[name]) for name in ("through", "drift_by_rests")}
    known |= {name: values[name] or None for name in ("depth_basis", "verdict")}
    known |= {name: place[name] for name in _ONLY_JSON if name in place}
    known |= {
        "wear_basis": values["wear_basis"] or Basis.ESTIMATED,
        "ratios": {name: values[f"ratios.{name}"] for name in quantities(PulseShares)},
        "length_um": thickness_um if values["through"] else values["depth_um"],
        "truth": {name: v for name, v in truth.items() if name in quantities(SiteTruth)}
        if isinstance(truth, Mapping)
        else {},
    }
    return record_of(RecordedSite, known)


def has_sensor(run: RunFile) -> bool:
    """Return whether a displacement sensor took the readings; without one they are estimates from the voltage."""
    touches = run.table(TOUCHES.path)
    return not len(touches) or bool(np.isfinite(touches["z_sensor"]).any())


@dataclass(frozen=True, slots=True)
class Estimated:
    """Depth and half its 95 % interval, µm, NaN if unknown."""

    depth_um: float = math.nan
    depth_u95_um: float = math.nan


def estimated_depth(run: RunFile) -> Estimated:
    """Return the last estimate for a hole or channel that has no result, NaN if every one has."""
    if run.is_finished and int(run.number("/entry/exit_code")) == 0:
        return Estimated()
    stop = run.rows(SLOW.path)
    start = max(0, stop - _LAST_ROWS)
    columns = [run.column(SLOW.path, name, start, stop) for name in ("time", "est_depth", "est_depth_u95")]
    known = [row for row in zip(*columns, strict=False) if np.isfinite(row[1])]
    if not known:
        return Estimated()
    time_s, depth_um, u95_um = map(float, known[-1])
    if run.rows(RESULTS.path):
        # Depths that are, or may be, results.
        events = recorded_events(run, *DEPTH_EVENTS)
        if time_s <= max((event.time_s for event in events if has_depth(event)), default=math.inf):
            return Estimated()
    return Estimated(depth_um, u95_um)


def has_depth(event: RecordedEvent) -> bool:
    """Return whether an event of `DEPTH_EVENTS` has a depth."""
    return event.code != RunEvent.LEFT_UNMEASURED or math.isfinite(event.number("depth_u95_um"))


def heads_of(folder: Path) -> Iterator[RunHead | Unreadable]:
    """Read the heads of run files by name, except of recovered killed runs. Raises RunFileError E9005."""
    heads: list[RunHead | Unreadable] = []
    for path in run_files(folder):
        try:
            heads.append(read_head(path))
        except RunFileError as error:
            size_bytes, changed_s = 0, 0.0
            with suppress(OSError):
                size_bytes, changed_s = path.lstat().st_size, path.lstat().st_mtime
            heads.append(Unreadable(path, size_bytes, changed_s, error))
    complete = {(head.path.name, head.run_id) for head in heads if isinstance(head, RunHead)}
    for head in heads:
        is_recovered = (
            isinstance(head, RunHead)
            and head.path.suffix == PARTIAL
            and head.status != RUNNING
            and (head.path.stem, head.run_id) in complete
        )
        if not is_recovered:
            yield head


def run_files(folder: Path) -> list[Path]:
    """Return what is named like a run file in `folder`, by name. Raises RunFileError E9005."""
    try:
        return sorted(path for path in folder.iterdir() if path.name.endswith(ENDINGS))
    except OSError as error:
        raise failures.folder_unreadable(folder=folder, reason=error.strerror) from error


def read_head(path: Path) -> RunHead:
    """Read the head of a run file. Its check sum is not compared. Raises RunFileError E9005–E9007."""
    with reading(path, verify=False) as run:
        return _head(run)


def _head(run: RunFile) -> RunHead:
    exit_code = int(run.number("/entry/exit_code"))
    results = run.fields(RESULTS.path, (*_LENGTHS, "machining_time", "through"), ("site", *_WORDS))
    machining_time_s = float(np.sum(results["machining_time"])) if len(results) else math.nan
    if exit_code and len(results) > 1:
        # Means are of finished holes: a hole that was under way when the job ended may have a row.
        abandoned = [
            str(event.values.get("site", "")) for event in recorded_events(run, RunEvent.LEFT_UNMEASURED)
        ]
        if abandoned and abandoned[-1]:
            results = results[results["site"] != abandoned[-1].encode()]
    words = {name: [one.decode(errors="replace") for one in results[name]] for name in _WORDS}
    values: dict[str, Any] = {name: weakest(words[name]) for name in ("depth_basis", "wear_basis")}
    if len(results):
        of_lengths = dict.fromkeys(_LENGTHS[:2], results[results["through"] == 0])
        of_lengths |= dict.fromkeys(_LENGTHS[2:], results)
        values |= {f"{name}_um": _mean(rows[name]) for name, rows in of_lengths.items()}
    else:
        summary = run.summary() or {}
        values = {name: str(summary.get(name) or "") for name in values}
        values |= {f"{name}_um": plain_number(summary.get(f"{name}_um")) for name in _LENGTHS}
    estimated = estimated_depth(run)
    texts: dict[str, Any] = {name: run.text(f"/entry/{name}") for name in _TEXTS}
    return RunHead(
        path=run.path,
        size_bytes=run.path.stat().st_size,
        **texts,
        name=str(run.profile_value("meta.name") or run.path.stem),
        status=status_of(run),
        exit_code=None if exit_code == NO_EXIT_CODE else exit_code,
        error_code=error_code_of(run) if exit_code else "",
        simulated=run.is_simulated,
        seed=run.seed,
        work=run.text("/entry/sample/material"),
        tool=run.text("/entry/tool/material"),
        sites=len(results),
        through=int(np.sum(results["through"])),
        est_depth_um=estimated.depth_um,
        est_depth_u95_um=estimated.depth_u95_um,
        machining_time_s=machining_time_s,
        **values,
        verdict=worst(words["verdict"]),
    )


def status_of(run: RunFile) -> str:
    """Return how the run ended, `running` while its writer lives, or `interrupted` when that was killed."""
    if run.is_finished:
        return run.text("/entry/status")
    return RUNNING if is_live(run.path) else INTERRUPTED


def _mean(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if len(known) else math.nan
