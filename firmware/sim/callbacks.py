"""What Unicorn calls: reads and writes of registers, and the begin of every block of instructions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]

from edmctl.actuator.compiling import callback

from .addresses import DBGMCU_APB1_FZ, DWT_CYCCNT, SYSTEM_AT, TRACE_AT
from .calling import call
from .registers import (
    DEBUG_FREEZE,
    ENGINE,
    HALFWORDS,
    LIMIT,
    STOP,
    STOP_FUNCTION,
    WORDS,
    read_register,
    write_register,
    write_system,
)

_READ = types.uint64(types.voidptr, types.uint64, types.uint32, types.voidptr)
_WRITE = types.void(types.voidptr, types.uint64, types.uint32, types.uint64, types.voidptr)
_BLOCK = types.void(types.voidptr, types.uint64, types.uint32, types.voidptr)


@callback(_READ)
def on_read(_: Any, offset: Any, size: Any, words: Any) -> Any:
    """Unicorn's read of the peripherals."""
    r = carray(words, (WORDS,), np.int64)
    place: Any = np.int64(offset)
    value: Any = np.int64(read_register(r, place & ~3))
    return value >> (place & 3) * 8 & ((1 << 8 * np.int64(size)) - 1)


@callback(_WRITE)
def on_write(_: Any, offset: Any, size: Any, value: Any, words: Any) -> None:
    """Unicorn's write to the peripherals."""
    place: Any = np.int64(offset)
    new: Any = np.int64(value)
    write_register(carray(words, (WORDS,), np.int64), place, int(size), new)


@callback(_READ)
def on_system_read(_: Any, offset: Any, size: Any, words: Any) -> Any:
    """Unicorn's read of the system control space."""
    place: Any = np.int64(offset)
    value: Any = np.int64(carray(words, (WORDS,), np.int64)[SYSTEM_AT + (place >> 2)])
    return value >> (place & 3) * 8 & ((1 << 8 * np.int64(size)) - 1)


@callback(_WRITE)
def on_system_write(_: Any, offset: Any, size: Any, value: Any, words: Any) -> None:
    """Unicorn's write to the system control space; NVIC_ISER and the like are written as words."""
    r = carray(words, (WORDS,), np.int64)
    place: Any = np.int64(offset)
    new: Any = np.int64(value)
    if size < 4:
        at = SYSTEM_AT + (place >> 2)
        shift = (place & 3) * 8
        mask = ((1 << 8 * np.int64(size)) - 1) << shift
        r[at] = (r[at] & ~mask) | (new << shift & mask)
        return
    write_system(r, place, new)


@callback(_READ)
def on_trace_read(_: Any, offset: Any, size: Any, words: Any) -> Any:
    """DWT_CYCCNT counts what was executed in this millisecond."""
    r = carray(words, (WORDS,), np.int64)
    place: Any = np.int64(offset)
    return r[HALFWORDS] if place == DWT_CYCCNT else r[TRACE_AT + (place >> 2)]


@callback(_WRITE)
def on_trace_write(_: Any, offset: Any, size: Any, value: Any, words: Any) -> None:
    """Settings of the DWT."""
    carray(words, (WORDS,), np.int64)[TRACE_AT + (np.int64(offset) >> 2)] = value


@callback(_READ)
def on_debug_read(_: Any, offset: Any, size: Any, words: Any) -> Any:
    """What stands still with a halted core."""
    r = carray(words, (WORDS,), np.int64)
    return r[DEBUG_FREEZE] if np.int64(offset) == DBGMCU_APB1_FZ else np.int64(0)


@callback(_WRITE)
def on_debug_write(_: Any, offset: Any, size: Any, value: Any, words: Any) -> None:
    """The same, set."""
    if np.int64(offset) == DBGMCU_APB1_FZ:
        carray(words, (WORDS,), np.int64)[DEBUG_FREEZE] = np.int64(value)


@callback(_BLOCK)
def on_block(_: Any, address: Any, size: Any, words: Any) -> None:
    """Unicorn's hook of blocks: counts halfwords, and stops the run where it is asked for or has lasted too long.

    Not within a read or write: the instruction would be repeated.
    """
    r = carray(words, (WORDS,), np.int64)
    r[HALFWORDS] += np.int64(size) >> 1
    if r[STOP] or r[HALFWORDS] > r[LIMIT]:
        r[STOP] = 1
        call(r[STOP_FUNCTION], (r[ENGINE],))
