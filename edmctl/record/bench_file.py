"""The file of a persistent bench: nested names with arrays, numbers and texts.

A line with the version, one with a hash over the rest, one with the length of the JSON text that follows, and then
the arrays, of which the text has type, shape and first byte. The file is replaced at once; while a program uses it,
a lock beside it keeps others away.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from edmctl import failures
from edmctl.errors import RunFileError
from edmctl.files import lock_holder, open_descriptor, read_bytes, replace_file
from edmctl.record import disk

State = Mapping[str, object]

KIND = b"edmctl-bench"
SCHEMA = 7
MOST_BYTES = 1_000_000_000
_ARRAY = "array"
"""The one name in the place of an array: its type, shape and first byte."""


@contextmanager
def bench_lock(path: Path, wait_s: float = 0.0) -> Iterator[None]:
    """Keep others from using a bench, and wait so long for them. Raises RunFileError E9020, E9023, E9024."""
    lock = _lock_of(path)
    with ExitStack() as held:
        try:
            disk.retried(lambda: _take_lock(lock, held), wait_s)
        except BlockingIOError as busy:
            holder = f"{lock_holder(lock) or 'another program'} has it"
            raise failures.bench_in_use(path=path, holder=holder) from busy
        except OSError as refused:
            raise _unwritable(path, refused) from refused
        yield


def _lock_of(path: Path) -> Path:
    try:
        target = path.resolve()
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        return target.with_name(f".{target.name}.lock")
    except (OSError, RuntimeError, ValueError) as refused:  # a loop of links, a null byte
        why = getattr(refused, "strerror", None) or str(refused)
        raise failures.bench_unreadable(path=path, why=why) from None


def _take_lock(lock: Path, held: ExitStack) -> None:
    """Open and lock the file until `held` is left. Raises BlockingIOError if another program has it."""

    def remove() -> None:
        with suppress(OSError):
            lock.unlink()

    while True:
        with ExitStack() as own:
            descriptor = open_descriptor(lock, os.O_RDWR | os.O_CREAT)
            own.callback(os.close, descriptor)
            own.enter_context(disk.exclusive_lock(descriptor))
            # The holder before may have removed it meanwhile.
            if lock.exists() and os.path.samestat(os.fstat(descriptor), lock.stat()):
                held.enter_context(own.pop_all())
                # It is removed while it is locked: whoever takes the name from then on makes a new file.
                held.callback(remove)
                return


def refuse_place(path: Path) -> None:
    """Raise RunFileError E9024 if there is no folder for a bench, E9020 if no file can have its name."""
    if not _lock_of(path).parent.is_dir():
        raise _unwritable(path, FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)))


def read_bench(path: Path) -> State:
    """Return the state in a file. Raises RunFileError: E9020 no bench or damaged, E9021 or E9022 another version."""
    try:
        content = read_bytes(path, MOST_BYTES)
    except OSError as refused:
        raise failures.bench_unreadable(path=path, why=refused.strerror or refused) from refused
    kind, _, version = content.partition(b"\n")[0].partition(b" ")
    if kind != KIND or not version.isdigit():
        raise failures.bench_unreadable(path=path, why="it is not the file of a bench")
    if int(version) > SCHEMA:
        raise failures.bench_of_later_version(path=path, schema=int(version), own_schema=SCHEMA)
    if int(version) < SCHEMA:
        raise failures.bench_of_earlier_version(path=path)
    _, digest, sealed = (*content.split(b"\n", 2), b"", b"")[:3]
    if digest.decode(errors="replace") != hashlib.sha256(sealed).hexdigest():
        raise failures.bench_unreadable(path=path, why="its content does not fit its check sum")
    length, _, rest = sealed.partition(b"\n")
    text, arrays = rest[: int(length)], rest[int(length) :]

    def array(value: dict[str, Any]) -> Any:
        if value.keys() != {_ARRAY}:
            return value
        kind, shape, first = value[_ARRAY]
        return np.frombuffer(arrays, kind, math.prod(shape), first).reshape(shape).copy()

    state: State = json.loads(text, object_hook=array)
    return state


def write_bench(path: Path, state: State, *, is_own: bool = False) -> None:
    """Put a state into the file at `path`, new or instead of the bench that is there; all of it or nothing.

    `is_own` means that this program, which holds the lock, has read or written the file already.

    Raises RunFileError: E9020 or E9022 what is there is no bench of this version, and stays; E9024 it cannot be
    written. Raises TypeError for a value that is no array and has no place in JSON.
    """
    target = path.resolve()
    if target.exists() and not is_own:
        read_bench(target)
    blocks: list[bytes] = []

    def place(value: object) -> dict[str, object]:
        if isinstance(value, Mapping):
            return dict(value)
        if not isinstance(value, np.ndarray):
            raise TypeError(f"{type(value).__name__} has no place in the file of a bench")
        first = sum(map(len, blocks))
        blocks.append(value.tobytes())
        return {_ARRAY: [value.dtype.str, value.shape, first]}

    text = json.dumps(dict(state), default=place).encode()
    sealed = b"%d\n%b%b" % (len(text), text, b"".join(blocks))
    digest = hashlib.sha256(sealed).hexdigest().encode()
    try:
        replace_file(target, b"%b %d\n%b\n%b" % (KIND, SCHEMA, digest, sealed))
    except OSError as refused:
        raise _unwritable(path, refused) from refused


def _unwritable(path: Path, refused: OSError) -> RunFileError:
    return failures.bench_not_kept(path=path, reason=refused.strerror or refused)
