"""Reads a run file and its events: finished, still being written, or of a killed process."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import Self

import h5py
import numpy as np
from h5py import h5s
from numpy.typing import NDArray

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError, RunFileError
from edmctl.record import layout
from edmctl.record.disk import PARTIAL, partial_path
from edmctl.record.layout import Column, Table
from edmctl.record.locks import is_live
from edmctl.record.opening import is_whole, open_file, plain, read_value, refuse_endless
from edmctl.record.recovery import CLOSING
from edmctl.record.rows import RunEvent, TruthMap
from edmctl.wording import did_you_mean

TABLES = {table.path: table for table in layout.TABLES}
_WORD = h5py.string_dtype("utf-8", 128)
"""No text of the table of results is longer."""
BLOCK_ROWS = 1 << 18
"""Rows that are read at a time where a whole column would not fit into memory."""


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
