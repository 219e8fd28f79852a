"""numba for the loops of the emulator: strict arithmetic, code kept on disk, records and functions of C."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.core import sigutils
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc
from numba.extending import intrinsic

from edmctl.core.library import Record

_F = TypeVar("_F", bound="Callable[..., Any]")
_R = TypeVar("_R", bound=Record)


class _Kept(FunctionCache):
    """Compiled code on disk as far as there is a disk: what fails costs time, never the job.

    numba compares the file of the function alone. This compares all that was compiled into it: the files of every
    function that it calls, and the constants that they use.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        found: dict[str, object] = {}
        _note_sources(function, found)
        self._cache_file._source_stamp = tuple(sorted((name, repr(value)) for name, value in found.items()))

    def load_overload(self, sig: object, target_context: object) -> object:
        """Load; None where there is nothing, or a file that was cut short."""
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # whatever unpickling makes of it
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: object, data: object) -> None:
        """Save where the disk takes it."""
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError:
            return


def _note_sources(function: Callable[..., Any], found: dict[str, object]) -> None:
    """Note what a function is compiled from: its file, its constants, and those of the functions that it calls."""
    module = function.__module__
    if f"{module}.{function.__qualname__}" in found:
        return
    found[f"{module}.{function.__qualname__}"] = found[module] = _hash_of(function.__code__.co_filename)
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        called = getattr(value, "py_func", None)
        if called is not None:
            _note_sources(called, found)
        elif isinstance(value, int | float | tuple):
            found[f"{module}.{name}"] = value


@lru_cache
def _hash_of(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def compiled(function: _F) -> _F:
    """Compile a part of a cached function; frees the GIL, no fastmath, so that plain Python gives the same bits."""
    return cast("_F", numba.njit(nogil=True, error_model="numpy")(function))


def cached(function: _F) -> _F:
    """Compile at the first call like `compiled`, and keep the code on disk: beside its file, or for the user."""
    dispatcher = numba.njit(nogil=True, error_model="numpy")(function)
    with suppress(RuntimeError):  # numba found no folder that can be written
        dispatcher._cache = _Kept(function)  # type: ignore[attr-defined]
    return cast("_F", dispatcher)


def callback(signature: object) -> Callable[[Callable[..., Any]], CFunc]:
    """Compile at once a function that C calls, at its `address`, and keep the code on disk."""
    given = sigutils.normalize_signature(signature)  # type: ignore[no-untyped-call]

    def compile_it(function: Callable[..., Any]) -> CFunc:
        made = CFunc(function, given, {}, {})
        with suppress(RuntimeError):  # numba found no folder that can be written
            made._cache = _Kept(function)  # type: ignore[attr-defined]
        made.compile()
        return made

    return compile_it


@cache
def _layout(kind: type[Record]) -> np.dtype[Any]:
    """Layout of a record, the same object every time: compiled code compares another like it field by field."""
    return np.dtype(kind)


def shared(record: _R) -> Sequence[_R]:
    """Return a record as compiled code takes it: an array of one, with the same names."""
    return np.frombuffer(record, _layout(type(record)))  # type: ignore[call-overload, no-any-return]


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def call(typing_context: Any, address: Any, argument: Any) -> tuple[Any, Callable[..., Any]]:
    """Call a C function at an address with one pointer; the truth that it returns."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        from llvmlite import ir

        byte, pointer = ir.IntType(8), ir.IntType(8).as_pointer()
        function = builder.inttoptr(arguments[0], ir.FunctionType(byte, [pointer]).as_pointer())
        found = builder.call(function, [builder.inttoptr(arguments[1], pointer)])
        return builder.icmp_unsigned("!=", found, ir.Constant(byte, 0))

    return types.boolean(types.int64, types.int64), generate
