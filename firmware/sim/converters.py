"""The analog side: what ADC1 and ADC2 sample of the gap at 1 MHz, and ADC3 of everything slow at 16 kHz."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.simulator.plant_records import SCOPE_PULSES
from edmctl.simulator.waveforms import CURRENT_NOISE_A, PLATEAU_NOISE, VOLTAGE_NOISE_V

from .addresses import (
    ADC,
    ADC2,
    ADC3,
    ADC_CCR,
    ADC_CDR,
    ADC_CR1,
    ADC_CR2,
    ADC_DR,
    ADC_SMPR2,
    ADC_SQR1,
    ADC_SQR3,
    DMA2,
    PORT_C,
    TIM4,
    TIM8,
    TIM_ARR,
    TIM_CCER,
    TIM_CR1,
    TIM_CR2,
    TIM_PSC,
    address,
    word,
)
from .circuit import DISPLACEMENT_UM, FLOW_LPM, GAP_A, GAP_V, MONITOR_V, TEMPERATURE_C
from .compiling import compiled
from .dma import carry_words, put, takes
from .pins import pin_is
from .pulse_shape import pulse_at, pulse_ends
from .registers import SAMPLES_FROM, SCAN_FROM, SCAN_PHASE, SCANS_END

if TYPE_CHECKING:
    from edmctl.array_types import Array
    from edmctl.simulator.plant_records import Readings, Scope, Unit

    from .circuit import Bench

SAMPLES_PER_MS = 1000
LONGEST_NS = 1e9  # that a pulse is seen
NOISE = 8192
"""Random numbers of the converters, used in a ring, a power of two; those of a millisecond more repeat the first."""
_FAST_AT, _SLOW_AT = address(ADC, ADC_CDR), address(ADC, ADC3 + ADC_DR)
_CC4E = 1 << 12
_FULL = 4096.0  # counts at 3.3 V
CONVERTER_NOISE = 1.0  # counts, rms, of the slow converter [assumed]


@compiled
def count(value: float, low: float, high: float, noise: float) -> int:
    """Count of a 12-bit converter; what is no number stands at its rail."""
    if math.isnan(value):
        return 0
    return int(min(4095.0, max(0.0, (value - low) / (high - low) * _FULL + noise + 0.5)))


@compiled
def converts(r: np.ndarray) -> bool:
    """Whether ADC1 and ADC2 convert gap voltage and current at 1 MHz (RM0090 §13.9.2, 13.13)."""
    timer = r[word(TIM8, TIM_CR1)] & 1 and r[word(TIM8, TIM_CR2)] & 0x70 == 0x20
    if not timer or (r[word(TIM8, TIM_PSC)] + 1) * (r[word(TIM8, TIM_ARR)] + 1) != 168:
        return False
    first, second, common = r[word(ADC, ADC_CR2)], r[word(ADC, ADC2 + ADC_CR2)], r[word(ADC, ADC_CCR)]
    triggered = first >> 28 & 3 == 1 and first >> 24 & 15 == 14
    dual = common & 0x1F == 6 and common >> 14 & 3 == 2 and common >> 13 & 1
    # 84 MHz over 2, 4, 6 or 8: at most 36 MHz, and 12 + 3 clocks in less than 1 µs.
    quick = common >> 16 & 3 == 1 and r[word(ADC, ADC_SMPR2)] == 0 and r[word(ADC, ADC2 + ADC_SMPR2)] == 0
    inputs = r[word(ADC, ADC_SQR3)] & 31 == 10 and r[word(ADC, ADC2 + ADC_SQR3)] & 31 == 13
    pins = pin_is(r, PORT_C, 0, 3, 0) and pin_is(r, PORT_C, 3, 3, 0)
    return bool(first & 1 and second & 1 and triggered and dual and quick and inputs and pins)


@compiled
def sample_behind(ns: float) -> int:
    """The first sample of the millisecond that is not before a time in it."""
    return int(min(float(SAMPLES_PER_MS), max(0.0, math.ceil(ns * 1e-3))))


@compiled
def sample_gap(
    r: np.ndarray,
    memory: np.ndarray,
    bench: Bench,
    unit: Unit,
    scope: Scope,
    readings: Readings,
    noise: Array,
    begin_ns: float,
) -> None:
    """A thousand samples of gap voltage and current: what an oscilloscope would show of the newest pulses."""
    if not converts(r) or bench.adc_stuck:
        return
    newest = scope.at
    oldest = max(0, newest - SCOPE_PULSES)
    at = max(oldest, newest - readings.pulses)
    # The pulse that was under way when the millisecond began, if there is one.
    if at > oldest and scope.start_ns[(at - 1) & (SCOPE_PULSES - 1)] < begin_ns:
        at -= 1
    n, bench.noise_at = bench.noise_at, (bench.noise_at + 2 * SAMPLES_PER_MS) & (NOISE - 1)
    first, r[SAMPLES_FROM] = r[SAMPLES_FROM] // 168, 0
    if not takes(r, DMA2, 4, 0, _FAST_AT, 4):
        return
    has_rest_v = not bench.was_on and readings.gap_v > 0.0  # from elsewhere
    rest_v = readings.gap_v if has_rest_v else 0.0
    open_v = unit.open_v
    volts, amperes = np.full(SAMPLES_PER_MS, rest_v), np.zeros(SAMPLES_PER_MS)
    lively = np.full(SAMPLES_PER_MS, VOLTAGE_NOISE_V)
    while 0 <= at < newest:
        place = at & (SCOPE_PULSES - 1)
        start, plateau, stuck = scope.start_ns[place], scope.plateau_v[place], scope.stuck_v[place]
        begin, end = sample_behind(start - begin_ns), sample_behind(start + LONGEST_NS - begin_ns)
        at += 1
        if at < newest:
            end = min(end, sample_behind(scope.start_ns[at & (SCOPE_PULSES - 1)] - begin_ns))
        opens = min(unit.on_time_us, scope.delay_us[place] + scope.discharge_us[place])
        leak = scope.leak_a[place] if scope.discharge_us[place] > 0.0 else 0.0
        if start < bench.off_ns:
            opens, leak = min(opens, (bench.off_ns - start) * 1e-3), 0.0
        delay = min(scope.delay_us[place], opens)
        current = (open_v - plateau) * scope.siemens[place]
        ends = pulse_ends(open_v, delay, opens, plateau, current)
        for i in range(max(begin, first), end):
            t = i + (begin_ns - start) * 1e-3
            v, amps = pulse_at(t, open_v, delay, opens, plateau, current, ends)
            volts[i] = stuck if stuck >= 0.0 else v * unit.gap_wire
            amperes[i] = amps + leak if t >= opens else amps
            if delay <= t < opens:
                lively[i] += PLATEAU_NOISE * plateau
    words = np.empty(SAMPLES_PER_MS, np.uint32)
    for i in range(SAMPLES_PER_MS):
        v = (volts[i] + lively[i] * noise[n + 2 * i]) * (_FULL / GAP_V) + 0.5
        amps = (amperes[i] + CURRENT_NOISE_A * noise[n + 2 * i + 1]) * (_FULL / GAP_A) + 0.5
        words[i] = np.uint32(min(4095.0, max(0.0, v))) | np.uint32(min(4095.0, max(0.0, amps))) << 16
    carry_words(r, memory, DMA2, 4, words[first:])


@compiled
def sample_slow(r: np.ndarray, memory: np.ndarray, bench: Bench, readings: Readings, noise: Array) -> None:
    """Sixteen scans of ADC3: monitor, displacement, temperature, flow (RM0090 §13.3.6, 13.8.1).

    Of the one in whose middle its stream was started, the rest comes.
    """
    r[SCAN_PHASE], r[SCANS_END] = bench.scan_phase, 0
    rate = (r[word(TIM4, TIM_PSC)] + 1) * (r[word(TIM4, TIM_ARR)] + 1)
    timer = r[word(TIM4, TIM_CR1)] & 1 and r[word(TIM4, TIM_CCER)] & _CC4E and rate == 84_000_000 // 16_000
    control = r[word(ADC, ADC3 + ADC_CR2)]
    set_up = (
        control & 0x301 == 0x301
        and control >> 28 & 3 != 0
        and control >> 24 & 15 == 9
        and r[word(ADC, ADC3 + ADC_CR1)] & 0x100
        and r[word(ADC, ADC3 + ADC_SQR1)] >> 20 & 15 == 3
        and r[word(ADC, ADC3 + ADC_SQR3)] & 0xFFFFF == 9 | 15 << 5 | 8 << 10 | 14 << 15
    )
    if not (timer and set_up) or bench.slow_stuck:
        return
    n = bench.noise_at
    bench.noise_at = (n + 64) & (NOISE - 1)
    first, r[SCAN_FROM] = r[SCAN_FROM], 0
    for k in range(16):
        for i in range(first if k == 0 else 0, 4):
            x = CONVERTER_NOISE * noise[n]
            n += 1
            if i == 0:
                value = count(readings.monitor_v, MONITOR_V[0], MONITOR_V[1], x)
            elif i == 1:
                value = count(readings.sensor_um, DISPLACEMENT_UM[0], DISPLACEMENT_UM[1], x)
            elif i == 2:
                value = count(bench.temperature_c, 0.0, TEMPERATURE_C, x)
            else:
                value = count(bench.flow_lpm, 0.0, FLOW_LPM, x)
            put(r, memory, DMA2, 0, 2, _SLOW_AT, 2, value)
