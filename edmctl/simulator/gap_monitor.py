"""What the controller makes of the gap: classes of pulses by what is seen of them, the filtered voltage, the faults.

A pulse is judged by its ignition delay, plateau voltage and current flag alone.
"""

from __future__ import annotations

from edmctl.actuator.compiling import compiled
from edmctl.simulator.controller_state import (
    ARC,
    DISPLACEMENT_FAILED_UM,
    FAULT_ARC,
    FAULT_GAP_SENSOR,
    FAULT_GENERATOR,
    FAULT_MONITOR,
    FAULT_NO_SPARK,
    FAULT_SHORT,
    FAULT_TRACK,
    LOG_FULL,
    LOG_OFF,
    NORMAL,
    NOTHING,
    OPEN,
    PACK,
    SHORT,
    TOUCH_BACK,
    TOUCH_FAST,
    LoopState,
    Settings,
)
from edmctl.simulator.plant_interface import TICK_NS, Drive, Readings
from edmctl.simulator.records import Rows

MISREAD_HIGH = 0.97  # of the open voltage: more is none that a discharge has
GAP_MOST_V = 1000.0  # beyond it no gap voltage is one
CHARGE_MOST_UC = 1e6  # beyond it, either way, none is the charge of a millisecond
CURRENT_MOST_A = 1000.0  # below minus this no current is one
CHARGE_NOISE_UC = 2.0  # 2 mA for the millisecond: below minus this it is no noise
SILENCE_NS = 100_000_000  # beyond a period, in which pulses must come while they are on
PAIR_NS, PAIR_PERIODS = 10_000_000, 10  # added up: sparks no farther apart are no chance of an open gap
SPARK_STEP_UM = 5.0  # no spark is farther beyond the last one, and where the tool slowly reads to be
MISREAD_LOW = 0.5  # of the open voltage: less is none that an open gap has


@compiled
def judge_pulses(
    settings: Settings,
    loop: LoopState,
    readings: Readings,
    blocks: Rows,
    pulses: Rows,
) -> int:
    """Give every pulse of the tick its class, count and log it; returns how many were shorts."""
    high_v, low_v = MISREAD_HIGH * settings.open_v, MISREAD_LOW * settings.open_v
    short_v, arc_v, arc_delay = settings.short_v, settings.arc_v, settings.arc_delay_us
    misreads, arc_run, counts, shorts = loop.misreads, loop.arc_run, 0, 0
    logs = settings.pulse_log != LOG_OFF
    for i in range(readings.pulses):
        seen_v = readings.plateau_v[i]
        pulse_class = NORMAL
        if readings.discharge_us[i] <= 0.0:
            pulse_class = OPEN
            if not seen_v >= low_v:
                misreads += 1
            arc_run = 0
        elif seen_v < short_v:
            pulse_class = SHORT
            shorts += 1
            arc_run = 0
        elif seen_v < arc_v and not readings.delay_us[i] >= arc_delay:
            pulse_class = ARC
            arc_run += 1
        else:
            # Arcs and shorts say neither that the sensor is right nor that it is wrong.
            misreads = 0 if seen_v <= high_v else misreads + 1
            arc_run = 0
        counts += 1 << (PACK * pulse_class)
        if logs:
            log_pulse(settings, loop, readings, i, pulse_class, blocks, pulses)
    loop.misreads, loop.arc_run, loop.tick_counts = misreads, arc_run, counts
    loop.sample_counts += counts
    loop.pulse_no += readings.pulses
    return shorts


@compiled
def count_of(counts: int, pulse_class: int) -> int:
    """Pulses of one class in packed counts."""
    return (counts >> (PACK * pulse_class)) & ((1 << PACK) - 1)


@compiled
def log_pulse(
    settings: Settings,
    loop: LoopState,
    readings: Readings,
    i: int,
    pulse_class: int,
    blocks: Rows,
    pulses: Rows,
) -> None:
    """Add one pulse to the log asked for: a record each, or sums over blocks (records of the wire)."""
    if loop.log_n == 0 and loop.block_count == 0:
        loop.log_pulse_no = loop.pulse_no + i
        loop.log_t0_ns = readings.first_pulse_ns + i * settings.pulse_period_ns
    if settings.pulse_log == LOG_FULL:
        entry = pulses[loop.log_n]
        entry.pulse_class = pulse_class
        entry.delay_us = min(65535, int(readings.delay_us[i] * 10.0 + 0.5))
        entry.discharge_us = min(65535, int(readings.discharge_us[i] * 10.0 + 0.5))
        entry.plateau_v = max(0, min(255, int(readings.plateau_v[i] * 2.0 + 0.5)))
        loop.log_n += 1
        return
    loop.block_counts += 1 << (PACK * pulse_class)
    loop.delay_sum_us += readings.delay_us[i]
    loop.energy_sum_uj += readings.energy_uj[i]
    loop.block_count += 1
    if loop.block_count == settings.block_size:
        close_block(loop, blocks)


@compiled
def close_block(loop: LoopState, blocks: Rows) -> None:
    """Write the block record begun, if any."""
    if loop.block_count == 0:
        return
    entry = blocks[loop.log_n]
    entry.n_open = count_of(loop.block_counts, OPEN)
    entry.n_normal = count_of(loop.block_counts, NORMAL)
    entry.n_arc = count_of(loop.block_counts, ARC)
    entry.n_short = count_of(loop.block_counts, SHORT)
    entry.delay_us = int(loop.delay_sum_us * 10.0 + 0.5)
    entry.energy_uj = max(0, int(loop.energy_sum_uj * 10.0 + 0.5))
    loop.delay_sum_us = 0.0
    loop.energy_sum_uj = 0.0
    loop.block_count = 0
    loop.block_counts = 0
    loop.log_n += 1


@compiled
def measure_gap(settings: Settings, loop: LoopState, readings: Readings, shorts: int) -> int:
    """Feed the low-pass with this tick's mean gap voltage and keep the counters of the discharge faults.

    Between slow pulses ticks pass without one; the next pulse then speaks for all of them.
    """
    elapsed = loop.silent_ticks + 1
    loop.silent_ticks = 0
    mean_v = readings.gap_v
    if not abs(mean_v) <= GAP_MOST_V:
        return FAULT_GAP_SENSOR
    loop.tick_gap_v = mean_v
    keep = 1.0 - settings.filter_alpha
    loop.gap_v = mean_v + (loop.gap_v - mean_v) * (keep if elapsed == 1 else keep**elapsed)
    if shorts == readings.pulses:
        loop.shorted = 1
        loop.short_ticks += elapsed
    else:
        loop.shorted = 0
        loop.short_ticks = 0
    loop.sparkless_ticks += elapsed
    if count_of(loop.tick_counts, OPEN) == readings.pulses:
        # Open pulses on the way back from a retraction are no loss: only those at the last spark count.
        if loop.slow_displacement_um >= loop.last_spark_um - 1.0:
            loop.open_ticks += elapsed
    else:
        note_sparks(settings, loop)
    if loop.misreads >= settings.misreads_max:
        return FAULT_GAP_SENSOR
    # Current over voltage drop in a discharge is the conductance that the generator really has. A current sensor
    # that is turned round sees nothing of it.
    if (
        not -CHARGE_NOISE_UC <= readings.charge_uc <= CHARGE_MOST_UC
        or not -CURRENT_MOST_A <= readings.off_time_a <= 0.0
        or not abs(readings.generator_siemens) <= settings.over_current * settings.nominal_siemens
    ):
        return FAULT_GENERATOR
    if loop.short_ticks > settings.short_ticks_max:
        return FAULT_SHORT
    if loop.arc_run >= settings.arc_run_max:
        return FAULT_ARC
    return NOTHING


@compiled
def note_sparks(settings: Settings, loop: LoopState) -> None:
    """A millisecond with sparks: with others shortly before it the count of open ones begins anew where they are.

    One by itself is a chance that an open gap has too. The slow reading lags behind a tool that comes back from a
    jump; a single fast one may be anything.
    """
    again = loop.sparkless_ticks * TICK_NS <= PAIR_NS + PAIR_PERIODS * settings.pulse_period_ns
    loop.sparkless_ticks = 0
    if not again:
        return
    loop.open_ticks = 0
    if loop.displacement_um < DISPLACEMENT_FAILED_UM:
        farthest_um = max(loop.slow_displacement_um, loop.last_spark_um) + SPARK_STEP_UM
        loop.last_spark_um = min(loop.displacement_um, farthest_um)


@compiled
def rest_gap(loop: LoopState, readings: Readings) -> int:
    """A millisecond without pulses, in which the gap sensor should read nothing.

    Pulses that come all the same are those of a generator that does not switch off; in the first such millisecond
    the gate may have been shut.
    """
    loop.tick_counts = 0
    loop.tick_gap_v = 0.0
    if readings.gap_v >= 0.0:
        loop.tick_gap_v = loop.gap_v = min(readings.gap_v, GAP_MOST_V)
    touches = TOUCH_FAST <= loop.mode <= TOUCH_BACK  # pulses that reach a touch are the mode switch's
    stray = readings.pulses > 0 or (readings.stray_pulses > 0 and not touches)
    loop.stray_ticks = loop.stray_ticks + 1 if loop.watched == 1 and stray else 0
    return FAULT_GENERATOR if loop.stray_ticks > 1 else NOTHING


@compiled
def wait_for_pulse(settings: Settings, loop: LoopState) -> int:
    """A millisecond with the generator on in which no pulse began: between slow pulses one like others."""
    loop.tick_counts = 0
    loop.silent_ticks += 1
    if loop.silent_ticks * TICK_NS > SILENCE_NS + settings.pulse_period_ns:
        return FAULT_NO_SPARK
    return NOTHING


@compiled
def watch_monitor(settings: Settings, loop: LoopState, drive: Drive, readings: Readings) -> int:
    """Look at the voltage monitor of the actuator's amplifier: in its range, and near the command?"""
    monitor_v = readings.monitor_v
    if not settings.monitor_min_v <= monitor_v <= settings.monitor_max_v:
        return FAULT_MONITOR
    if abs(drive.actuator_v - monitor_v) > settings.track_v:
        loop.track_ticks = loop.track_ticks + 1 if loop.track_at == readings.tick - 1 else 1
        loop.track_at = readings.tick
        if loop.track_ticks >= settings.track_ticks_max:
            return FAULT_TRACK
    return NOTHING
