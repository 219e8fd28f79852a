"""Reads a run file: finished, still being written, or left behind by a killed process."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Self

import h5py
import numpy as np

from edmctl.errors import RunFileError

from . import layout

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

TABLES = {table.path: table for table in layout.TABLES}


class RunFile:
    """An open run file. Use it as a context manager."""

    def __init__(self, file: h5py.File) -> None:
        self._file = file

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def is_finished(self) -> bool:
        """Whether its writer came to the end; False for a live or killed run."""
        return self.text("/entry/end_time") != ""

    def columns(self, path: str) -> dict[str, NDArray[np.generic]]:
        """Return the columns of a group of the layout, for instance `/entry/servo`, all of one length.

        In a file without an end, columns may differ by the rows of the last write; the shortest counts.
        """
        group = self._file[path]
        names = [column.name for column in TABLES[path].columns]
        rows = min(group[name].shape[0] for name in names)
        return {name: group[name][:rows] for name in names}

    def table(self, path: str) -> NDArray[np.void]:
        """Return a compound table of the layout, for instance `/entry/touches`. Texts are UTF-8 bytes."""
        rows: NDArray[np.void] = self._file[path][:]
        return rows

    def text(self, path: str) -> str:
        """Return a text, for instance `/entry/status`."""
        value: bytes = self._file[path][()]
        return value.decode()

    def texts(self, path: str) -> list[str]:
        """Return a list of texts, for instance `/entry/profile/parents`."""
        values: list[bytes] = list(self._file[path][:])
        return [value.decode() for value in values]

    def number(self, path: str) -> float:
        """Return a number, for instance `/entry/exit_code`."""
        return float(self._file[path][()])

    def profile_values(self) -> dict[str, float | int | str | bool]:
        """Return every profile value by its dotted key, and units by `key_units`."""
        attributes = self._file["/entry/profile/values"].attrs
        return {key: v.item() if isinstance(v, np.generic) else v for key, v in attributes.items()}

    def summary(self) -> dict[str, object] | None:
        """Return the result object; None when the run wrote none."""
        utf8 = self._file["/entry/summary"][:].tobytes()
        if not utf8:
            return None
        summary: dict[str, object] = json.loads(utf8)
        return summary

    def pulse_times_s(self) -> NDArray[np.float64]:
        """Return the time of every pulse in `/entry/pulses/full`, shape (n,)."""
        rows = len(self.columns(layout.PULSES.path)["pulse_class"])
        segments = self.columns(layout.SEGMENTS.path)
        first_rows = segments["first_row"].astype(np.int64)
        start_s, period_s = segments["t0"].astype(np.float64), segments["period"].astype(np.float64)
        row = np.arange(rows)
        segment = np.searchsorted(first_rows, row, side="right") - 1
        times: NDArray[np.float64] = start_s[segment] + (row - first_rows[segment]) * period_s[segment]
        return times


def open_run(path: Path) -> RunFile:
    """Open the run file at `path` for reading.

    Raises RunFileError E9005 when there is none or it is not a run file.
    """
    try:
        file = _open(path)
    except FileNotFoundError as error:
        raise RunFileError(f"There is no run file {path}.", code="E9005", hint=_nearest(path)) from error
    except OSError as error:
        raise RunFileError(
            f"{path} cannot be read as HDF5: {str(error).splitlines()[0]}.",
            code="E9005",
            hint="Give a file that a run has written (.h5 or .h5.partial).",
        ) from error
    if file.attrs.get("schema") != layout.SCHEMA:
        found = file.attrs.get("schema", "none")
        file.close()
        raise RunFileError(
            f"{path} is not a run file of schema {layout.SCHEMA} (found: {found}).",
            code="E9005",
            hint="Give a file that this version of edmctl has written.",
        )
    return RunFile(file)


def _open(path: Path) -> h5py.File:
    try:
        return h5py.File(path, "r")
    except FileNotFoundError:
        raise
    except OSError:
        # A live or killed writer leaves the file marked as open; SWMR readers are made for that.
        return h5py.File(path, "r", swmr=True)


def _nearest(path: Path) -> str:
    for folder in (path.parent, path.parent / "runs"):
        for ending in (".partial", ".h5.partial"):
            partial = folder / f"{path.name}{ending}"
            if partial.exists():
                return f"The run was not finished; its rows are in {partial}."
        finished = folder / f"{path.name}.h5"
        if finished.exists():
            return f"Did you mean {finished}?"
    return "Check the path."
