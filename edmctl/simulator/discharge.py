"""The pulses of a millisecond, one by one: ignition, arcs, shorts, bridges, removal, wear and debris.

The ignition delay is exponential (Laue) about a mean that grows with a power of the gap. Particles make chains that
short a gap of their size; a channel that has not lost its conductivity in the off-time ignites again at once, as an
arc; and sparks in a dirty gap that follow each other without delay arc too. What a discharge removes stands in
tables over its burning time. Laws and sources: `edmctl.process.erosion`, `edmctl.process.gap_conditions`; constants:
config.py.
"""

from __future__ import annotations

import math

from edmctl.actuator.compiling import compiled
from edmctl.array_types import Array
from edmctl.process.gap_conditions import MOST_DEBRIS
from edmctl.simulator.plant_interface import TICK_NS, Drive, Readings
from edmctl.simulator.plant_state import BURNING, SCOPE_PULSES, STUCK_AT_CONTACT, PlantState, Scope, Unit

TABLE = 1024  # values in each table of a distribution
SHAPES = float(TABLE * TABLE)
DEBRIS_GAP_UM = 0.3  # debris does not get thinner than this [assumed]
LEAST_GAP_UM = 0.02
LEAST_WALL_UM = 20.0  # a shallower hole has as much wall as one of this depth [assumed]
CARBON_RUN, CARBON_ARCING, CARBON_HEALING = (
    20,
    50.0,
    0.01,
)  # arcs in a row, carbon that arcs, less a spark [assumed]


@compiled
def power(base: float, exponent: float) -> float:
    """`base ** exponent` of a whole exponent; between two of them, their powers in proportion.

    No unit's delay is a power to the last digit, and this one costs a multiplication where a power costs a third of
    the pulse.
    """
    whole = int(exponent)
    result = 1.0
    for _ in range(whole):
        result *= base
    rest = exponent - whole
    return result * (1.0 - rest + rest * base)


@compiled
def strike_pulses(
    unit: Unit,
    state: PlantState,
    scope: Scope,
    drive: Drive,
    readings: Readings,
    random: Array,
    tables: Array,
) -> None:
    """Strike every pulse of this tick and show what can be read of them.

    `random` has three rows, a column a pulse: a uniform number that decides bridge, arc and side discharge in
    turn, a uniform number that picks roughness and crater scatter from their tables, a unit exponential for the
    delay. `tables`, shape (2, TABLE), holds equally likely values of a half-normal and a unit-mean lognormal.
    """
    tick_start = readings.tick * TICK_NS
    if drive.pulse_starts != state.pulse_starts:
        state.pulse_starts = drive.pulse_starts
        state.next_pulse_ns = tick_start
    open_v, on_time = unit.open_v, unit.on_time_us
    previous, previous_arc = state.previous_burning, state.previous_arc
    per_particle, per_burning = 1.0 / unit.particle_um, BURNING / on_time
    tau_reference = unit.tau_reference_us * state.rarity
    per_period = 1e3 / unit.pulse_period_ns
    per_tool, per_hole, per_ohm = unit.per_tool_area, state.per_hole_area, unit.siemens
    reach = state.surface_um - state.true_z_um
    depth, wear, debris = state.depth_um, state.wear_um, state.debris_um3
    bridge_until, carbon = state.bridge_until_um, state.carbon
    clearing, per_gap = state.clearing, unit.per_open_gap
    side_slope = unit.side_debris * min(1.0, depth * 0.01)
    true_run = state.true_arc_run
    tick_end = tick_start + TICK_NS
    next_pulse, period = state.next_pulse_ns, unit.pulse_period_ns
    at, place = state.random_at, scope.at
    voltage_sum, charge, count = 0.0, 0.0, 0
    wall, arcs, craters, craters_squared = state.wall_um, state.arc_um3, state.crater_um3, state.crater_um6
    stuck, leak_a = unit.gap_stuck_v, unit.off_time_a
    away = unit.mode_stuck == STUCK_AT_CONTACT  # the pulses end at the mode switch, the gap has no voltage
    if away and stuck < 0.0:
        stuck = 0.0
    read = max(0.0, unit.gap_wire)  # a converter has no negative voltage
    readings.first_pulse_ns = next_pulse

    while next_pulse < tick_end:
        gap = reach + depth + wear
        fraction = min(MOST_DEBRIS, debris * per_tool / max(gap, DEBRIS_GAP_UM))
        chance = random[0, at]
        shape = int(random[1, at] * SHAPES)  # two table places in one number
        local = (
            max(LEAST_GAP_UM, gap * (1.0 - unit.debris_gap_factor * fraction))
            - unit.roughness_um * tables[0, shape % TABLE]
            - unit.gap_closed_um
        )
        # Each decision cuts the interval that `chance` is uniform in, and leaves the piece it fell into.
        low, width = 0.0, 1.0
        if bridge_until > 0.0:
            if gap > bridge_until:
                bridge_until = 0.0
            elif chance < unit.bridge_clear:
                bridge_until = 0.0
                width = unit.bridge_clear
        if bridge_until == 0.0 and fraction > 0.0:
            # A chain of particles: its chance is that of one, to the power of how many there have to be. Few pulses
            # fall below a bound of it, and only they need the power.
            particles = gap * per_particle - 0.5
            bound = 0.5
            if particles >= 1.0:
                bound = min(0.5, unit.bridge_base * (fraction * fraction if particles >= 2.0 else fraction))
            bound *= width
            if chance >= bound:
                low, width = bound, width - bound
            else:
                limit = min(bound, unit.bridge_base * fraction**particles * width)
                if chance < limit:
                    bridge_until = max(gap, LEAST_GAP_UM) + (1.5 + 40.0 * fraction) * unit.particle_um
                else:
                    low, width = limit, bound - limit

        delay, plateau, discharge, energy = on_time, open_v, 0.0, 0.0
        burnt, burnt_arc = -1.0, 0.0
        if away:
            pass
        elif gap <= 0.0 or bridge_until > 0.0 or local <= 0.0:
            delay, plateau, discharge = 0.0, unit.short_plateau_v, on_time
            charge += max(0.0, open_v - plateau) * per_ohm * discharge
        else:
            again = 0.0
            if previous >= 0.0 and unit.off_time_us < unit.longest_memory_us:
                memory = unit.deionisation_us[int(previous)] * (1.0 + unit.deionisation_debris * fraction)
                if previous_arc > 0.0:
                    memory *= unit.deionisation_after_arc
                again = math.exp(-unit.off_time_us / memory)
            tau = tau_reference * power(local * per_gap, unit.gap_exponent)
            ignition = unit.formative_us + tau * random[2, at]
            if ignition < on_time or again > 0.0:
                hit = again * width
                arcing = chance - low < hit
                if arcing:
                    width = hit
                else:
                    low += hit
                    width -= hit
                if not arcing and ignition < on_time:
                    arc_p = unit.arc_base
                    if carbon > CARBON_ARCING:
                        arc_p = 0.9
                    elif previous >= 0.0:
                        dense = min(1.0, fraction * fraction * unit.arc_debris * (1.0 + 8.0 * previous_arc))
                        after = ignition / (unit.arc_delay_us * (1.0 + previous_arc))
                        arc_p = min(1.0, arc_p + dense * unit.arc_pause * math.exp(-after))
                    hit = arc_p * width
                    arcing = chance - low < hit
                    if arcing:
                        width = hit
                    else:
                        low += hit
                        width -= hit
                if arcing or ignition < on_time:
                    work_share, tool_share = unit.work_factor, unit.tool_factor
                    if arcing:
                        delay, plateau = 0.0, unit.arc_plateau_v
                        true_run += 1
                        carbon += 1.0 if true_run > CARBON_RUN else 0.0
                        work_share, tool_share = unit.arc_work * work_share, unit.arc_tool * tool_share
                    else:
                        delay, plateau = ignition, unit.discharge_v
                        true_run = 0
                        carbon = max(0.0, carbon - CARBON_HEALING)
                    discharge = on_time - delay
                    if unit.discharge_set_us > 0.0:
                        discharge = min(discharge, unit.discharge_set_us)
                    pulse_charge = max(0.0, open_v - plateau) * per_ohm * discharge
                    charge += pulse_charge
                    energy = plateau * pulse_charge
                    burning = min(int(discharge * per_burning), BURNING - 1)
                    molten = max(0.0, energy - unit.threshold_uj) * tables[1, shape // TABLE]
                    lost = fraction * unit.per_redeposition
                    removal = work_share * unit.work_um3_per_uj[burning] * molten / (1.0 + lost * lost)
                    worn = tool_share * unit.tool_um3_per_uj[burning] * molten
                    debris += removal + worn
                    if chance - low >= (unit.side_base + side_slope * fraction) * width:
                        depth += removal * per_hole
                        wear += worn * per_tool
                    else:
                        wall += removal * unit.per_rim_um / max(depth, LEAST_WALL_UM)
                    craters += removal
                    craters_squared += removal * removal
                    if arcing:
                        arcs += removal
                    burnt, burnt_arc = float(burning), 1.0 if arcing else 0.0
        previous, previous_arc = burnt, burnt_arc
        debris *= clearing
        voltage_sum += (delay * open_v + discharge * plateau) * per_period
        readings.delay_us[count] = delay
        readings.discharge_us[count] = discharge
        readings.plateau_v[count] = read * (plateau if stuck < 0.0 else stuck)
        readings.energy_uj[count] = energy
        newest = place & (SCOPE_PULSES - 1)
        scope.start_ns[newest] = next_pulse
        scope.delay_us[newest] = delay
        scope.discharge_us[newest] = discharge
        scope.plateau_v[newest] = plateau
        scope.siemens[newest] = per_ohm
        scope.leak_a[newest] = leak_a
        scope.stuck_v[newest] = stuck
        place += 1
        count += 1
        at += 1
        next_pulse += period

    state.depth_um, state.wear_um, state.debris_um3 = depth, wear, debris
    state.bridge_until_um, state.carbon, state.true_arc_run = bridge_until, carbon, true_run
    state.previous_burning, state.previous_arc = previous, previous_arc
    state.wall_um, state.arc_um3, state.crater_um3, state.crater_um6 = wall, arcs, craters, craters_squared
    state.random_at, state.next_pulse_ns, scope.at = at, next_pulse, place
    if charge > 0.0 and leak_a > 0.0:
        charge += leak_a * (period * 1e-3 - on_time) * count
    if stuck >= 0.0:
        voltage_sum = stuck * count
    readings.pulses, readings.charge_uc = count, charge
    readings.gap_v = read * voltage_sum / count if count > 0 else math.nan
    readings.generator_siemens, readings.off_time_a = (per_ohm if charge > 0.0 else 0.0), leak_a
