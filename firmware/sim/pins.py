"""What the pins tell the machine, and what the machine shows them. Which pin is what: firmware/board/stm32f4/pins.h.

A peripheral that the image has not set up rightly does not work here either.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .addresses import (
    BIF,
    BKE,
    BKP,
    DAC,
    DAC_CR,
    DAC_DHR12R1,
    DAC_DHR12R2,
    GPIO_AFRH,
    GPIO_AFRL,
    GPIO_MODER,
    GPIO_ODR,
    MOE,
    PORT_A,
    PORT_C,
    PORT_D,
    PORT_E,
    PORT_F,
    PORT_G,
    TIM1,
    TIM3,
    TIM10,
    TIM11,
    TIM13,
    TIM_ARR,
    TIM_BDTR,
    TIM_CCER,
    TIM_CCMR1,
    TIM_CCR1,
    TIM_CCR2,
    TIM_CR1,
    TIM_PSC,
    TIM_SMCR,
    TIM_SR,
    word,
)
from .circuit import DAC_V, INPUTS, PUMP_TICKS, REST_TICKS, SET_A, SET_V, STAGE_TICKS, SWITCH_OFF_NS
from .compiling import cached, compiled
from .registers import ALIVE_EDGES, DAC_CODE, GATE_STARTS, IS_BROKEN, PINS, gate_off
from .steps import TICK_LATE, take_steps

if TYPE_CHECKING:
    import numpy as np

    from edmctl.simulator.plant_records import Drive, Readings

    from .circuit import Bench

LONGEST_US = 1e6  # period that the protocol allows


@compiled
def pin_is(r: np.ndarray, port: int, pin: int, mode: int, function: int) -> bool:
    """Whether a pin has a mode (RM0090 §8.4.1) and, for mode 2, an alternate function."""
    if r[word(port, GPIO_MODER)] >> 2 * pin & 3 != mode:
        return False
    return mode != 2 or r[word(port, GPIO_AFRL if pin < 8 else GPIO_AFRH)] >> 4 * (pin & 7) & 15 == function


@compiled
def gate_is_on(r: np.ndarray) -> bool:
    """Whether TIM1 drives the gate: PWM mode 1, counter, output and main output on (RM0090 §17.3.9, 17.4)."""
    runs = (
        r[word(TIM1, TIM_CR1)] & 1
        and r[word(TIM1, TIM_CCER)] & 3 == 1
        and r[word(TIM1, TIM_CCMR1)] & 0x73 == 0x60
    )
    return bool(runs and r[word(TIM1, TIM_BDTR)] & MOE and pin_is(r, PORT_E, 9, 2, 1))


@compiled
def lead(r: np.ndarray, bench: Bench, drive: Drive) -> None:
    """What the pins tell the machine for the millisecond that begins."""
    if r[ALIVE_EDGES] != bench.alive_edges:
        bench.alive_edges = r[ALIVE_EDGES]
        bench.alive_ticks = 0
    else:
        bench.alive_ticks += 1
    bench.chain_ticks = bench.chain_ticks + 1 if bench.chain_loop else 0
    chain_open = bench.over_current or bench.chain_ticks > bench.chain_ms
    r[IS_BROKEN] = 1 if chain_open else 0
    if (chain_open or bench.breaks) and r[word(TIM1, TIM_BDTR)] & BKE and not r[word(TIM1, TIM_BDTR)] & BKP:
        r[word(TIM1, TIM_SR)] |= BIF
        gate_off(r)
    bench.breaks = 0
    if not bench.dac_dead:
        bench.actuator_code = r[DAC_CODE]
    drive.actuator_v = bench.actuator_code * DAC_V
    enabled = bench.alive_ticks <= PUMP_TICKS and bench.hv_ok
    machines = pin_is(r, PORT_F, 14, 1, 0) and r[word(PORT_F, GPIO_ODR)] >> 14 & 1
    drive.generator = 1 if machines else 0
    on = gate_is_on(r) and enabled and machines
    if on and (not bench.was_on or r[GATE_STARTS] != bench.gate_starts):
        drive.pulse_starts += 1
    bench.gate_starts = r[GATE_STARTS]
    bench.was_on = 1 if on else 0
    drive.pulses_on = bench.was_on
    moves = False
    late = bench.tick_jitter
    r[TICK_LATE] = 4 * (bench.ticks * 2654435761 % 4294967296 * (late + 1) >> 32)
    for axis in range(3):
        page, function = (TIM10, 3) if axis == 0 else (TIM11, 3) if axis == 1 else (TIM13, 9)
        n = take_steps(r, page)
        if not pin_is(r, PORT_F, 6 + axis, 2, function):
            n = 0
        bench.steps[axis] += n if r[word(PORT_F, GPIO_ODR)] >> axis & 1 else -n
        moves = moves or n != 0
    if moves:
        bench.rest_ticks = 0
        bench.travels += 1
        if bench.travels % STAGE_TICKS == 0:
            bench.moved = 1
    elif bench.travels:
        bench.rest_ticks += 1
        if bench.rest_ticks >= REST_TICKS:
            bench.travels, bench.moved = 0, 2


@compiled
def show(r: np.ndarray, bench: Bench, readings: Readings) -> None:
    """Levels of the input pins at the end of the millisecond."""
    loops = (1 - bench.estop, 1 - bench.door, bench.hv_ok, bench.level_ok, 1 - bench.limit)
    levels = 0
    for pin in range(INPUTS):
        bench.open_ticks[pin] = 0.0 if loops[pin] else bench.open_ticks[pin] + 1.0
        if bench.open_ticks[pin] == 0.0 or bench.open_ticks[pin] < bench.input_ms:
            levels |= 1 << pin
    r[PINS + PORT_G - PORT_A] = levels
    contact = readings.contact if bench.chatters < 2 else 1
    if bench.chatters and bench.ticks * 2654435761 >> 31 & 1:
        contact = 0
    r[PINS + PORT_F - PORT_A] = contact << 13
    r[PINS + PORT_D - PORT_A] = 0 if bench.line_low else 1 << 9
    r[PINS + PORT_E - PORT_A] = 0 if r[IS_BROKEN] else 1 << 15


@cached
def generator_of(r: np.ndarray) -> tuple[float, float, float, float, float]:
    """What TIM1, TIM3 and the DAC set the generator to: on-time and off-time, µs, V, A, discharge time, µs, or 0.

    A switch that is told to go off for less time than it takes to open does not: that is direct current, one pulse
    of the longest period.
    """
    scale = (r[word(TIM1, TIM_PSC)] + 1) / 168.0
    on_us = r[word(TIM1, TIM_CCR1)] * scale
    period_us = (r[word(TIM1, TIM_ARR)] + 1) * scale
    control = r[word(DAC, DAC_CR)]
    open_v = r[word(DAC, DAC_DHR12R1)] / 4095.0 * SET_V if control & 1 else 0.0
    peak_a = r[word(DAC, DAC_DHR12R2)] / 4095.0 * SET_A if control >> 16 & 1 else 0.0
    set_us = 0.0
    ends = r[word(TIM1, TIM_CCMR1)] & 0x80 and pin_is(r, PORT_E, 7, 2, 1)
    timed = r[word(TIM3, TIM_CR1)] & 8 and pin_is(r, PORT_C, 6, 2, 2) and pin_is(r, PORT_C, 7, 2, 2)
    if ends and timed and r[word(TIM3, TIM_SMCR)] & 7 == 6:
        set_us = r[word(TIM3, TIM_CCR2)] * (r[word(TIM3, TIM_PSC)] + 1) / 84.0
    off_us = period_us - on_us
    if 0.0 < off_us * 1000.0 < SWITCH_OFF_NS and on_us > 0.0:
        on_us = max(on_us, LONGEST_US - off_us)
    return on_us, off_us, open_v, peak_a, set_us
