"""Reads a run file: finished, still being written, or left behind by a killed process."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from h5py import h5d, h5s
from numpy.typing import NDArray

from edmctl import failures
from edmctl.errors import EdmError, RunFileError
from edmctl.record import layout
from edmctl.record.compaction import CLOSING
from edmctl.record.disk import PARTIAL, partial_path
from edmctl.record.integrity import is_whole
from edmctl.record.layout import Column, Table
from edmctl.record.locks import interrupted, is_live
from edmctl.record.opening import damaged, open_file, refuse_endless
from edmctl.record.rows import TruthMap

TABLES = {table.path: table for table in layout.TABLES}
_WORD = h5py.string_dtype("utf-8", 16)
"""No word of a table is longer."""
BLOCK_ROWS = 1 << 18
"""Rows that are read at a time where a whole column would not fit into memory."""


class RunFile:
    """An open run file. Use it as a context manager.

    Values come in the unit without a step: a column in `0.1 us` is read in µs. Tables that older files do not have
    read as empty ones.
    """

    def __init__(self, file: h5py.File, path: Path) -> None:
        self._file = file
        self.path = path
        """Where the file is."""
        self._opened: dict[str, list[h5py.Dataset]] = {}
        self._checked: dict[str, h5py.Dataset] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        """Look at what a live writer has added since. Raises RunFileError E9015 once it is closed."""
        self._refuse_closed()
        for table in layout.TABLES:
            for dataset in self._datasets(table):
                dataset.refresh()
        for scalar in ("end_time", "status", "exit_code", "summary"):
            self._file[f"/entry/{scalar}"].refresh()

    def rows(self, path: str) -> int:
        """How many rows a table of the layout has, for instance `/entry/servo`.

        In a file without an end, columns may differ by the rows of the last write; the shortest counts.
        Raises RunFileError E9015 where the layout has no such table.
        """
        if path not in TABLES:
            raise _unknown(f"There is no table {path!r}", path, list(TABLES))
        return min((dataset.shape[0] for dataset in self._datasets(TABLES[path])), default=0)

    def column(self, path: str, name: str, start: int = 0, stop: int | None = None) -> NDArray[np.generic]:
        """Return rows `start` to `stop` of one column of a group, shape (n,). Raises RunFileError E9015."""
        self._refuse_closed()
        column = _column(path, name)
        if path not in self._file or name not in self._file[path]:
            return np.empty(0, _read_type(column))
        dataset = self._dataset(f"{path}/{name}")
        stop = self.rows(path) if stop is None else min(stop, self.rows(path))
        return self._plain(column, dataset, start, stop)

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
        """Return a compound table of the layout from row `start` on, for instance `/entry/touches`.

        Texts are UTF-8 bytes. Raises RunFileError E9015.
        """
        self._refuse_closed()
        if path not in self._file or not isinstance(self._file[path], h5py.Dataset):
            if path in TABLES and TABLES[path].nx_class:
                raise failures.not_a_table_of_rows(path=path)
            tables = [known for known in TABLES if isinstance(self._file.get(known), h5py.Dataset)]
            raise _unknown(f"There is no table {path!r}", path, tables)
        rows: NDArray[np.void] = self._dataset(path)[start:]
        return rows

    def fields(self, path: str, numbers: Sequence[str], words: Sequence[str] = ()) -> NDArray[np.void]:
        """Return some fields of a compound table: numbers, and words as bytes.

        A field that an older file does not have is 0, or empty.
        """
        dataset = self._dataset(path).id
        fields: NDArray[np.void] = np.zeros(
            dataset.shape, [*((name, "f8") for name in numbers), *((name, _WORD) for name in words)]
        )
        if fields.size:
            dataset.read(h5s.ALL, h5s.ALL, fields)
        return fields

    def text(self, path: str) -> str:
        """Return a text, for instance `/entry/status`; empty where an older file has none."""
        value = self._value(path)
        if value is not None and not isinstance(value, bytes):
            raise TypeError(f"{path} is no text")
        return (value or b"").decode()

    def texts(self, path: str) -> list[str]:
        """Return a list of texts, for instance `/entry/profile/parents`."""
        values: list[bytes] = list(self._dataset(path)[:])
        return [value.decode() for value in values]

    def number(self, path: str) -> float:
        """Return a number, for instance `/entry/exit_code`; NaN where an older file has none."""
        value = self._value(path)
        return math.nan if value is None else float(value)

    def profile_values(self) -> dict[str, float | int | str | bool]:
        """Return every profile value by its dotted key, and units by `key_units`."""
        attributes = self._file["/entry/profile/values"].attrs.items()
        return {
            key: v.item() if isinstance(v, np.generic) else v for key, v in attributes if key != "NX_class"
        }

    def profile_value(self, key: str) -> float | int | str | bool | None:
        """Return one profile value by its dotted key; None where the profile has none such."""
        value = self._file["/entry/profile/values"].attrs.get(key)
        plain: float | int | str | bool | None = value.item() if isinstance(value, np.generic) else value
        return plain

    def summary(self) -> dict[str, object] | None:
        """Return the result object; None when the run wrote none."""
        utf8 = self._dataset("/entry/summary")[:].tobytes()
        if not utf8:
            return None
        summary: dict[str, object] = json.loads(utf8)
        return summary

    def truth_map(self) -> TruthMap | None:
        """Return the true floor of a channel; None where the run has none, as on every real machine."""
        grid = layout.TRUTH
        if grid.path not in self._file:
            return None
        y_um, x_um = (self._dataset(f"{grid.path}/{axis.name}")[:] for axis in grid.axes)
        depth_um = self._dataset(f"{grid.path}/{grid.signal.name}")[:].astype(np.float64)
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

    def _value(self, path: str) -> Any:
        """A single value; None where an older file has none. Raises what h5py raises."""
        # Low-level calls take a quarter of the time: `run list` reads twenty values of every file.
        try:
            dataset = h5d.open(self._file.id, path.encode())
        except KeyError:
            if self._file.id.links.exists(path.encode()):
                raise
            return None
        refuse_endless(dataset)
        value = np.empty(dataset.shape, dataset.dtype)
        dataset.read(h5s.ALL, h5s.ALL, value)
        return value.item()

    def _datasets(self, table: Table) -> list[h5py.Dataset]:
        # To open nine of them for every part that is read would take longer than to read it.
        if table.path not in self._opened:
            self._opened[table.path] = self._datasets_of(table)
        return self._opened[table.path]

    def _dataset(self, path: str) -> h5py.Dataset:
        """Return a dataset. Raises KeyError if there is none, RunFileError E9007 if it is endless."""
        if path not in self._checked:
            dataset = self._file[path]
            try:
                refuse_endless(dataset.id)
            except ValueError as error:
                raise damaged(self.path, str(error)) from None
            self._checked[path] = dataset
        return self._checked[path]

    def _datasets_of(self, table: Table) -> list[h5py.Dataset]:
        if table.path not in self._file:
            return []
        if table.is_compound:
            return [self._dataset(table.path)]
        group = self._file[table.path]
        return [self._dataset(f"{table.path}/{c.name}") for c in table.columns if c.name in group]

    def _plain(self, column: Column, dataset: h5py.Dataset, start: int, stop: int) -> NDArray[np.generic]:
        stored: NDArray[Any] = dataset[start:stop]
        # A file of version 1 holds the plain values already.
        if column.step == 1.0 or stored.dtype != np.dtype(column.dtype):
            return stored
        plain: NDArray[np.generic] = np.multiply(stored, column.step, dtype="f8").astype(_read_type(column))
        return plain


def _read_type(column: Column) -> np.dtype[np.generic]:
    return np.dtype("f4") if column.step != 1.0 else np.dtype(column.dtype)


def open_run(path: Path) -> RunFile:
    """Open the run file at `path` for reading; nothing is ever written to it.

    Raises RunFileError: E9005 there is none or it is not a run file, E9006 a later version of edmctl wrote it,
    E9007 it is damaged.
    """
    return RunFile(open_file(path), path)


@contextmanager
def reading(path: Path) -> Iterator[RunFile]:
    """Open the run file at `path` for a `with` block that works on what is in it.

    A file without a fitting check sum may hold anything: texts that are none, rows of another form, places that lead
    nowhere. What that brings about in the block becomes RunFileError E9007; with a file that is whole it is a bug,
    and stays as it is. Raises RunFileError as `open_run`.
    """
    with _blamed(path), open_run(path) as run:
        yield run


@contextmanager
def reading_unverified(path: Path) -> Iterator[RunFile]:
    """Do as `reading`, without comparing the check sum first: that takes reading the whole file."""
    with _blamed(path), RunFile(open_file(path, verify=False), path) as run:
        yield run


@contextmanager
def _blamed(path: Path) -> Iterator[None]:
    try:
        yield
    except EdmError:
        raise
    except Exception as error:
        if is_whole(path):
            raise
        why = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise damaged(path, why.rstrip(".")) from error


LONGEST_CLOSING_LOOKS = 240
"""How often to look for the final name of a file that is being compressed."""


def present_name(path: Path) -> Path:
    """Return what a run file is called now: with `.partial` until it is finished, without after.

    The name is returned as it is where there is neither.
    """
    if path.exists():
        return path
    other = path.with_suffix("") if path.suffix == PARTIAL else partial_path(path)
    return other if other.exists() else path


def follow(path: Path, pause: Callable[[], None]) -> Iterator[RunFile]:
    """Yield the run file at `path`, again after each `pause`, with what its writer has added, until it has an end.

    The last one yielded has the end in it. A file that is finished is yielded once. Raises RunFileError: E9008 its
    writer died, else as `open_run`.
    """
    with reading(path) as run:
        while True:
            # Asked first: rows that were flushed between the two are seen, however the writer ended.
            lives = _lives(path)
            if not run.is_finished:
                run.refresh()
            yield run
            if run.is_finished or (not lives and not path.exists()):
                return
            if not lives:
                raise interrupted(path)
            pause()


def final_name(path: Path, pause: Callable[[], None]) -> Path:
    """Return the name that the run file at `path` has got at its end; wait while it is being compressed."""
    if path.suffix != PARTIAL:
        return path
    complete = path.with_suffix("")
    closing = complete.with_name(complete.name + CLOSING)
    for _ in range(LONGEST_CLOSING_LOOKS):
        if complete.exists() or not closing.exists():
            break
        pause()
    return complete if complete.exists() else path


def _lives(path: Path) -> bool:
    try:
        return is_live(path)
    except OSError:
        return False


def _column(path: str, name: str) -> Column:
    """The column of a group that a layout knows."""
    table = TABLES.get(path)
    if table is None or not table.nx_class:
        groups = [known for known, one in TABLES.items() if one.nx_class]
        raise _unknown(f"There are no columns under {path!r}", path, groups)
    found = next((column for column in table.columns if column.name == name), None)
    if found is None:
        raise _unknown(f"{path} has no column {name!r}", name, [column.name for column in table.columns])
    return found


def _unknown(message: str, name: str, known: Sequence[str]) -> RunFileError:
    close = difflib.get_close_matches(name, known, n=1)
    meant = f"Did you mean {close[0]}? " if close else ""
    return failures.nothing_of_that_name(message=message, meant=meant, known=", ".join(known))
