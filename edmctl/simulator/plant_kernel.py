"""The plant's millisecond, compiled: actuator, contact, gap and its discharges, erosion, sensors, stages.

It knows nothing of the controller but `Drive`, and shows it nothing but `Readings`. `unit` and `state` are its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.actuator.compiling import cached, compiled
from edmctl.array_types import Array
from edmctl.process.erosion import SURFACE_UM
from edmctl.process.gap_conditions import CLEARING
from edmctl.simulator.discharge import strike_pulses
from edmctl.simulator.plant_interface import PATH_LINES, TICK_S, Drive, Readings
from edmctl.simulator.plant_state import STUCK_AT_GENERATOR, PlantState, Scope, Unit

FLUSH_THROUGH_S = 0.02  # debris clearance of a gap that is all open below [assumed]
BEND_PER_UM, BEND_AT = 0.004, 0.8  # where over the stroke the sensor's bend lies
LEAST_GAP_V = 1.0  # a gap sensor tells no voltage below this from none
STAGE_STEP_UM = 2.5  # way of the stages after which the work under the tool is another


@compiled
def plant_tick(
    unit: Unit,
    state: PlantState,
    scope: Scope,
    drive: Drive,
    readings: Readings,
    random: Array,
    tables: Array,
    noise: Array,
    levels: Array,
) -> bool:
    """One millisecond; true where the sheet gave way, so that somebody should look what lies under the tool now."""
    tick = readings.tick
    actuator_tick(unit, state, drive.actuator_v)
    reach = state.surface_um + state.depth_um + state.wear_um
    excess = state.free_z_um - reach
    # The work stops the tool, all but its own compliance.
    true_z = state.free_z_um if excess <= 0.0 else reach + unit.contact_compliance * excess
    state.true_z_um = true_z
    reached = unit.contact_open == 0 and unit.mode_stuck != STUCK_AT_GENERATOR
    closed = excess >= -state.asperity_um and reached
    readings.contact = 1 if closed != (unit.contact_inverted == 1) else 0
    opening = reach - true_z - unit.free_gap_um
    if opening > 0.0 or state.opening_um != 0.0:
        pump(unit, state, opening)
    if tick & 63 == 0:  # depth changes by nanometres a tick
        drift_apart(unit, state)
        renew_clearing(unit, state)
        forget_craters(state)
    if drive.pulses_on == 1 and unit.gate_open == 0:
        strike_pulses(unit, state, scope, drive, readings, random, tables)
    else:
        rest(unit, state, drive, readings)
    gives_way = state.depth_um >= state.next_level_um and sink_levels(unit, state, levels)
    readings.sensor_um = unit.sensor_wire * sensor(unit, state, tick, noise)
    readings.monitor_v = unit.monitor_gain * state.amplifier_v + unit.monitor_zero_v
    readings.tick = tick + 1
    return bool(gives_way)


@cached
def run_plant(
    units: Sequence[Unit],
    plants: Sequence[PlantState],
    scopes: Sequence[Scope],
    random: Array,
    tables: Array,
    noise: Array,
    levels: Array,
    all_drives: Sequence[Drive],
    all_readings: Sequence[Readings],
) -> bool:
    """Advance the plant alone by a millisecond, for another controller; true where it should look under the tool."""
    unit, plant, drive, readings = units[0], plants[0], all_drives[0], all_readings[0]
    look = follow_drive(unit, plant, drive, noise)
    gives_way = plant_tick(unit, plant, scopes[0], drive, readings, random, tables, noise, levels)
    return look or gives_way


@compiled
def actuator_tick(unit: Unit, state: PlantState, applied_v: float) -> None:
    """One millisecond of the actuator: amplifier lag, play bank, envelope, creep bank, output-side mode.

    The free displacement follows the sum of the plays, bent by a tanh envelope, plus its creep.
    """
    driven_v = 0.0 if unit.dac_open == 1 else applied_v * unit.amplifier_gain
    u = driven_v + unit.amplifier_decay * (state.amplifier_v - driven_v)
    state.amplifier_v = u
    # Thresholds ascend, so the plays that a move drags along are always the first ones.
    threshold, weight, play = unit.play_threshold_v, unit.play_um_per_v, state.play_v
    y = state.play_sum_um
    for i in range(len(threshold)):
        z = play[i]
        if z < u - threshold[i]:
            play[i] = u - threshold[i]
        elif z > u + threshold[i]:
            play[i] = u + threshold[i]
        else:
            break
        y += weight[i] * (play[i] - z)
    state.play_sum_um = y
    # tanh by exp: a third of the latency.
    y += unit.envelope_um * (
        1.0 - 2.0 / (math.exp((y - unit.envelope_centre_um) * unit.envelope_steepness) + 1.0)
    )
    decay, share, slow = unit.creep_decay, unit.creep_share, state.creep_um
    for j in range(len(decay)):
        slow[j] = y + decay[j] * (slow[j] - y)
    even, odd = 0.0, 0.0  # two sums at once: additions wait for each other
    for j in range(0, len(decay), 2):
        even += share[j] * slow[j]
        odd += share[j + 1] * slow[j + 1]
    static = (y + (even + odd) - unit.actuator_zero_um) * unit.stroke_share
    deviation = state.free_z_um - static
    velocity = state.mode_velocity_um_s
    state.free_z_um = static + unit.mode_a11 * deviation + unit.mode_a12 * velocity
    state.mode_velocity_um_s = unit.mode_a21 * deviation + unit.mode_a22 * velocity


@compiled
def pump(unit: Unit, state: PlantState, opening: float) -> None:
    """An opening gap draws clean oil in: the greater the stroke against the annulus, the cleaner."""
    if opening <= 0.0:
        state.opening_um = 0.0
        return
    drawn = opening - state.opening_um
    state.opening_um = opening
    if drawn > 0.0:
        refill = unit.annulus_area_um2 * state.depth_um + 3.0 * unit.tool_area_um2
        state.debris_um3 *= math.exp(-unit.tool_area_um2 * drawn / refill)
        state.carbon = 0.0


@compiled
def drift_apart(unit: Unit, state: PlantState) -> None:
    """Let the work drift away from the tool for 64 ms."""
    way_um = 64.0 * TICK_S * unit.machine_drift_um_s
    state.machine_um += way_um
    state.surface_um += way_um


@compiled
def renew_clearing(unit: Unit, state: PlantState) -> None:
    """How fast debris leaves the gap: slower the narrower it and the deeper the hole.

    By the square of the gap: the flow through a slit is its cube, and what it has to carry grows with it. What is
    open below clears too.
    """
    ratio = state.depth_um * unit.per_flush_depth
    gap = (state.surface_um + state.depth_um + state.wear_um - state.true_z_um) / unit.working_gap_um
    opened = min(CLEARING[1], max(CLEARING[0], gap * gap if gap > 0.0 else 0.0))
    rate = opened / (unit.flush_time_s * (1.0 + ratio * ratio)) + (1.0 - 1.0 / state.rarity) / FLUSH_THROUGH_S
    state.clearing = math.exp(-unit.pulse_period_ns * 1e-9 * rate)
    state.tick_clearing = math.exp(-TICK_S * rate)


@compiled
def forget_craters(state: PlantState) -> None:
    """A floor that sinks shows its newest craters."""
    sunk = state.depth_um - state.crater_depth_um
    if sunk > 0.0:
        kept = math.exp(-sunk / SURFACE_UM)
        state.crater_um3 *= kept
        state.crater_um6 *= kept
        state.arc_um3 *= kept
    state.crater_depth_um = state.depth_um


@compiled
def generator_at_gap(unit: Unit, drive: Drive) -> bool:
    """Where the mode switch stands: one changeover, on whose gap side the gap sensor is."""
    if unit.mode_stuck:
        return bool(unit.mode_stuck == STUCK_AT_GENERATOR)
    return bool(drive.generator or drive.pulses_on)


@compiled
def rest(unit: Unit, state: PlantState, drive: Drive, readings: Readings) -> None:
    """A millisecond without pulses: the gap clears itself, and a sound gap sensor has nothing to read."""
    state.debris_um3 *= state.tick_clearing
    state.bridge_until_um = 0.0
    state.previous_burning = -1.0
    readings.pulses = 0
    readings.charge_uc = 0.0
    readings.stray_pulses = unit.stray_pulses
    stuck = unit.gate_stuck == 1 and unit.supply_off == 0 and generator_at_gap(unit, drive)
    applied_v = unit.gap_wire * (unit.open_v if stuck else unit.battery_v)
    at_rest_v = applied_v if applied_v > LEAST_GAP_V else math.nan
    readings.gap_v = unit.gap_stuck_v if unit.gap_stuck_v >= 0.0 else at_rest_v


@compiled
def sink_levels(unit: Unit, state: PlantState, levels: Array) -> bool:
    """Let cells of the work join what sinks, or fall out of the sheet, where the level came to them.

    `levels` is the table of a footprint (workpiece.py). What was removed below a level is spread over the area that
    sinks from there on, so that no volume is lost. True where nothing is left to sink.
    """
    at = state.level_at
    while state.depth_um >= levels[0, at]:
        level, share, rarity = levels[0, at], levels[1, at], levels[2, at]
        if share == 0.0 or rarity == math.inf:
            state.depth_um = level
            return True
        per_area = unit.per_disc_area / share
        state.depth_um = level + (state.depth_um - level) * per_area / state.per_hole_area
        state.per_hole_area = per_area
        state.rarity = rarity
        at += 1
        state.level_at = at
    state.next_level_um = levels[0, at]
    return False


@compiled
def sensor(unit: Unit, state: PlantState, tick: int, noise: Array) -> float:
    """Inductive sensor: gain error, bend, drift, random walk, noise."""
    at = state.noise_at
    if tick & 1023 == 0:
        state.walk_um += unit.sensor_walk_um * noise[at]
        at += 1
    state.noise_at = at + 1
    z = state.true_z_um
    bend = BEND_PER_UM * z - BEND_AT
    return float(
        unit.sensor_gain * z
        + unit.sensor_bend_um * bend * (1.0 - bend * bend)
        + unit.sensor_drift_um_s * tick * TICK_S
        + state.walk_um
        + unit.sensor_noise_um * noise[at]
    )


@compiled
def follow_drive(unit: Unit, state: PlantState, drive: Drive, noise: Array) -> bool:
    """What a controller does at the end of a millisecond: true where the stages have come to another place.

    Every touch meets other asperities. The error of the stages is that of a line's end by the time they are there.
    """
    if drive.contact_tests != state.contact_tests:
        state.contact_tests = drive.contact_tests
        state.asperity_um = unit.contact_sd_um * noise[state.noise_at]
        state.noise_at += 1
    if drive.stage_moves == 0:
        return False
    line = drive.stage_line
    for _ in range(drive.stage_lines_done):
        state.stage_error_x_um = state.line_error_x_um[line]
        state.stage_error_y_um = state.line_error_y_um[line]
        line = (line + 1) % PATH_LINES
    share = drive.stage_share
    if share > 0.0:
        state.stage_error_x_um += share * (state.line_error_x_um[line] - state.stage_error_x_um)
        state.stage_error_y_um += share * (state.line_error_y_um[line] - state.stage_error_y_um)
    state.stage_way_um += drive.stage_way_um
    return bool(state.stage_way_um >= STAGE_STEP_UM)
