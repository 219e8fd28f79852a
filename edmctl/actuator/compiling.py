"""The one door to numba: strict arithmetic, code kept on disk, compilations told."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar, cast

import numba
from numba.core import event, sigutils
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc

_F = TypeVar("_F", bound="Callable[..., Any]")

COMPILES = not numba.config.DISABLE_JIT  # type: ignore[attr-defined]
"""Whether loops are compiled; without, the same source runs as plain Python (NUMBA_DISABLE_JIT=1)."""
TOLD_EVERY_S = 4.0
"""Whoever waits for a compiler hears of it so often."""
_COMPILING = "numba:compile"

_unkept: list[str] = []
"""Why compiled code is not kept on disk, in words; empty where it is."""


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
        except OSError as refused:
            _unkept.append(f"{self.cache_path}: {refused.strerror}")


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
    if not COMPILES:
        return function
    try:
        dispatcher._cache = _Kept(function)  # type: ignore[attr-defined]
    except RuntimeError:  # numba found no folder that can be written
        _unkept.append("no folder of the program or the user can be written")
    return cast("_F", dispatcher)


def callback(signature: object) -> Callable[[Callable[..., Any]], CFunc]:
    """Compile at once a function that C calls, at its `address`, and keep the code on disk."""
    given = sigutils.normalize_signature(signature)  # type: ignore[no-untyped-call]

    def compile_it(function: Callable[..., Any]) -> CFunc:
        made = CFunc(function, given, {}, {})
        try:
            made._cache = _Kept(function)  # type: ignore[attr-defined]
        except RuntimeError:  # numba found no folder that can be written
            _unkept.append("no folder of the program or the user can be written")
        made.compile()
        return made

    return compile_it


@contextmanager
def compiling_told(say: Callable[[str], None], takes: str = "some 20 s") -> Iterator[None]:
    """Tell `say` of a compilation as it begins and every few seconds, and once where its code is not kept.

    takes : how long all of it takes, for people.
    """
    teller = _Teller(say, takes)
    with event.install_listener(_COMPILING, teller):
        yield
    if teller.compiled and _unkept:
        say(
            f"what was compiled could not be kept ({_unkept[0]}), so every command compiles again: "
            "set NUMBA_CACHE_DIR to a folder that can be written"
        )


class _Teller(event.Listener):
    """Hears numba begin and end in the thread that made it, functions within functions."""

    def __init__(self, say: Callable[[str], None], takes: str) -> None:
        self._say, self._takes = say, takes
        self._waits = threading.get_ident()
        self._depth = 0
        self._before_s = self._begin_s = 0.0
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def compiled(self) -> bool:
        """Whether anything was."""
        return self._before_s > 0.0

    def on_start(self, _: event.Event) -> None:
        """Begin to tell with the outermost function."""
        if threading.get_ident() != self._waits:
            return
        self._depth += 1
        if self._depth > 1:
            return
        if not self._before_s:
            self._say(f"compiling, once for this installation: {self._takes}")
        self._begin_s = monotonic()
        self._ended.clear()
        self._thread = threading.Thread(target=self._tell, name="tells of compiling", daemon=True)
        self._thread.start()

    def on_end(self, _: event.Event) -> None:
        """End with it; nobody else writes by then."""
        if threading.get_ident() != self._waits:
            return
        self._depth -= 1
        if self._depth == 0 and self._thread is not None:
            self._ended.set()
            self._thread.join()
            self._before_s += monotonic() - self._begin_s

    def _tell(self) -> None:
        while not self._ended.wait(TOLD_EVERY_S):
            self._say(f"still compiling, {self._before_s + monotonic() - self._begin_s:.0f} s so far")
