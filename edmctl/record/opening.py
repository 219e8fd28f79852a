"""Opens a run file for reading, whatever has become of it, and says what is wrong with it."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.errors import RunFileError
from edmctl.files import open_regular, refuse_locked
from edmctl.record import layout
from edmctl.record.disk import HDF5_ERRORS, PARTIAL
from edmctl.record.hdf5 import open_hdf5, open_swmr
from edmctl.record.integrity import MAGIC, Checksum, are_sound, read_superblock, verify_checksum

if TYPE_CHECKING:
    import h5py

_ANOTHER = "Give a file that a run has written (.h5 or .h5.partial)."


def open_file(path: Path, *, verify: bool = True) -> h5py.File:
    """Open the run file at `path`; without `verify` its check sum is not compared, which takes reading all of it.

    Raises RunFileError: E9005 there is none or it is not a run file, E9006 a later version wrote it, E9007 it is
    damaged, E9016 another program has locked it.
    """
    refuse_unreadable(path)
    seal = _seal_of(path) if verify else None
    if seal is Checksum.BROKEN:
        raise damaged(path, "its check sum does not fit")
    if seal is not Checksum.FITS and not are_sound(path):
        raise damaged(path, "its texts cannot be read")
    try:
        file = open_unjudged(path)
    except HDF5_ERRORS as error:
        raise damaged(path, _too_short(path) or str(error).splitlines()[0]) from error
    try:
        refuse_foreign(path, file)
        if seal is Checksum.NONE:
            _check_length(path)
    except BaseException:
        file.close()
        raise
    return file


def damaged(path: Path, why: str) -> RunFileError:
    """Return the error for a file that began as a run file and cannot be read as one any more."""
    return RunFileError(
        f"{path} is damaged: {why}.",
        code="E9007",
        hint=f"`edmctl run recover {path}` writes what can still be read into a new file; this one stays as it is.",
    )


def refuse_unreadable(path: Path) -> None:
    """Raise RunFileError: E9005 there is no file, or it is not HDF5, E9016 another program has locked it."""
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise RunFileError(f"{path} is no file.", code="E9005", hint=_ANOTHER)
        if path.is_dir():
            raise RunFileError(f"{path} is a folder.", code="E9005", hint=f"Try `edmctl run list {path}`.")
        with open_regular(path) as file:
            begin = file.read(len(MAGIC))
        if not begin:
            raise RunFileError(f"{path} is empty.", code="E9005", hint=_ANOTHER)
        if begin != MAGIC:
            raise RunFileError(f"{path} is not an HDF5 file.", code="E9005", hint=_ANOTHER)
        refuse_locked(path)
        _refuse_holes(path)
    except BlockingIOError as error:
        hint = "Close it in that program, or read a copy."
        raise RunFileError(f"{path} is in use: {error.strerror}.", code="E9016", hint=hint) from None
    except FileNotFoundError as error:
        raise RunFileError(f"There is no run file {path}.", code="E9005", hint=_nearest(path)) from error
    except OSError as error:
        raise _unreadable(path, error) from error


_HOLES_BYTES, _HOLES_RATIO = 1 << 26, 100
"""A file that is so much longer than what the disk stores of it; compressing file systems reach a ratio of 32."""


def _refuse_holes(path: Path) -> None:
    """Raise OSError EFBIG if almost all of a file are holes, so that reading it would not end."""
    found = path.stat()
    stored_bytes = 512 * getattr(found, "st_blocks", found.st_size)
    if found.st_size > _HOLES_BYTES + _HOLES_RATIO * stored_bytes:
        raise OSError(errno.EFBIG, f"of its {found.st_size / 1e9:.0f} GB almost nothing was written")


def _seal_of(path: Path) -> Checksum:
    try:
        return verify_checksum(path)
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError) -> RunFileError:
    return RunFileError(
        f"{path} cannot be read: {error.strerror}.", code="E9005", hint="Check the path and its permissions."
    )


def open_unjudged(path: Path) -> h5py.File:
    """Open the run file at `path`, live or not, without a look at what it holds. Raises what h5py raises."""
    # A live or killed writer leaves the file marked as open; SWMR readers are made for that. They do not see that
    # a file was cut short, so all others must do without.
    marked = read_superblock(path).open_for_writing
    return open_swmr(path) if marked else open_hdf5(path)


def _too_short(path: Path) -> str:
    """What is wrong with a file that was cut off; empty where it was not."""
    end_bytes, size_bytes = read_superblock(path).end_bytes, path.stat().st_size
    if end_bytes is None or size_bytes >= end_bytes:
        return ""
    return f"it is shorter than it says, {size_bytes} of {end_bytes} bytes"


def _check_length(path: Path) -> None:
    """A closed file without a seal ends where its data end: what is behind them is what was left of a seal."""
    superblock = read_superblock(path)
    if not superblock.open_for_writing and path.stat().st_size != superblock.end_bytes:
        raise damaged(path, "its check sum is not whole")


def refuse_foreign(path: Path, file: h5py.File) -> None:
    """Raise RunFileError: E9005 it is no run file, E9006 of another version, E9007 damaged."""
    try:
        schema, maker = (str(file.attrs.get(name, "")) for name in ("schema", "edmctl_version"))
    except (*HDF5_ERRORS, KeyError) as error:
        raise damaged(path, str(error).splitlines()[0]) from error
    name, _, version = schema.partition("/")
    present_name, _, present = layout.SCHEMA.partition("/")
    if name != present_name or not version.isdigit():
        raise RunFileError(
            f"{path} is an HDF5 file, but not a run file of edmctl.", code="E9005", hint=_ANOTHER
        )
    if int(version) > int(present):
        raise RunFileError(
            f"{path} was written by a later version of edmctl ({schema}; this one reads {layout.SCHEMA}).",
            code="E9006",
            hint="Update edmctl.",
        )
    if int(version) < int(present):
        raise RunFileError(
            f"{path} was written by edmctl {maker}, an earlier version ({schema}; not {layout.SCHEMA}).",
            code="E9006",
            hint="Read it with that version; its `edmctl run export` writes tables for other programs.",
        )


def _nearest(path: Path) -> str:
    for folder in (path.parent, path.parent / "runs"):
        for ending in (PARTIAL, f".h5{PARTIAL}"):
            partial = folder / f"{path.name}{ending}"
            if partial.exists():
                return f"The run was not finished; its rows are in {partial}."
        finished = folder / f"{path.name}.h5"
        if finished.exists():
            return f"Did you mean {finished}?"
    if not path.parent.is_dir():
        return "Check the path."
    where = "" if len(path.parts) == 1 else f" {path.parent}"
    return f"`edmctl run list{where}` tells which there are."
