"""The file of a persistent bench: nested names with arrays, numbers and texts, as HDF5.

The dataset `state` is JSON text with names, numbers and texts; each array in it is a place in the dataset `arrays`.
Hundreds of datasets, written every few seconds of the bench's time, would cost more than the machining. A hash over
both detects damage. The file is replaced at once; while a program uses it, a lock beside it keeps others away.
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
from typing import TYPE_CHECKING, Any

import numpy as np

from edmctl import failures
from edmctl.errors import RunFileError
from edmctl.files import lock_holder, open_descriptor, open_regular, refuse_locked, replace_file
from edmctl.record import locks
from edmctl.record.disk import HDF5_ERRORS, reason
from edmctl.record.opening import MAGIC, image_of, open_hdf5, refuse_endless

if TYPE_CHECKING:
    import h5py

State = Mapping[str, object]

KIND = "edmctl-bench"
SCHEMA = 6
_HASH = "sha256"
_OTHER_PARTS = (json.JSONDecodeError, KeyError, TypeError, AttributeError, MemoryError, RecursionError)
"""What comes of parts that are missing, of another kind or of absurd size."""
_ARRAY = "array"
"""The one name in the place of an array: its type, shape and first byte."""


@contextmanager
def bench_lock(path: Path, wait_s: float = 0.0) -> Iterator[None]:
    """Keep others from using the bench at `path` while the block runs; wait so long for a present user.

    Raises RunFileError: E9020 no file can have this name, E9023 it is in use, E9024 nothing can be written there.
    """
    lock = _lock_of(path)
    with ExitStack() as held:
        try:
            locks.retried(lambda: _take_lock(lock, held), wait_s)
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
        raise _unreadable(path, getattr(refused, "strerror", None) or str(refused)) from None


def _take_lock(lock: Path, held: ExitStack) -> None:
    """Open and lock the file until `held` is left. Raises BlockingIOError if another program has it."""

    def remove() -> None:
        with suppress(OSError):
            lock.unlink()

    while True:
        with ExitStack() as own:
            descriptor = open_descriptor(lock, os.O_RDWR | os.O_CREAT)
            own.callback(os.close, descriptor)
            own.enter_context(locks.exclusive(descriptor))
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
    """Return the state in the file at `path`.

    Raises RunFileError: E9020 it is no bench or damaged, E9021 or E9022 another version wrote it, E9023 another
    program has it open.
    """
    try:
        # A pipe would keep HDF5 waiting for ever, and opening may change a device.
        with open_regular(path) as regular:
            if regular.read(len(MAGIC)) != MAGIC:
                raise _unreadable(path, "it is not an HDF5 file")
        refuse_locked(path)
    except BlockingIOError as busy:
        raise failures.bench_in_use(path=path, holder=busy.strerror) from None
    except OSError as refused:
        raise _unreadable(path, refused.strerror or str(refused)) from refused
    try:
        with open_hdf5(path) as file:
            kind, schema = file.attrs.get("kind"), file.attrs.get("schema")
            if not (isinstance(kind, str) and kind == KIND and isinstance(schema, np.integer)):
                raise failures.not_a_bench(path=path)
            if schema > SCHEMA:
                raise failures.bench_of_later_version(path=path, schema=int(schema), own_schema=SCHEMA)
            if schema < SCHEMA:
                raise failures.bench_of_earlier_version(path=path)
            text, arrays = _bytes(file["state"]), _bytes(file["arrays"])
            if file.attrs[_HASH] != _hash_of(text, arrays):
                raise ValueError("its content does not fit its check sum")
    except _OTHER_PARTS as error:
        raise _unreadable(path, "its parts are not those of a bench") from error
    except HDF5_ERRORS as error:
        raise _unreadable(path, reason(error)) from error

    def array(value: dict[str, Any]) -> Any:
        if value.keys() != {_ARRAY}:
            return value
        kind, shape, first = value[_ARRAY]
        return np.frombuffer(arrays, kind, math.prod(shape), first).reshape(shape).copy()

    try:
        state: State = json.loads(text, object_hook=array)
    except (*_OTHER_PARTS, ValueError) as error:
        raise _unreadable(path, "its parts are not those of a bench") from error
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
    arrays = b"".join(blocks)

    def fill(file: h5py.File) -> None:
        file.attrs.update({"kind": KIND, "schema": SCHEMA, _HASH: _hash_of(text, arrays)})
        file["state"] = np.frombuffer(text, np.uint8)
        file["arrays"] = np.frombuffer(arrays, np.uint8)

    try:
        replace_file(target, image_of(fill))
    except OSError as refused:
        raise _unwritable(path, refused) from refused


def _bytes(dataset: h5py.Dataset) -> bytes:
    refuse_endless(dataset.id)
    return bytes(dataset[()].tobytes())


def _hash_of(text: bytes, arrays: bytes) -> str:
    return hashlib.sha256(text + b"\0" + arrays).hexdigest()


def _unreadable(path: Path, why: str) -> RunFileError:
    return failures.bench_unreadable(path=path, why=why)


def _unwritable(path: Path, refused: OSError) -> RunFileError:
    return failures.bench_not_kept(path=path, reason=refused.strerror or refused)
