"""Paths that users write, and files that are read: regular ones, and no longer than they can be meant to be.

A pipe would keep its reader waiting, opening a device may do something, and /dev/zero never ends.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from collections.abc import Mapping
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Any

from edmctl import failures

TEXT_BYTES = 2_000_000
"""Longer than any profile, setup, list of places, calibration or journal; reading it takes a second and 100 MB."""
RECORD_BYTES = 200_000_000
"""Measured data as text, an hour at 1 kHz; longer records stand in HDF5."""

_WITHOUT_WAITING = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_BINARY", "O_CLOEXEC"))


def user_path(text: str | os.PathLike[str], folder: Path = Path()) -> Path:
    """Return the path that a user wrote in an option, a variable, a TOML key or an argument of the Python API.

    `~` and `~user` are expanded, and a relative path is relative to `folder`. Raises UsageError E2007 if that home
    folder is unknown, so that no folder named `~` is made, or if no file can have the name.
    """
    written = os.fspath(text)
    expanded = os.path.expanduser(written)  # noqa: PTH111 - Path.expanduser() raises for an unknown user
    if expanded.startswith("~"):
        raise failures.home_folder_unknown(written=written)
    path, fault = folder / expanded, "" if written else "it is empty"
    try:
        path.stat()
    except OSError as error:  # every other failure is reported where the file is read or written
        fault = str(error.strerror) if error.errno in (errno.ENAMETOOLONG, errno.ELOOP) else ""
    except ValueError:
        fault = "it contains U+0000"
    if fault:
        raise failures.path_impossible(written=written, fault=fault)
    return path


def path_variable(name: str, environ: Mapping[str, str]) -> Path | None:
    """Return the path in an environment variable; None if it is not set or empty. Raises UsageError E2007."""
    return user_path(written) if (written := environ.get(name)) else None


def open_regular(path: Path) -> BufferedReader:
    """Open a file for reading. Raises OSError, also for a folder, a pipe or a device, which stays untouched."""
    return _Regular(FileIO(open_descriptor(path, os.O_RDONLY)))


class _Regular(BufferedReader):
    """A file that is read without waiting: one of the kernel that has nothing to read at present is empty."""

    def read(self, size: int | None = -1, /) -> bytes:
        """Return up to `size` bytes, none instead of None where reading would wait."""
        return super().read(size) or b""


def open_descriptor(path: Path, flags: int) -> int:
    """Open a file with flags of `os.open`; return its descriptor. Raises OSError as `open_regular` does."""
    try:
        _refuse_other(path.stat().st_mode)
    except FileNotFoundError:
        pass  # os.O_CREAT makes it
    except ValueError as error:  # a null byte
        raise OSError(errno.EINVAL, str(error)) from None
    number = os.open(path, flags | _WITHOUT_WAITING, 0o666)
    try:
        _refuse_other(os.fstat(number).st_mode)  # it may be another one by now
    except BaseException:
        os.close(number)
        raise
    return number


def read_bytes(path: Path, most_bytes: int = TEXT_BYTES) -> bytes:
    """Return what a file holds. Raises OSError as `open_regular` does, and EFBIG beyond `most_bytes`."""
    with open_regular(path) as file:
        is_longer = os.fstat(file.fileno()).st_size > most_bytes
        content = b"" if is_longer else file.read(most_bytes + 1)
    if is_longer or len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"it is longer than {most_bytes / 1e6:g} MB")
    return content


def json_of(data: bytes) -> Any:
    """Return the value of a JSON text.

    Raises ValueError, also if it is nested too deeply or contains a text that UTF-8 cannot represent.
    """
    try:
        value = json.loads(data)
        json.dumps(value, ensure_ascii=False).encode()  # fails for half of a surrogate pair
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    return value


def refuse_locked(path: Path) -> None:
    """Raise BlockingIOError that names the holder if another program has locked a file for writing, as HDF5 does."""
    try:
        import fcntl
    except ImportError:  # Windows, where such a file cannot be opened
        return
    with open_regular(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            by = lock_holder(path) or "another program"
            raise BlockingIOError(errno.EWOULDBLOCK, f"{by} has it open for writing") from None
        except OSError:  # its disk knows no locks
            return


def lock_holder(path: Path) -> str:
    """Return "process 1234 (edmctl machine …)" for the holder of the lock on a file or port; "" if unknown."""
    try:
        place = path.stat()
        locks = Path("/proc/locks").read_text(encoding="ascii")
    except OSError:
        return ""
    for line in locks.splitlines():
        fields = line.split()
        if len(fields) < 6 or fields[1] != "FLOCK":
            continue
        major, minor, inode = fields[5].split(":")
        device = os.makedev(int(major, 16), int(minor, 16))
        if (device, int(inode)) == (place.st_dev, place.st_ino):
            return _described(int(fields[4]))
    return ""


def _described(pid: int) -> str:
    """Return a process by its number, with the first 60 characters of its command."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").rstrip("\0").split("\0")
    except OSError:
        return f"process {pid}"
    if "edmctl" in words[:4]:  # `python -m edmctl machine`
        words = words[words.index("edmctl") :]
    text = " ".join([Path(words[0]).name, *words[1:]])
    return f"process {pid} ({text if len(text) <= 60 else text[:59] + '…'})"


def replace_file(path: Path, content: bytes) -> None:
    """Write a file, new or instead of the one there: all of it, on the disk itself, or nothing. Raises OSError."""
    new = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        with new.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


def sync(place: Path) -> None:
    """Wait until the disk has a file, or the names in a folder. Raises OSError."""
    descriptor = os.open(place, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _refuse_other(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder")
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is a pipe, a device or a socket")
