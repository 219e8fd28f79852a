"""What Unicorn calls: reads and writes of registers, and the begin of every block of instructions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]
from unicorn.arm_const import UC_ARM_REG_XPSR
from unicorn.unicorn_const import UC_MEM_FETCH, UC_PROT_ALL, UC_PROT_READ, UC_PROT_WRITE

from .addresses import CCM_AT, DBGMCU_APB1_FZ, DWT_CYCCNT, SRAM_AT, SYSTEM_AT, TRACE_AT
from .calling import call
from .compiling import callback
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
_FILL = types.boolean(types.voidptr, types.uint64, types.int32, types.voidptr, types.voidptr)
_IT_BITS = 0x0600FC00  # of the xPSR: PM0214 §2.1.3

FILL_ENGINE, FILL_READ, FILL_WRITE, FILL_VALUE_AT, FILL_VALUE, FILL_WORDS = range(6)
"""What `on_fill` needs: Unicorn, its functions that read and write a register, and where the value goes."""


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


@callback(_FILL)
def on_fill(_: Any, address: Any, kind: Any, entry: Any, words: Any) -> Any:
    """Unicorn's way from an address to memory: the same address, and what may be done there as far as this knows.

    Where nothing is executed nothing may be: Unicorn would look for code it has translated at every write. Whether
    there is memory, and open, it asks itself.

    Before it asks it sets the processor back to the instruction that wanted the address. Within an IT block that
    leaves the block's state to the code behind, which has begun without it: what is conditional would be again.
    """
    fill = carray(words, (FILL_WORDS,), np.int64)
    value_at = np.int64(fill[FILL_VALUE_AT])
    call(fill[FILL_READ], (fill[FILL_ENGINE], np.int64(UC_ARM_REG_XPSR), value_at))
    if fill[FILL_VALUE] & _IT_BITS:
        fill[FILL_VALUE] &= ~_IT_BITS
        call(fill[FILL_WRITE], (fill[FILL_ENGINE], np.int64(UC_ARM_REG_XPSR), value_at))
    place: Any = np.int64(address)
    is_code = (place < SRAM_AT and place >> 16 != CCM_AT >> 16) or kind == UC_MEM_FETCH
    told = carray(entry, (2,), np.int64)
    told[0] = place
    told[1] = UC_PROT_ALL if is_code else UC_PROT_READ | UC_PROT_WRITE
    return True
