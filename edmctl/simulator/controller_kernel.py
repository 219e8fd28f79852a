"""The controller's millisecond, compiled: `command_tick` (servo.py) begins it, `judge_tick` ends it.

It knows of the plant what `Readings` show, and tells it what stands in `Drive`: nothing here names the plant's own.
"""

from __future__ import annotations

import math

from edmctl.actuator.compiling import compiled
from edmctl.array_types import Array
from edmctl.simulator.controller_state import (
    ARC,
    DISPLACEMENT_FAILED_UM,
    NORMAL,
    NOTHING,
    OPEN,
    SHORT,
    LoopState,
    Settings,
)
from edmctl.simulator.gap_monitor import (
    CHARGE_MOST_UC,
    count_of,
    judge_pulses,
    measure_gap,
    rest_gap,
    wait_for_pulse,
    watch_monitor,
)
from edmctl.simulator.plant_interface import STEPS_PER_V, Drive, Readings
from edmctl.simulator.records import Rows
from edmctl.simulator.sequences import follow_path, sequence_tick

BOX_TICKS = 2048  # milliseconds in the fault recorder; a power of two
BOX_COLUMNS = 6


@compiled
def judge_tick(
    settings: Settings,
    loop: LoopState,
    drive: Drive,
    readings: Readings,
    box: Array,
    samples: Rows,
    blocks: Rows,
    pulses: Rows,
) -> int:
    """Look at the millisecond that ended, decide how to go on, record it; returns what happened."""
    happened = NOTHING
    charge = readings.charge_uc if abs(readings.charge_uc) <= CHARGE_MOST_UC else 0.0
    loop.charge_uc += charge
    if drive.pulses_on == 0:
        happened = rest_gap(loop, readings)
    elif readings.pulses == 0:
        loop.stray_ticks = 0
        happened = wait_for_pulse(settings, loop)
    else:
        loop.stray_ticks = 0
        shorts = judge_pulses(settings, loop, readings, blocks, pulses)
        happened = measure_gap(settings, loop, readings, shorts)
    displacement = readings.sensor_um
    if settings.sensor_missing == 1:
        displacement = drive.actuator_v / settings.v_per_um
    if not abs(displacement) < DISPLACEMENT_FAILED_UM:
        displacement = DISPLACEMENT_FAILED_UM
    loop.displacement_um = displacement
    if displacement >= DISPLACEMENT_FAILED_UM or loop.slow_displacement_um >= DISPLACEMENT_FAILED_UM:
        loop.slow_displacement_um = displacement  # nothing of a failed reading stays in the filter
    else:
        loop.slow_displacement_um += settings.displacement_alpha * (displacement - loop.slow_displacement_um)
    sequence = sequence_tick(settings, loop, drive, readings)
    if happened == NOTHING:
        happened = sequence
    if loop.watched == 1:
        voltage = watch_monitor(settings, loop, drive, readings)
        if voltage != NOTHING:
            happened = voltage
    if loop.scanning == 1 and happened == NOTHING:
        happened = follow_path(loop, drive)
    flags = flags_of(loop, drive, readings)
    row = box[readings.tick - 1 & (BOX_TICKS - 1)]
    row[0] = displacement
    row[1] = drive.actuator_v
    row[2] = loop.gap_v
    row[3] = charge
    row[4] = loop.tick_counts
    row[5] = loop.link_state * 256 + flags
    loop.contact |= readings.contact
    if readings.tick == loop.tlm_next:
        write_sample(settings, loop, drive, flags, samples)
    return happened


@compiled
def flags_of(loop: LoopState, drive: Drive, readings: Readings) -> int:
    """TlmFlags of now."""
    bits = drive.pulses_on | readings.contact << 1 | loop.shorted << 3 | loop.slewed << 5
    bits |= (loop.direction > 0) << 2 | (loop.limit_ticks > 0) << 4
    return int(bits)


@compiled
def write_sample(settings: Settings, loop: LoopState, drive: Drive, flags: int, samples: Rows) -> None:
    """Write a telemetry sample (record of the wire)."""
    loop.tlm_next += settings.tlm_ticks
    sample = samples[loop.tlm_n]
    sample.displacement_um = math.floor(loop.displacement_um * 1000.0 + 0.5)
    sample.actuator_v = int(drive.actuator_v * STEPS_PER_V + 0.5)
    sample.gap_v = max(0, min(65535, int(loop.gap_v * 200.0 + 0.5)))
    mean_a = loop.charge_uc / (settings.tlm_ticks * 1000.0)
    sample.current_a = max(0, min(65535, int(mean_a * 1000.0 + 0.5)))
    counts = loop.sample_counts
    sample.n_normal = min(255, count_of(counts, NORMAL))
    sample.n_arc = min(255, count_of(counts, ARC))
    sample.n_short = min(255, count_of(counts, SHORT))
    sample.n_open = min(255, count_of(counts, OPEN))
    sample.state = loop.link_state
    sample.flags = flags | loop.contact << 1
    loop.tlm_n += 1
    loop.charge_uc = 0.0
    loop.contact = 0
    loop.sample_counts = 0
