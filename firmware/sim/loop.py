"""Chip and machine by turns, compiled: as many milliseconds as nothing happens that Python has to see to."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.core.library import Record, record

from . import registers as reg
from .addresses import IWDG, IWDG_PR, IWDG_RLR, IWDG_STOPS, WWDG, WWDG_CFR, WWDG_CR, WWDG_STOPS, word
from .chip import run_tick
from .compiling import cached, compiled
from .wiring import run_millisecond

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from edmctl.array_types import Array
    from edmctl.simulator.plant_records import Drive, Readings, Scope, Unit

    from .circuit import Bench

DONE, LOOK, CHANGED, FAILED, BITTEN_BY_WWDG, BITTEN_BY_IWDG, SENT = range(7)
"""Why the loop came back: time over; look under the tool; generator, stages or triggers changed; the processor
stopped or asks for a reset; a watchdog; a frame that somebody waits for."""
_WWDG_HZ = 42e6 / 4096  # PCLK1 over 4096, before the divider of WWDG_CFR (RM0090 §22.4)
_LSI_KHZ = 32  # the independent watchdog's clock (§21.3)
_MOST_SENT = 3000
"""Bytes of the line that wait for Python at most."""


@record
class Watch(Record):
    """What the loop watches."""

    is_due: int  # 1: the chip's interrupt of the last millisecond is still to come
    status: int  # of the processor, where it failed
    wwdg_silent: int  # milliseconds since they were fed
    iwdg_silent: int
    arms_at: int  # places in memory of counts that triggers wait for
    touches_at: int
    arms: int
    touches: int
    most_load: int  # halfwords executed in a millisecond
    loads: int  # sum and number
    loads_count: int


@compiled
def word_of(memory: np.ndarray, at: int) -> int:
    """A word of memory."""
    return int(memory[at] | memory[at + 1] << 8 | memory[at + 2] << 16 | memory[at + 3] << 24)


@cached
def run(
    ticks: int,
    stops_when_sent: bool,
    watches: Sequence[Watch],
    core: np.ndarray,
    r: np.ndarray,
    sram: np.ndarray,
    ccm: np.ndarray,
    frame: np.ndarray,
    entry: np.ndarray,
    leave: np.ndarray,
    benches: Sequence[Bench],
    rx: np.ndarray,
    tx: np.ndarray,
    units: Sequence[Unit],
    scopes: Sequence[Scope],
    hiss: Array,
    all_drives: Sequence[Drive],
    all_readings: Sequence[Readings],
    plant_run: int,
    machine: int,
) -> int:
    """Run up to `ticks` milliseconds: for each, what the chip does at its begin, then the machine's own.

    `plant_run` is the address of that function in C, `machine` the address of its argument.
    """
    watch, bench, unit, scope = watches[0], benches[0], units[0], scopes[0]
    drive, readings = all_drives[0], all_readings[0]
    for _ in range(ticks):
        if watch.is_due:
            watch.is_due = 0
            r[reg.WWDG_FED] = r[reg.IWDG_FED] = 0
            reg.put_supply(r, bench.supply_low)
            status = 0 if bench.halted else run_tick(core, r, sram, ccm, frame, entry, leave)
            load = r[reg.HALFWORDS]
            watch.most_load = max(watch.most_load, load)
            watch.loads += load
            watch.loads_count += 1
            if status or r[reg.RESET_ASKED] or r[reg.MPU_SET]:
                watch.status = status
                return FAILED
            stops = r[reg.DEBUG_FREEZE] if bench.halted else 0
            watch.wwdg_silent = 0 if r[reg.WWDG_FED] else watch.wwdg_silent + (0 if stops & WWDG_STOPS else 1)
            watch.iwdg_silent = 0 if r[reg.IWDG_FED] else watch.iwdg_silent + (0 if stops & IWDG_STOPS else 1)
            control, setting = r[word(WWDG, WWDG_CR)], r[word(WWDG, WWDG_CFR)]
            counts = ((control & 0x7F) - 0x3F) << (setting >> 7 & 3)
            if control & 0x80 and watch.wwdg_silent * _WWDG_HZ >= counts * 1000.0:
                return BITTEN_BY_WWDG
            period = ((r[word(IWDG, IWDG_RLR)] & 0xFFF) + 1) * (4 << min(r[word(IWDG, IWDG_PR)] & 7, 6))
            if r[reg.IWDG_RUNS] and watch.iwdg_silent * _LSI_KHZ >= period:
                return BITTEN_BY_IWDG
            counted = bench.ticks > 0 and (
                word_of(ccm, watch.arms_at) != watch.arms or word_of(ccm, watch.touches_at) != watch.touches
            )
            if r[reg.GATE_CHANGES] or counted:
                return CHANGED
        look = run_millisecond(r, sram, bench, rx, tx, unit, scope, hiss, drive, readings, plant_run, machine)
        watch.is_due = 1
        if look:
            return LOOK
        if bench.moved:
            return CHANGED
        if bench.tx_size > _MOST_SENT or (stops_when_sent and bench.urgent):
            return SENT
    return DONE
