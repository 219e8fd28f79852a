"""A millisecond of the machine: the plant, and what converters, timers, DMA and line make of it for the chip."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.simulator.plant_records import TICK_NS

from .addresses import DMA1, TIM5, TIM_CR1, word
from .circuit import SWITCH_OFF_NS
from .compiling import call, compiled
from .converters import sample_gap, sample_slow
from .dma import put
from .edges import GATE_SENSE_AT, send_edges, take_pulses
from .line import carry_line
from .pins import lead, show
from .registers import BASE_84, HALFWORDS, OFF_AT

if TYPE_CHECKING:
    import numpy as np

    from edmctl.array_types import Array
    from edmctl.simulator.plant_records import Drive, Readings, Scope, Unit

    from .circuit import Bench


@compiled
def run_millisecond(
    r: np.ndarray,
    memory: np.ndarray,
    bench: Bench,
    rx: np.ndarray,
    tx: np.ndarray,
    unit: Unit,
    scope: Scope,
    hiss: Array,
    drive: Drive,
    readings: Readings,
    plant_run: int,
    machine: int,
) -> bool:
    """The plant's millisecond, and what the chip sees of it. True where somebody should look under the tool."""
    begin_ns = float(readings.tick) * TICK_NS
    if r[OFF_AT]:  # after the millisecond before had begun
        bench.off_ns = begin_ns + (r[OFF_AT] - 1) / 168.0 * 1e3 + SWITCH_OFF_NS
    lead(r, bench, drive)
    touches = 1 if (readings.contact == 1) != (unit.contact_inverted == 1) else 0
    if bench.had_contact and not touches and not drive.pulses_on:
        drive.contact_tests += 1
    bench.had_contact = touches
    look: bool = call(plant_run, machine)  # type: ignore[call-arg]
    if drive.pulses_on:
        take_pulses(bench, scope, readings)
    r[BASE_84] = (bench.ticks * 84_000) & 0xFFFFFFFF
    send_edges(r, memory, bench, begin_ns)
    if readings.stray_pulses and not drive.pulses_on:  # a driver that switches by itself
        for k in range(readings.stray_pulses):
            put(r, memory, DMA1, 3, 6, GATE_SENSE_AT, 4, (r[BASE_84] + 1000 * (k + 1)) & 0xFFFFFFFF)
    sample_gap(r, memory, bench, unit, scope, readings, hiss, begin_ns)
    sample_slow(r, memory, bench, readings, hiss)
    carry_line(r, memory, bench, rx, tx)
    show(r, bench, readings)
    if r[word(TIM5, TIM_CR1)] & 1:
        bench.ticks += 1
    r[BASE_84] = (bench.ticks * 84_000) & 0xFFFFFFFF
    r[HALFWORDS] = 0
    return bool(look)
