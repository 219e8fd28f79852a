"""What the pins are wired to, and what takes time: a millisecond of converters, timers, DMA and line over the plant.

The pins and scales are those of firmware/board/stm32f4/pins.h and firmware/board/scale.h, written here once more from the
circuit's side. A peripheral that the image has not set up rightly does not work here either.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.compiling import cached, compiled
from edmctl.link.messages import Heartbeat, PulseBlocks, Pulses, Tlm
from edmctl.simulator.plant_interface import TICK_NS
from edmctl.simulator.plant_kernel import follow_drive, plant_tick
from edmctl.simulator.plant_state import SCOPE_PULSES
from edmctl.simulator.records import Record, record, series
from firmware_sim import registers as reg
from firmware_sim.registers import (
    ADC,
    ALIVE_EDGES,
    BASE_84,
    BIF,
    BKE,
    BKP,
    DAC,
    DAC_CODE,
    DMA1,
    DMA2,
    GATE_STARTS,
    HALFWORDS,
    IS_BROKEN,
    MOE,
    OFF_AT,
    PINS,
    PORT_A,
    PORT_C,
    PORT_D,
    PORT_E,
    PORT_F,
    PORT_G,
    RELOAD,
    SAMPLES_FROM,
    TIM1,
    TIM2,
    TIM3,
    TIM4,
    TIM5,
    TIM8,
    TIM10,
    TIM11,
    TIM13,
    USART3,
    word,
)

if TYPE_CHECKING:
    from edmctl.simulator.plant_interface import Drive, Readings
    from edmctl.simulator.plant_state import PlantState, Scope, Unit
    from edmctl.simulator.records import Floats

SRAM_AT, SRAM_BYTES = 0x20000000, 0x30000
QUEUE = 256
LINE_BYTES = 1 << 16
NOISE = 8192

# Scales of the circuit: volts, amperes, micrometres, degrees and litres a minute at 3.3 V, and at 0 V where it is not 0.
FULL = 4096.0
GAP_V, GAP_A = 330.0, 12.0
MONITOR_V = (-5.0, 165.0)
DISPLACEMENT_UM = (-50.0, 450.0)
TEMPERATURE_C, FLOW_LPM = 100.0, 5.0
SET_V, SET_A = 330.0, 12.0
DAC_V = 0.0025
STEP_UM, STEP_DEG = 0.1, 0.001
CONVERTER_NOISE = 1.0  # counts, rms, of the slow converter [assumed]
UNHURRIED = (Tlm.ID, Pulses.ID, PulseBlocks.ID, Heartbeat.ID | 0x40)
"""Types of frames that nobody waits for."""
STAGE_TICKS = 10  # the work under a moving tool is looked up so often
REST_TICKS = 3  # without a step: the stages have arrived
PUMP_TICKS = 3  # the charge pump of the high voltage holds so long [assumed]

RISE_US, BREAKDOWN_US, CURRENT_US, DECAY_US = 0.5, 0.1, 0.3, 2.0  # as simulator/fault_recorder.py has them
PLATEAU_NOISE, VOLTAGE_NOISE_V, CURRENT_NOISE_A = 0.025, 0.05, 0.0005
SWITCH_OFF_NS = 5000.0  # from MOE to the open switch; the protocol asks for 10 µs


@record
class Bench(Record):
    """What lies between chip and plant."""

    ticks: int  # since the chip's timers were started
    rate: int  # bytes of the line in 1000 s
    receives: int  # share of a byte that the line has left, of 1000 s
    sends: int
    rx_head: int  # bytes of `rx` before it are in the chip's ring
    rx_tail: int
    tx_size: int  # bytes in `tx`
    frame_bytes: int  # of the frame that is being sent, and its type
    frame_type: int
    urgent: int  # 1: a frame has gone out that somebody waits for
    line_low: int  # 1: something holds the line low
    alive_ticks: int  # since the pump last saw an edge
    alive_edges: int
    gate_starts: int
    was_on: int
    off_ns: float  # when the switch opened last, and pulses in flight ended
    noise_at: int
    queue_head: int  # of the pulses, in the order of their begin
    starts_at: int  # next pulse whose edge is to come, channel by channel
    ignitions_at: int
    ends_at: int
    had_contact: int
    chatters: int  # the contact's wire: 1: a closed contact bounces, 2: it does with an open one too
    estop: int
    door: int
    hv_ok: int
    level_ok: int
    limit: int
    over_current: int
    breaks: int  # 1: the chain opens and closes again before the program has looked
    flow_lpm: float
    temperature_c: float
    adc_stuck: int  # the fast converters say what they said
    slow_stuck: int  # and the slow one
    dac_dead: int  # the actuator's converter says nothing
    actuator_code: int
    moved: int  # 0: the stages rest; 1: steps have come; 2: and are over
    travels: int
    rest_ticks: int  # since the last step
    steps: Floats = series(3)  # of the stages, signed, since they were last taken
    start_ns: Floats = series(QUEUE)
    ignition_ns: Floats = series(QUEUE)  # no discharge: -1
    end_ns: Floats = series(QUEUE)


@compiled
def pin_is(r: np.ndarray, port: int, pin: int, mode: int, function: int) -> bool:
    """Whether a pin has a mode (RM0090 §8.4.1) and, for mode 2, an alternate function."""
    if r[word(port, 0)] >> 2 * pin & 3 != mode:
        return False
    return mode != 2 or r[word(port, 0x20 if pin < 8 else 0x24)] >> 4 * (pin & 7) & 15 == function


@compiled
def gate_is_on(r: np.ndarray) -> bool:
    """Whether TIM1 drives the gate: PWM mode 1, output enabled, counter running, main output (RM0090 §17.3.9, 17.4)."""
    runs = r[word(TIM1, 0)] & 1 and r[word(TIM1, 0x20)] & 3 == 1 and r[word(TIM1, 0x18)] & 0x73 == 0x60
    return bool(runs and r[word(TIM1, 0x44)] & MOE and pin_is(r, PORT_E, 9, 2, 1))


@compiled
def put(
    r: np.ndarray, memory: np.ndarray, dma: int, stream: int, channel: int, source: int, size: int, value: int
) -> None:
    """One request of a peripheral: the stream carries the value to the memory (RM0090 §10.3)."""
    control = word(dma, 0x10 + 0x18 * stream)
    cr = r[control]
    if not cr & 1 or cr >> 25 & 7 != channel or cr >> 6 & 3 != 0 or r[control + 2] != source:
        return
    width = size >> 1  # 0, 1, 2: bytes, halfwords, words
    if cr >> 13 & 3 != width or cr >> 11 & 3 != width or not cr & 0x400:
        reg.note_error(r, source)
        return
    whole = r[RELOAD + stream + (8 if dma == DMA2 else 0)]
    left = r[control + 1]
    place = r[control + 3] + (whole - left) * size - SRAM_AT
    if place < 0 or place > SRAM_BYTES - size:
        reg.note_error(r, r[control + 3])  # no DMA reaches other memory (§2.3.1)
        return
    if size == 4:
        memory[place] = value & 255
        memory[place + 1] = value >> 8 & 255
        memory[place + 2] = value >> 16 & 255
        memory[place + 3] = value >> 24
    elif size == 2:
        memory[place] = value & 255
        memory[place + 1] = value >> 8 & 255
    else:
        memory[place] = value
    r[control + 1] = left - 1
    if left == 1:
        r[word(dma, 0 if stream < 4 else 4)] |= 0x20 << reg.FLAGS_AT[stream & 3]
        if cr & 0x100:
            r[control + 1] = whole
        else:
            r[control] = cr & ~1


@compiled
def count(value: float, low: float, high: float, noise: float) -> int:
    """Count of a 12-bit converter; what is no number stands at its rail."""
    if math.isnan(value):
        return 0
    return int(min(4095.0, max(0.0, (value - low) / (high - low) * FULL + noise + 0.5)))


# --------------------------------------------------------------------------------------------------------- pulses
@compiled
def take_pulses(bench: Bench, scope: Scope, readings: Readings) -> None:
    """Queue the edges of the pulses that the plant has struck in this millisecond."""
    for k in range(readings.pulses):
        at = (scope.at - readings.pulses + k) & (SCOPE_PULSES - 1)
        place = bench.queue_head & (QUEUE - 1)
        start = scope.start_ns[at]
        bench.start_ns[place] = start
        lit = scope.discharge_us[at] > 0.0
        bench.ignition_ns[place] = start + scope.delay_us[at] * 1e3 if lit else -1.0
        bench.end_ns[place] = start + (scope.delay_us[at] + scope.discharge_us[at]) * 1e3
        bench.queue_head += 1


@compiled
def send_edges(r: np.ndarray, memory: np.ndarray, bench: Bench, begin_ns: float) -> None:
    """Captures of TIM2 and TIM5 that fall into this millisecond (RM0090 §18.3.5); the timers began at `begin_ns` of 0."""
    end_ns = begin_ns + TICK_NS
    starts = (
        r[word(TIM5, 0)] & 1
        and r[word(TIM5, 0x20)] >> 12 & 11 == 1
        and r[word(TIM5, 0x1C)] >> 8 & 3 == 1
        and r[word(TIM5, 0x0C)] & 0x1000
        and pin_is(r, PORT_A, 3, 2, 2)
    )
    edges = (
        r[word(TIM2, 0)] & 1
        and r[word(TIM2, 0x20)] & 0xBB == 0x31
        and r[word(TIM2, 0x18)] & 0x303 == 0x201
        and pin_is(r, PORT_A, 0, 2, 1)
    )
    requests = r[word(TIM2, 0x0C)]
    base = r[BASE_84]
    while bench.starts_at < bench.queue_head:
        t = bench.start_ns[bench.starts_at & (QUEUE - 1)]
        if t >= end_ns:
            break
        if starts:
            stamp = (base + int((t - begin_ns) * 0.084)) & 0xFFFFFFFF
            put(r, memory, DMA1, 3, 6, 0x40000C40, 4, stamp)
        bench.starts_at += 1
    while bench.ignitions_at < bench.queue_head:
        place = bench.ignitions_at & (QUEUE - 1)
        t = bench.ignition_ns[place]
        if t >= end_ns or (t < 0.0 and bench.start_ns[place] >= end_ns):
            break
        if t >= 0.0 and edges and requests & 0x200 and not (bench.start_ns[place] < bench.off_ns <= t):
            put(r, memory, DMA1, 5, 3, 0x40000034, 4, (base + int((t - begin_ns) * 0.084)) & 0xFFFFFFFF)
        bench.ignitions_at += 1
    while bench.ends_at < bench.queue_head:
        place = bench.ends_at & (QUEUE - 1)
        t = bench.end_ns[place]
        if bench.start_ns[place] < bench.off_ns < t:
            t = max(bench.off_ns, begin_ns)
        if t >= end_ns or bench.start_ns[place] >= end_ns:
            break
        if (
            bench.ignition_ns[place] >= 0.0
            and edges
            and requests & 0x400
            and not (bench.start_ns[place] < bench.off_ns <= bench.ignition_ns[place])
        ):
            put(r, memory, DMA1, 6, 3, 0x40000038, 4, (base + int((t - begin_ns) * 0.084)) & 0xFFFFFFFF)
        bench.ends_at += 1


@compiled
def converts(r: np.ndarray) -> bool:
    """Whether ADC1 and ADC2 convert gap voltage and current at 1 MHz (RM0090 §13.9.2, 13.13)."""
    timer = r[word(TIM8, 0)] & 1 and r[word(TIM8, 4)] & 0x70 == 0x20
    if not timer or (r[word(TIM8, 0x28)] + 1) * (r[word(TIM8, 0x2C)] + 1) != 168:
        return False
    first, second, common = r[word(ADC, 8)], r[word(ADC, 0x108)], r[word(ADC, 0x304)]
    triggered = first >> 28 & 3 == 1 and first >> 24 & 15 == 14
    dual = common & 0x1F == 6 and common >> 14 & 3 == 2 and common >> 13 & 1
    # 84 MHz over 2, 4, 6 or 8: at most 36 MHz, and 12 + 3 clocks in less than 1 µs.
    quick = common >> 16 & 3 == 1 and r[word(ADC, 0x10)] == 0 and r[word(ADC, 0x110)] == 0
    inputs = r[word(ADC, 0x34)] & 31 == 10 and r[word(ADC, 0x134)] & 31 == 13
    pins = pin_is(r, PORT_C, 0, 3, 0) and pin_is(r, PORT_C, 3, 3, 0)
    return bool(first & 1 and second & 1 and triggered and dual and quick and inputs and pins)


@compiled
def sample_gap(
    r: np.ndarray,
    memory: np.ndarray,
    bench: Bench,
    unit: Unit,
    scope: Scope,
    readings: Readings,
    noise: Floats,
    begin_ns: float,
) -> None:
    """A thousand samples of gap voltage and current: what an oscilloscope would show of the newest pulses."""
    if not converts(r) or bench.adc_stuck:
        return
    newest = scope.at
    oldest = max(0, newest - SCOPE_PULSES)
    at = newest - readings.pulses
    # The pulse that was under way when the millisecond began, if there is one.
    if at > oldest and scope.start_ns[(at - 1) & (SCOPE_PULSES - 1)] < begin_ns:
        at -= 1
    while at < newest and scope.start_ns[at & (SCOPE_PULSES - 1)] < begin_ns - 2e9:
        at += 1
    open_v, on_us = unit.open_v, unit.on_time_us
    n = bench.noise_at
    k = r[SAMPLES_FROM] // 168
    r[SAMPLES_FROM] = 0
    while k < 1000:
        t_ns = begin_ns + k * 1000.0
        while at + 1 < newest and scope.start_ns[(at + 1) & (SCOPE_PULSES - 1)] <= t_ns:
            at += 1
        v, a, lively = 0.0, 0.0, VOLTAGE_NOISE_V
        place = at & (SCOPE_PULSES - 1)
        start = scope.start_ns[place]
        if at < newest and at >= 0 and 0.0 <= t_ns - start < 1e9:
            t = (t_ns - start) * 1e-3
            delay, burns, plateau = scope.delay_us[place], scope.discharge_us[place], scope.plateau_v[place]
            opens = min(on_us, delay + burns)
            if start < bench.off_ns:
                opens = min(opens, (bench.off_ns - start) * 1e-3)
            delay = min(delay, opens)
            current = (open_v - plateau) * scope.siemens[place]
            if t < delay:
                v = open_v if t > 5.0 else open_v * (1.0 - math.exp(-t / RISE_US))
            elif t < opens:
                lit = open_v if delay > 5.0 else open_v * (1.0 - math.exp(-delay / RISE_US))
                since = t - delay
                v = plateau if since > 2.0 else plateau + (lit - plateau) * math.exp(-since / BREAKDOWN_US)
                a = current if since > 3.0 else current * (1.0 - math.exp(-since / CURRENT_US))
                lively += PLATEAU_NOISE * plateau
            else:
                since = t - opens
                if since < 20.0:
                    last_v = open_v if delay > 5.0 else open_v * (1.0 - math.exp(-delay / RISE_US))
                    if opens > delay:
                        last_v = plateau + (last_v - plateau) * math.exp(-(opens - delay) / BREAKDOWN_US)
                        a = (
                            current
                            * (1.0 - math.exp(-(opens - delay) / CURRENT_US))
                            * math.exp(-since / CURRENT_US)
                        )
                    v = last_v * math.exp(-since / DECAY_US)
                if burns > 0.0 and scope.leak_a[place] > 0.0 and not start < bench.off_ns:
                    a += scope.leak_a[place]
            v *= unit.gap_wire
            if scope.stuck_v[place] >= 0.0:
                v = scope.stuck_v[place]
        elif not bench.was_on and readings.gap_v > 0.0:  # a gap at rest, with a voltage from elsewhere
            v = readings.gap_v
        volts = count(v + lively * noise[n & (NOISE - 1)], 0.0, GAP_V, 0.0)
        amperes = count(a + CURRENT_NOISE_A * noise[n + 1 & (NOISE - 1)], 0.0, GAP_A, 0.0)
        n += 2
        put(r, memory, DMA2, 4, 0, 0x40012308, 4, volts | amperes << 16)
        k += 1
    bench.noise_at = n


@compiled
def sample_slow(r: np.ndarray, memory: np.ndarray, bench: Bench, readings: Readings, noise: Floats) -> None:
    """Sixteen scans of ADC3: monitor, displacement, temperature, flow (RM0090 §13.3.6, 13.8.1)."""
    rate = (r[word(TIM4, 0x28)] + 1) * (r[word(TIM4, 0x2C)] + 1)
    timer = r[word(TIM4, 0)] & 1 and r[word(TIM4, 0x20)] & 0x1000 and rate == 84_000_000 // 16_000
    control = r[word(ADC, 0x208)]
    set_up = (
        control & 0x301 == 0x301
        and control >> 28 & 3 != 0
        and control >> 24 & 15 == 9
        and r[word(ADC, 0x204)] & 0x100
        and r[word(ADC, 0x22C)] >> 20 & 15 == 3
        and r[word(ADC, 0x234)] & 0xFFFFF == 9 | 15 << 5 | 8 << 10 | 14 << 15
    )
    if not (timer and set_up) or bench.slow_stuck:
        return
    n = bench.noise_at
    for _ in range(16):
        for i in range(4):
            x = CONVERTER_NOISE * noise[n & (NOISE - 1)]
            n += 1
            if i == 0:
                value = count(readings.monitor_v, MONITOR_V[0], MONITOR_V[1], x)
            elif i == 1:
                value = count(readings.sensor_um, DISPLACEMENT_UM[0], DISPLACEMENT_UM[1], x)
            elif i == 2:
                value = count(bench.temperature_c, 0.0, TEMPERATURE_C, x)
            else:
                value = count(bench.flow_lpm, 0.0, FLOW_LPM, x)
            put(r, memory, DMA2, 0, 2, 0x4001224C, 2, value)
    bench.noise_at = n


# ----------------------------------------------------------------------------------------------------------- line
@compiled
def baud_of(r: np.ndarray) -> float:
    """Baud of USART3 (RM0090 §30.3.4), 0 where it does not work."""
    control, divider = r[word(USART3, 0x0C)], r[word(USART3, 8)]
    if control & 0x200C != 0x200C or divider == 0:
        return 0.0
    if control & 0x8000:
        divider = (divider & 0xFFF0) + 2 * (divider & 7)
    return 42e6 / divider


@compiled
def note_frame(bench: Bench, value: int) -> None:
    """Follow the frames that go out: the type is the byte behind COBS's first."""
    if value == 0:
        if bench.frame_bytes > 2 and not (
            bench.frame_type == UNHURRIED[0]
            or bench.frame_type == UNHURRIED[1]
            or bench.frame_type == UNHURRIED[2]
            or bench.frame_type == UNHURRIED[3]
        ):
            bench.urgent = 1
        bench.frame_bytes = 0
        return
    bench.frame_bytes += 1
    if bench.frame_bytes == 2:
        bench.frame_type = value


@compiled
def carry_line(r: np.ndarray, memory: np.ndarray, bench: Bench, rx: np.ndarray, tx: np.ndarray) -> None:
    """A millisecond of the line, both ways, at its pace. At another baud nothing arrives whole."""
    share = bench.rate
    baud = baud_of(r)
    fits = (
        abs(baud * 100.0 - share) < 0.03 * share and pin_is(r, PORT_D, 8, 2, 7) and pin_is(r, PORT_D, 9, 2, 7)
    )
    bench.receives = min(bench.receives + share, 1_000_000 + share) if bench.rx_head < bench.rx_tail else 0
    while bench.receives >= 1_000_000 and bench.rx_head < bench.rx_tail:
        value = rx[bench.rx_head & (LINE_BYTES - 1)]
        bench.rx_head += 1
        bench.receives -= 1_000_000
        if not fits:
            value ^= 0xA5
        if r[word(USART3, 0x14)] & 0x40:
            put(r, memory, DMA1, 1, 4, 0x40004804, 1, value)
    if bench.line_low:
        r[word(USART3, 0)] |= 2
    control = word(DMA1, 0x10 + 0x18 * 4)
    cr = r[control]
    if not cr & 1:
        bench.sends = 0
        return
    if (
        cr >> 25 & 7 != 7
        or cr >> 6 & 3 != 1
        or r[control + 2] != 0x40004804
        or not r[word(USART3, 0x14)] & 0x80
    ):
        reg.note_error(r, 0x40026000 + 0x10 + 0x18 * 4)
        return
    bench.sends += share
    whole, left = r[RELOAD + 4], r[control + 1]
    while bench.sends >= 1_000_000 and left > 0:
        place = r[control + 3] + (whole - left) - SRAM_AT
        if place < 0 or place >= SRAM_BYTES:
            reg.note_error(r, r[control + 3])
            return
        value = memory[place] if fits else memory[place] ^ 0xA5
        if bench.tx_size < len(tx):
            tx[bench.tx_size] = value
            bench.tx_size += 1
        note_frame(bench, value)
        left -= 1
        bench.sends -= 1_000_000
    r[control + 1] = left
    if left == 0:
        r[control] = cr & ~1
        r[word(DMA1, 4)] |= 0x20


# ---------------------------------------------------------------------------------------------------- the millisecond
@compiled
def steps_of(r: np.ndarray, page: int, clock_khz: int, port_pin: int, function: int) -> int:
    """Step pulses of a millisecond: the timer's overflows since its last update event."""
    if not r[word(page, 0)] & 1 or r[word(page, 0x20)] & 3 != 1 or r[word(page, 0x34)] == 0:
        return 0
    if not pin_is(r, PORT_F, port_pin, 2, function) or r[word(page, 0x18)] & 0x70 != 0x60:
        return 0
    ticks = (r[word(page, 0x28)] + 1) * (r[word(page, 0x2C)] + 1)
    return int((clock_khz + ticks // 2) // ticks)


@compiled
def lead(r: np.ndarray, bench: Bench, drive: Drive) -> None:
    """What the pins tell the machine for the millisecond that begins."""
    if r[ALIVE_EDGES] != bench.alive_edges:
        bench.alive_edges = r[ALIVE_EDGES]
        bench.alive_ticks = 0
    else:
        bench.alive_ticks += 1
    chain_open = bench.estop or bench.door or bench.over_current
    r[IS_BROKEN] = 1 if chain_open else 0
    if (chain_open or bench.breaks) and r[word(TIM1, 0x44)] & BKE and not r[word(TIM1, 0x44)] & BKP:
        r[word(TIM1, 0x10)] |= BIF
        reg.gate_off(r)
    bench.breaks = 0
    if not bench.dac_dead:
        bench.actuator_code = r[DAC_CODE]
    drive.actuator_v = bench.actuator_code * DAC_V
    enabled = bench.alive_ticks <= PUMP_TICKS and bench.hv_ok
    machines = pin_is(r, PORT_F, 14, 1, 0) and r[word(PORT_F, 0x14)] >> 14 & 1
    on = gate_is_on(r) and enabled and machines
    if on and (not bench.was_on or r[GATE_STARTS] != bench.gate_starts):
        drive.pulse_starts += 1
    bench.gate_starts = r[GATE_STARTS]
    bench.was_on = 1 if on else 0
    drive.pulses_on = bench.was_on
    moves = False
    for axis in range(3):
        page, clock, function = (
            (TIM10, 168_000, 3) if axis == 0 else (TIM11, 168_000, 3) if axis == 1 else (TIM13, 84_000, 9)
        )
        n = steps_of(r, page, clock, 6 + axis, function)
        bench.steps[axis] += n if r[word(PORT_F, 0x14)] >> axis & 1 else -n
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
    r[PINS + 6] = (
        (0 if bench.estop else 1) | (0 if bench.door else 2) | (bench.hv_ok << 2) | (bench.level_ok << 3)
    )
    r[PINS + 6] |= 0 if bench.limit else 16
    closed = readings.contact if bench.chatters < 2 else 1
    if bench.chatters and bench.ticks * 2654435761 >> 31 & 1:
        closed = 0
    r[PINS + 5] = closed << 13
    r[PINS + 3] = 0 if bench.line_low else 1 << 9
    r[PINS + 4] = 0 if r[IS_BROKEN] else 1 << 15


@compiled
def run_millisecond(
    r: np.ndarray,
    memory: np.ndarray,
    bench: Bench,
    rx: np.ndarray,
    tx: np.ndarray,
    unit: Unit,
    plant: PlantState,
    scope: Scope,
    random: Floats,
    tables: Floats,
    noise: Floats,
    levels: Floats,
    hiss: Floats,
    drive: Drive,
    readings: Readings,
) -> bool:
    """The plant's millisecond and what the chip's peripherals see of it; true where somebody should look under the tool."""
    begin_ns = float(readings.tick) * TICK_NS
    if r[OFF_AT]:  # after the millisecond before had begun
        bench.off_ns = begin_ns - 0.0 + (r[OFF_AT] - 1) / 168.0 * 1e3 + SWITCH_OFF_NS
    lead(r, bench, drive)
    touches = 1 if (readings.contact == 1) != (unit.contact_inverted == 1) else 0
    if bench.had_contact and not touches and not drive.pulses_on:
        drive.contact_tests += 1
    bench.had_contact = touches
    look = follow_drive(unit, plant, drive, noise)
    gives_way = plant_tick(unit, plant, scope, drive, readings, random, tables, noise, levels)
    if drive.pulses_on:
        take_pulses(bench, scope, readings)
    r[BASE_84] = (bench.ticks * 84_000) & 0xFFFFFFFF
    send_edges(r, memory, bench, begin_ns)
    if readings.stray_pulses and not drive.pulses_on:
        for k in range(readings.stray_pulses):
            put(r, memory, DMA1, 3, 6, 0x40000C40, 4, (r[BASE_84] + 1000 * (k + 1)) & 0xFFFFFFFF)
    sample_gap(r, memory, bench, unit, scope, readings, hiss, begin_ns)
    sample_slow(r, memory, bench, readings, hiss)
    carry_line(r, memory, bench, rx, tx)
    show(r, bench, readings)
    if r[word(TIM5, 0)] & 1:
        bench.ticks += 1
    r[BASE_84] = (bench.ticks * 84_000) & 0xFFFFFFFF
    r[HALFWORDS] = 0
    return bool(look or gives_way)


@cached
def generator_of(r: np.ndarray) -> tuple[float, float, float, float, float]:
    """What TIM1, TIM3 and the DAC set the generator to: on and off time, µs, open voltage, peak current, discharge time, µs."""
    scale = (r[word(TIM1, 0x28)] + 1) / 168.0
    on_us = r[word(TIM1, 0x34)] * scale
    period_us = (r[word(TIM1, 0x2C)] + 1) * scale
    control = r[word(DAC, 0)]
    open_v = r[word(DAC, 0x08)] / 4095.0 * SET_V if control & 1 else 0.0
    peak_a = r[word(DAC, 0x14)] / 4095.0 * SET_A if control >> 16 & 1 else 0.0
    set_us = 0.0
    ends = r[word(TIM1, 0x18)] & 0x80 and pin_is(r, PORT_E, 7, 2, 1)
    timed = r[word(TIM3, 0)] & 8 and pin_is(r, PORT_C, 6, 2, 2) and pin_is(r, PORT_C, 7, 2, 2)
    if ends and timed and r[word(TIM3, 8)] & 7 == 6:
        set_us = r[word(TIM3, 0x38)] * (r[word(TIM3, 0x28)] + 1) / 84.0
    return on_us, period_us - on_us, open_v, peak_a, set_us
