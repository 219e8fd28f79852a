"""Measured records out of CSV and HDF5 files, and columns of numbers into them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from edmctl import failures
from edmctl.actuator.record import Record
from edmctl.array_types import Array
from edmctl.csv_text import row_lines, text_cell
from edmctl.errors import RunFileError
from edmctl.files import RECORD_BYTES, open_regular, read_bytes, refuse_locked
from edmctl.record import disk, layout
from edmctl.record.delimited import Table, find_columns, text_of
from edmctl.record.opening import MAGIC, image_of, open_hdf5, refuse_endless
from edmctl.record.reader import open_run
from edmctl.results.declared import PURE
from edmctl.wording import plural

TIME, VOLTAGE, DISPLACEMENT = "t_s", "u_V", "y_um"
STACK, TOOL = "x_um", "z_um"
MEANINGS = {
    TIME: "time in s",
    VOLTAGE: "actuator voltage in V",
    DISPLACEMENT: "tool displacement in µm",
    STACK: "stack displacement in µm",
    TOOL: "tool displacement in µm",
}
WANTED = (TIME, VOLTAGE, DISPLACEMENT)
HDF5_SUFFIXES = (".h5", ".hdf5", ".hdf", ".nxs")
RUN_COLUMNS = {TIME: "time", VOLTAGE: "v_cmd", DISPLACEMENT: "z_sensor"}
"""Columns of a run file that are those of a record."""
UNITS = {"s": "s", "V": "V", "um": "um", "A": "A", "Hz": "Hz"}
"""Units by the end of a column's name."""
_BEGIN_BYTES = 1 << 16
"""The attributes of the root, which say what wrote a file, lie within them."""


def read_record(path: Path, previous_v: float | None = None) -> Record:
    """Read a measured record: columns t_s, u_V and y_um of a CSV or HDF5 file, or the servo's of a run file.

    previous_v : voltage at which the actuator was held before the first sample, V; None: conditioned.

    A run file is known by its content, whatever its name, and a servo table that `edmctl run export` wrote by its
    columns. Other columns are ignored. The numbers are checked by `actuator.checks`.

    Raises RecordError: E3601 the file cannot be read, E3602 it is no table, E3603 its columns have other names,
    E3604 a row is no row of numbers (with its line), E3605 it has no rows, E3606 it is HDF5 without these columns.
    """
    t_s, u_v, y_um = read_columns(path, *WANTED)
    return Record(t_s, u_v, y_um, previous_v, path.name)


def read_columns(path: Path, *needed: str) -> tuple[Array, ...]:
    """Return columns of numbers of a CSV or HDF5 file (`MEANINGS`), shape (n,) each. Raises as `read_record`."""
    try:
        with open_regular(path) as file:
            begin = file.read(len(MAGIC))
        refuse_locked(path)
        content = begin if begin == MAGIC else read_bytes(path, RECORD_BYTES)
    except (OSError, ValueError) as error:
        why = "there is no such file" if isinstance(error, FileNotFoundError) else disk.reason(error)
        is_held = isinstance(error, BlockingIOError)
        hint = "Close it there, or give a copy." if is_held else "Check the path and its permissions."
        raise failures.record_file_unreadable(path=path, why=why, remedy=hint) from error
    if content == MAGIC:
        columns = _read_hdf5(path, needed)
    elif content and path.suffix.lower() in HDF5_SUFFIXES:
        raise failures.not_hdf5(path=path)
    else:
        columns = read_text(content, str(path), needed)
    if (rows := len(columns[needed[0]])) < 2:
        raise failures.record_without_rows(path=path, rows=plural(rows, "row"))
    return tuple(columns[name] for name in needed)


def read_text(content: bytes, name: str, needed: Sequence[str] = WANTED) -> dict[str, Array]:
    """Return the needed columns of a text file, shape (n,) each. Raises RecordError E3602, E3603 or E3604."""
    table = Table(text_of(content, name), name, needed)
    if missing := [one for one in needed if one not in table.columns]:
        raise table.without(missing, _hint(missing))
    return table.numbers()


def _hint(missing: Sequence[str]) -> str:
    named = ", ".join(f"{name} ({MEANINGS[name]})" for name in missing)
    return f"Needed: {named}. Other columns are ignored."


def _read_hdf5(path: Path, needed: Sequence[str]) -> dict[str, Array]:
    """Read a run file, or what another program or `write_columns` wrote: datasets at the root."""
    try:
        with open_run(path) as run:
            servo = run.columns(layout.SERVO.path)
            columns = _arrays(path, {name: servo[RUN_COLUMNS[name]] for name in needed})
        if DISPLACEMENT in columns and not np.isfinite(columns[DISPLACEMENT]).any():
            raise failures.run_without_sensor(path=path)
        return columns
    except (RunFileError, KeyError, *disk.HDF5_ERRORS) as refused:
        _refuse_own(path, refused)
    try:
        with open_hdf5(path) as file:
            names = [name for name in file if isinstance(file[name], h5py.Dataset)]
            indices = find_columns(names, needed)
            if missing := [name for name in needed if name not in indices]:
                held = ", ".join(names[:20]) or "nothing"
                message = f"{path} has no dataset {' and no '.join(missing)}; its root holds {held}."
                raise failures.hdf5_record_wrong(problem=message, remedy=_hint(missing))
            datasets = {name: file[names[k]] for name, k in indices.items()}
            for dataset in datasets.values():
                refuse_endless(dataset.id)
            return _arrays(path, datasets)
    except (*disk.HDF5_ERRORS, KeyError, MemoryError) as error:
        raise failures.hdf5_unreadable(path=path, error=disk.reason(error)) from error


def _refuse_own(path: Path, refused: Exception) -> None:
    """Raise RecordError E3606 for a run file that holds no readable record."""
    with open_regular(path) as file:
        if layout.SCHEMA.partition("/")[0].encode() + b"/" not in file.read(_BEGIN_BYTES):
            return
    if isinstance(refused, RunFileError):
        message, hint = refused.message, refused.hint
    else:
        message = f"{path} is a run file whose servo signals cannot be read: {disk.reason(refused)}."
        hint = f"`edmctl run recover {path}` writes what can still be read into a new file."
    raise failures.hdf5_record_wrong(problem=message, remedy=hint) from refused


def _arrays(path: Path, columns: Mapping[str, h5py.Dataset | NDArray[np.generic]]) -> dict[str, Array]:
    for name, data in columns.items():
        if data.dtype.kind not in "fiu":
            message, hint = f"{path}: {name} is no dataset of numbers.", "Write it as floats."
        elif len(data.shape or ()) != 1:
            message, hint = f"{path}: {name} has the shape {data.shape}.", "Write it as one column."
        else:
            continue
        raise failures.hdf5_record_wrong(problem=message, remedy=hint)
    lengths = {name: data.shape[0] for name, data in columns.items()}
    if len(set(lengths.values())) > 1:
        each = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise failures.columns_differ_in_length(path=path, each=each)
    return {name: np.asarray(data[:], dtype=np.float64) for name, data in columns.items()}


def write_columns(path: Path, columns: Mapping[str, NDArray[np.generic]]) -> None:
    """Write columns, shape (n,), to a new file, HDF5 or CSV by its suffix. Raises RunFileError E9011, E9012."""
    if len({values.shape for values in columns.values()}) != 1:
        raise ValueError("columns differ in length")

    def fill(file: h5py.File) -> None:
        for name, values in columns.items():
            dataset = file.create_dataset(name, data=values)
            dataset.attrs["units"] = UNITS.get(name.rpartition("_")[2], PURE)

    if path.suffix.lower() in HDF5_SUFFIXES:
        content = image_of(fill)
    else:
        cells = ([text_cell(name), *map(repr, values.tolist())] for name, values in columns.items())
        content = row_lines(cells).encode()
    try:
        disk.write_new(path, content)
    except FileExistsError:
        raise failures.output_exists(path=path, remedy="Choose another name.") from None
    except OSError as error:
        remedy = "Check that its folder exists, can be written and has space."
        raise failures.output_not_written(what=path, why=disk.reason(error), remedy=remedy) from error
