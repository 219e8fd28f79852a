"""The machine at 1 kHz with its every pulse: one source, compiled by numba, readable as plain Python.

`run` advances the virtual machine tick by tick. A tick is 1 ms: the controller moves its command, the actuator
answers, the pulses of that millisecond strike, the sensors are read, the controller judges. The controller's half
sees only what a real one sees (sensor, contact, each pulse's delay, plateau and current); the plant's half knows
nothing of the controller but the voltage on the actuator and the settings of the generator.

Everything compiled stands in this one file because numba's cache is keyed on the file of the function called.
State lives in flat arrays; the names below are their indices. Units: µm, V, s, µs, µJ, µm³, nanoseconds for times.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.actuator.compiling import cached, compiled

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Bytes = NDArray[np.uint8]


TICK_S = 0.001
TICK_NS = 1_000_000
DAC_V = 0.0025  # least step of the actuator voltage, about 7 nm of tool travel
STEPS_PER_V = 400.0

DENSEST = 0.6  # debris fraction of a gap packed full: about the densest random packing of spheres
DEBRIS_GAP_UM = 0.3  # debris does not get thinner than this [assumed]
LEAST_GAP_UM = 0.02
FLUSH_THROUGH_S = 0.02  # debris clearance of a gap that is all open below [assumed]
FREE_GAP_UM = 5.0  # opening beyond this draws clean oil in; the servo's own dither stays below [assumed]
CARBON_RUN, CARBON_ARCING, CARBON_HEALING = 20, 50.0, 0.01  # arc damage, see carbon below [assumed]
BEND_PER_UM, BEND_AT = 0.004, 0.8  # where over the stroke the sensor's bend lies

# ------------------------------------------------------------------------------------- plant: parameters (par)
(
    TOOL_AREA,
    PER_TOOL_AREA,
    PER_DISC_AREA,  # of the whole disc that discharges reach
    PER_HOLE_AREA,  # of what sinks of it now
    ANNULUS_AREA,
    THETA,
    KAPPA,
    DISCHARGE_V,
    ARC_PLATEAU_V,
    SHORT_PLATEAU_V,
    TAU_REFERENCE,
    GAP_EXPONENT,
    FORMATIVE,
    ROUGHNESS,
    DEBRIS_GAP_FACTOR,
    FLUSH_TIME,  # of this tool's gap while shallow
    PER_FLUSH_DEPTH,  # one over the depth at which clearance takes twice as long
    ARC_BASE,
    ARC_DEBRIS,
    BRIDGE_BASE,
    PER_BRIDGE_DEBRIS,
    PER_BRIDGE_GAP,
    BRIDGE_CLEAR,
    SIDE_BASE,
    SIDE_DEBRIS,
    ENVELOPE_UM,
    ENVELOPE_CENTRE,
    ENVELOPE_STEEPNESS,
    ACTUATOR_ZERO,
    AMPLIFIER_DECAY,
    MODE_A11,
    MODE_A12,
    MODE_A21,
    MODE_A22,
    CONTACT_COMPLIANCE,
    SENSOR_GAIN,
    SENSOR_BEND,
    SENSOR_DRIFT,
    SENSOR_NOISE,
    SENSOR_WALK,
    CONTACT_SD,
    # --------------------------------------------------------------------- what is broken (see injection.py)
    DRIVE,  # of the actuator: 1, or 0 with a dead amplifier
    STROKE,  # share of its displacement that is left
    MONITOR_GAIN,
    MONITOR_ZERO,
    GAP_STUCK,  # what the gap sensor reads whatever there is; negative: nothing is wrong
    OFF_TIME_A,  # current that goes on into the off-time
    # -------------------------------------------------------------------- generator and controller: parameters
    OPEN_V,
    ON_TIME,
    DISCHARGE_SET,
    SIEMENS,  # of the generator's series resistor
    DUTY_V,  # mean gap voltage of an all-open gap: duty × open voltage
    PER_DUTY_V,
    PER_OPEN_GAP,  # one over the reference gap at this open voltage
    PIEZO_MAX,
    SLEW_LIMIT,
    V_PER_UM,
    FORWARD,
    BACK,
    SHORT_BACK,
    FILTER_ALPHA,
    DISPLACEMENT_ALPHA,
    HYSTERESIS,
    KP,
    KI,
    SHORT_BELOW,
    ARC_BELOW,
    ARC_DELAY,
    OPEN_LOST,
    SENSOR_MISSING,  # 1: displacements are the mean gain times the voltage applied
    NOMINAL_SIEMENS,  # as the generator is set; SIEMENS is what it has
    OVER_CURRENT,
    TRACK_V,
    MONITOR_MIN,
    MONITOR_MAX,
    PAR_SIZE,
) = range(76)

# --------------------------------------------------------------------------------------------- float state (st)
(
    AMPLIFIER_V,  # after the amplifier's lag
    PLAY_SUM,  # weighted sum of the play bank, µm
    MODE_V,  # velocity of the output-side mode, µm/s
    FREE_Z,  # where the tool would be without contact
    TRUE_Z,
    SURFACE,  # gap at z = 0 with a new tool over the untouched surface here
    DEPTH,  # least depth under the tool's face
    RARITY,  # of ignition: the tool's face over what of the sheet is left under it
    WEAR,
    DEBRIS,  # µm³ in the frontal gap
    CLEARING,  # share of the debris that stays over a pulse period, and over a tick
    TICK_CLEARING,
    BRIDGE_UNTIL,  # gap at which the bridge breaks; 0 = none
    CARBON,
    OPENING,  # of the gap beyond FREE_GAP_UM
    ASPERITY,
    WALK,
    COMMAND_V,
    TARGET_V,
    RAMP_V_S,
    RATE_V_S,
    INTEGRAL,
    APPLIED_V,
    SENSOR_Z,
    SLOW_Z,  # low-passed sensor
    GAP_V,  # low-passed mean gap voltage
    TICK_GAP_V,  # mean gap voltage of the last millisecond
    GAP_REF,
    Z_LIMIT,
    START_Z,
    LAST_SPARK_Z,
    START_V,
    JUMP_V,
    CLEARANCE_V,
    FAST_V_S,
    SLOW_V_S,
    FAST_TO,
    Z_MAX,
    BACK_V,
    TOUCH_V,
    TOUCH_SUM,
    CHARGE,
    DELAY_SUM,
    ENERGY_SUM,
    TICK_CHARGE,  # of the last millisecond
    TEST_OFF_V,  # mean gap voltage of a self test, generator off
    STAGE_X,  # while scanning: where the stages report to be, µm
    STAGE_Y,
    STAGE_ERROR_X,  # where they really are, less that
    STAGE_ERROR_Y,
    STAGE_WAY,  # gone since the plant last looked
    ST_SIZE,
) = range(52)

# --------------------------------------------------------------------------------------------- int state (ist)
(
    TICK,
    MODE,
    PULSES_ON,
    NEXT_PULSE,
    PULSE_PERIOD,
    PULSE_NO,
    RANDOM_AT,
    NOISE_AT,
    LAW,
    SERVO_TICKS,
    SERVO_LATENCY,
    SERVO_COUNT,
    DIRECTION,
    CONTACT,
    SHORTED,
    ARC_RUN,  # as judged by the controller
    TRUE_ARC_RUN,  # as the plant knows it: what builds up carbon
    ARC_RUN_MAX,
    SILENT_TICKS,  # since the last pulse
    SHORT_TICKS,
    SHORT_TICKS_MAX,
    OPEN_TICKS,
    OPEN_TICKS_MAX,
    LIMIT_TICKS,
    PHASE,
    PHASE_TICKS,
    DWELL_TICKS,
    TIME_TICKS,
    TOUCHES_LEFT,
    TOUCH_COUNT,
    TOUCH_NO,
    TLM_TICKS,
    TLM_NEXT,  # tick at whose end the next sample is due; -1 = none
    TLM_N,
    TLM_STATE,
    SAMPLE_COUNTS,  # pulses of the running telemetry sample, packed as TICK_COUNTS
    PULSE_LOG,
    BLOCK_SIZE,
    BLOCK_COUNT,
    BLOCK_OPEN,
    BLOCK_NORMAL,
    BLOCK_ARC,
    BLOCK_SHORT,
    LOG_N,  # pulse or block records pending
    LOG_PULSE_NO,
    LOG_T0,
    JUMP_RESUMES,
    SLEWED,
    TICK_COUNTS,  # pulses of the last millisecond: PACK bits a class, in the order of PulseClass
    WATCHED,  # 1 while armed: monitors count
    TRACK_TICKS,
    TRACK_TICKS_MAX,
    TRACK_AT,  # last tick with the voltage off its command
    MISREADS,  # pulses in a row whose voltage cannot be
    MISREADS_MAX,
    STRAY_PULSES,  # seen in measure mode
    SCANNING,  # 1: the cut is held at its limit, and the stages follow the path
    PATH_AT,  # row of the line that they follow
    PATH_COUNT,  # lines in the queue, that one included
    LEVEL_AT,  # column of the next level in the table of what lies under the tool
    IST_SIZE,
) = range(61)

# --------------------------------------------------------------------------------------------------------- modes
(
    HOLD,
    RAMP,
    APPROACH,
    SERVO,
    JUMP_UP,
    JUMP_DWELL,
    JUMP_DOWN,
    JUMP_RETURN,
    TOUCH_FAST,
    TOUCH_SLOW,
    TOUCH_HUNT,
    TOUCH_BACK,
    TEST_OFF,
    TEST_ON,
) = range(14)

# ------------------------------------------------------------------------- what happened (returned by `run`)
(
    NOTHING,
    RAMP_DONE,
    SPARK_FOUND,
    CUT_DONE,
    TIME_UP,
    JUMP_RESUMED,
    JUMP_DONE,
    TOUCHED,
    TOUCHES_DONE,
    FAULT_TRAVEL,
    FAULT_NO_CONTACT,
    FAULT_STUCK_CONTACT,
    FAULT_SHORT,
    FAULT_ARC,
    FAULT_NO_SPARK,
    FAULT_COLLISION,
    FAULT_TRACK,
    FAULT_MONITOR,
    FAULT_GAP_SENSOR,
    FAULT_GENERATOR,
    FAULT_MODE_SWITCH,
    TESTED,
    PATH_DONE,
    LOOK,  # the stages moved, or the sheet gave way: the plant should look what lies under the tool
) = range(24)

OPEN, NORMAL, ARC, SHORT = range(4)
LOG_OFF, LOG_BLOCKS, LOG_FULL = range(3)
RELAY, PI_LAW = range(2)

HISTORY = 64  # servo decisions remembered, for latency; a power of two
TABLE = 1024  # values in each table of a distribution
SHAPES = float(TABLE * TABLE)
BOX = 2048  # milliseconds in the black box; a power of two
BOX_COLUMNS = 6
RECENT = 64  # newest pulses remembered, for waveforms; a power of two
(
    PULSE_START,
    PULSE_DELAY,
    PULSE_DISCHARGE,
    PULSE_PLATEAU,
    PULSE_SIEMENS,
    PULSE_LEAK,
    PULSE_STUCK,
    RECENT_COLUMNS,
) = range(8)
PATH_LINES = 16
PATH_X, PATH_Y, PATH_SPEED, PATH_Z, PATH_LAST, PATH_ERROR_X, PATH_ERROR_Y, PATH_COLUMNS = range(8)
PACK = 12  # bits of a count; four of them fit into a float exactly

SETTLE_TICKS = 100  # generator on before the approach judges the gap voltage
SHORT_HURRY_TICKS = 500  # a short this long retracts four times as fast
LIMIT_TICKS_MAX = 500
HOLD_PER_S = 4.0  # of the way to a scan's limit; well below the bandwidth of the displacement's low-pass
HELD_WITHIN_UM = 1.0
LOST_TICKS = 100  # all open, before the way since the last spark counts
STAGE_STEP_UM = 2.5
BLEND_TICKS = 8  # of a jump's ramp, at each end
BACK_OFF_TICKS = 200  # for the contact to open after a back-off
TEST_OFF_TICKS, TEST_ON_TICKS = 100, 200
TEST_MEAN_TICKS = 100  # the last ones of each half speak
MISREAD_HIGH, MISREAD_LOW = (
    0.97,
    0.5,
)  # of the open voltage: none that a discharge has, none that an open gap has


# ============================================================================================= plant: actuator
@compiled
def actuator_tick(par: Floats, st: Floats, plays: Floats, creep: Floats) -> None:
    """One millisecond of the actuator: amplifier lag, play bank, envelope, creep bank, output-side mode.

    `plays` has rows threshold [V], weight [µm/V], state [V]; `creep` rows decay per tick, weight, state [µm].
    The free displacement follows the sum of the plays, bent by a tanh envelope, plus its creep.
    """
    driven_v = st[APPLIED_V] * par[DRIVE]
    u = driven_v + par[AMPLIFIER_DECAY] * (st[AMPLIFIER_V] - driven_v)
    st[AMPLIFIER_V] = u
    # Thresholds ascend, so the plays that a move drags along are always the first ones.
    threshold, weight, state = plays[0], plays[1], plays[2]
    y = st[PLAY_SUM]
    for i in range(threshold.shape[0]):
        z = state[i]
        if z < u - threshold[i]:
            state[i] = u - threshold[i]
        elif z > u + threshold[i]:
            state[i] = u + threshold[i]
        else:
            break
        y += weight[i] * (state[i] - z)
    st[PLAY_SUM] = y
    # tanh by exp: a third of the latency.
    y += par[ENVELOPE_UM] * (
        1.0 - 2.0 / (math.exp((y - par[ENVELOPE_CENTRE]) * par[ENVELOPE_STEEPNESS]) + 1.0)
    )
    decay, share, slow = creep[0], creep[1], creep[2]
    for j in range(decay.shape[0]):
        slow[j] = y + decay[j] * (slow[j] - y)
    even, odd = 0.0, 0.0  # two sums at once: additions wait for each other
    for j in range(0, decay.shape[0], 2):
        even += share[j] * slow[j]
        odd += share[j + 1] * slow[j + 1]
    static = (y + (even + odd) - par[ACTUATOR_ZERO]) * par[STROKE]
    deviation = st[FREE_Z] - static
    velocity = st[MODE_V]
    st[FREE_Z] = static + par[MODE_A11] * deviation + par[MODE_A12] * velocity
    st[MODE_V] = par[MODE_A21] * deviation + par[MODE_A22] * velocity


@compiled
def contact_tick(par: Floats, st: Floats, ist: Ints) -> None:
    """Where the tool really is: the work stops it, all but its own compliance."""
    reach = st[SURFACE] + st[DEPTH] + st[WEAR]
    excess = st[FREE_Z] - reach
    st[TRUE_Z] = st[FREE_Z] if excess <= 0.0 else reach + par[CONTACT_COMPLIANCE] * excess
    ist[CONTACT] = 1 if excess >= -st[ASPERITY] else 0


# ============================================================================================ plant: discharge
@compiled
def power(base: float, exponent: float) -> float:
    """`base ** exponent`; small whole exponents, the usual ones, by multiplication."""
    whole = int(exponent)
    if whole != exponent or whole > 8:
        return float(base**exponent)
    result = 1.0
    for _ in range(whole):
        result *= base
    return result


@compiled
def pulses_of_tick(
    par: Floats,
    st: Floats,
    ist: Ints,
    random: Floats,
    tables: Floats,
    blocks: Bytes,
    pulses: Bytes,
    recent: Floats,
) -> tuple[float, int, int]:
    """Strike every pulse of this tick; returns (sum of their mean gap voltages [V], pulses, shorts).

    `random` has three rows, a column a pulse: a uniform number that decides bridge, arc and side discharge in
    turn, a uniform number that picks roughness and crater scatter from their tables, a unit exponential for the
    delay. `tables`, shape (2, TABLE), holds equally likely values of a half-normal and a unit-mean lognormal.
    `recent`, shape (RECENT, RECENT_COLUMNS), is the ring of the newest pulses.
    """
    open_v, on_time = par[OPEN_V], par[ON_TIME]
    tau_reference = par[TAU_REFERENCE] * st[RARITY]
    per_period = 1e3 / ist[PULSE_PERIOD]
    per_tool, per_hole, per_ohm = par[PER_TOOL_AREA], par[PER_HOLE_AREA], par[SIEMENS]
    reach = st[SURFACE] - st[TRUE_Z]
    depth, wear, debris = st[DEPTH], st[WEAR], st[DEBRIS]
    bridge_until, carbon = st[BRIDGE_UNTIL], st[CARBON]
    clearing, per_gap, per_debris = st[CLEARING], par[PER_OPEN_GAP], par[PER_BRIDGE_DEBRIS]
    side_slope = par[SIDE_DEBRIS] * min(1.0, depth * 0.01)
    arc_run, true_run = ist[ARC_RUN], ist[TRUE_ARC_RUN]
    tick_end = (ist[TICK] + 1) * TICK_NS
    next_pulse, period, log = ist[NEXT_PULSE], ist[PULSE_PERIOD], ist[PULSE_LOG]
    at = ist[RANDOM_AT]
    voltage_sum, charge, count, shorts = 0.0, 0.0, 0, 0
    stuck, misreads, counts = par[GAP_STUCK], ist[MISREADS], 0
    high_v, low_v = MISREAD_HIGH * open_v, MISREAD_LOW * open_v
    number, leak_a = ist[PULSE_NO], par[OFF_TIME_A]

    while next_pulse < tick_end:
        gap = reach + depth + wear
        fraction = min(DENSEST, debris * per_tool / max(gap, DEBRIS_GAP_UM))
        chance = random[0, at]
        shape = int(random[1, at] * SHAPES)  # two table places in one number
        local = (
            max(0.02, gap * (1.0 - par[DEBRIS_GAP_FACTOR] * fraction))
            - par[ROUGHNESS] * tables[0, shape % TABLE]
        )
        # Each decision cuts the interval that `chance` is uniform in, and leaves the piece it fell into.
        low, width = 0.0, 1.0
        if bridge_until > 0.0:
            if gap > bridge_until:
                bridge_until = 0.0
            elif chance < par[BRIDGE_CLEAR]:
                bridge_until = 0.0
                width = par[BRIDGE_CLEAR]
        if bridge_until == 0.0:
            relative = fraction * per_debris
            bound = par[BRIDGE_BASE] * relative * relative * relative * width
            if chance >= bound:
                low, width = bound, width - bound
            else:
                limit = bound * math.exp(-gap * par[PER_BRIDGE_GAP])
                if chance < limit:
                    bridge_until = 1.3 * max(gap, LEAST_GAP_UM)
                else:
                    low, width = limit, bound - limit

        delay, plateau, discharge, energy = on_time, open_v, 0.0, 0.0
        if gap <= 0.0 or bridge_until > 0.0 or local <= 0.0:
            delay, plateau, discharge = 0.0, par[SHORT_PLATEAU_V], on_time
            charge += (open_v - plateau) * per_ohm * discharge
        else:
            tau = tau_reference * power(local * per_gap, par[GAP_EXPONENT])
            ignition = par[FORMATIVE] + tau * random[2, at]
            if ignition < on_time:
                arc_p = par[ARC_BASE] + par[ARC_DEBRIS] * fraction * fraction
                if carbon > CARBON_ARCING:
                    arc_p = 0.9
                efficiency, tool_share = 1.0, par[THETA]
                arcing = arc_p * width
                if chance - low < arcing:
                    width = arcing
                    delay, plateau = 0.0, par[ARC_PLATEAU_V]
                    true_run += 1
                    carbon += 1.0 if true_run > CARBON_RUN else 0.0
                    efficiency, tool_share = 0.3, 3.0 * tool_share
                else:
                    low += arcing
                    width -= arcing
                    delay, plateau = ignition, par[DISCHARGE_V]
                    true_run = 0
                    carbon = max(0.0, carbon - CARBON_HEALING)
                discharge = on_time - delay
                if par[DISCHARGE_SET] > 0.0:
                    discharge = min(discharge, par[DISCHARGE_SET])
                pulse_charge = (open_v - plateau) * per_ohm * discharge
                charge += pulse_charge
                energy = plateau * pulse_charge
                removal = par[KAPPA] * energy * efficiency * tables[1, shape // TABLE]
                worn = removal * tool_share
                debris += removal + worn
                if chance - low >= (par[SIDE_BASE] + side_slope * fraction) * width:
                    depth += removal * per_hole
                    wear += worn * per_tool
        debris *= clearing
        voltage_sum += (delay * open_v + discharge * plateau) * per_period
        count += 1
        at += 1
        place = number & (RECENT - 1)
        recent[place, PULSE_START] = next_pulse
        recent[place, PULSE_DELAY] = delay
        recent[place, PULSE_DISCHARGE] = discharge
        recent[place, PULSE_PLATEAU] = plateau
        recent[place, PULSE_SIEMENS] = per_ohm
        recent[place, PULSE_LEAK] = leak_a
        recent[place, PULSE_STUCK] = stuck
        number += 1
        seen_v = plateau if stuck < 0.0 else stuck
        pulse_class = judge_pulse(par, delay, seen_v, discharge)
        counts += 1 << (PACK * pulse_class)
        # Arcs and shorts say neither that the sensor is right nor that it is wrong.
        if pulse_class == NORMAL:
            misreads = misreads + 1 if seen_v > high_v else 0
        elif pulse_class == OPEN and seen_v < low_v:
            misreads += 1
        arc_run = arc_run + 1 if pulse_class == ARC else 0
        if pulse_class == SHORT:
            shorts += 1
        if log != LOG_OFF:
            log_pulse(
                st,
                ist,
                next_pulse,
                number - 1,
                pulse_class,
                delay,
                discharge,
                seen_v,
                energy,
                blocks,
                pulses,
            )
        next_pulse += period

    st[DEPTH], st[WEAR], st[DEBRIS] = depth, wear, debris
    st[BRIDGE_UNTIL], st[CARBON] = bridge_until, carbon
    if charge > 0.0 and leak_a > 0.0:
        charge += leak_a * (period * 1e-3 - on_time) * count
    if stuck >= 0.0:
        voltage_sum = stuck * count
    st[CHARGE] += charge
    st[TICK_CHARGE] = charge
    ist[TICK_COUNTS] = counts
    ist[SAMPLE_COUNTS] += counts
    ist[MISREADS] = misreads
    ist[ARC_RUN], ist[TRUE_ARC_RUN] = arc_run, true_run
    ist[RANDOM_AT] = at
    ist[PULSE_NO] = number
    ist[NEXT_PULSE] = next_pulse
    return voltage_sum, count, shorts


@compiled
def count_of(counts: int, pulse_class: int) -> int:
    """Pulses of one class in packed counts."""
    return (counts >> (PACK * pulse_class)) & ((1 << PACK) - 1)


@compiled
def rest_tick(par: Floats, st: Floats, ist: Ints) -> None:
    """A millisecond without sparks: the gap clears itself, and its sensor should read nothing."""
    st[DEBRIS] *= st[TICK_CLEARING]
    st[BRIDGE_UNTIL] = 0.0
    st[TICK_CHARGE] = 0.0
    ist[TICK_COUNTS] = 0
    st[TICK_GAP_V] = max(0.0, par[GAP_STUCK])
    if par[GAP_STUCK] >= 0.0:
        st[GAP_V] = par[GAP_STUCK]


@compiled
def renew_clearing(par: Floats, st: Floats, ist: Ints) -> None:
    """How fast debris leaves the gap: slower the wider and the deeper the hole, and through what is open below."""
    ratio = st[DEPTH] * par[PER_FLUSH_DEPTH]
    rate = 1.0 / (par[FLUSH_TIME] * (1.0 + ratio * ratio)) + (1.0 - 1.0 / st[RARITY]) / FLUSH_THROUGH_S
    st[CLEARING] = math.exp(-ist[PULSE_PERIOD] * 1e-9 * rate)
    st[TICK_CLEARING] = math.exp(-TICK_S * rate)


@compiled
def level_tick(par: Floats, st: Floats, ist: Ints, levels: Floats) -> int:
    """Let cells of the work join what sinks, or fall out of the sheet, where the level came to them.

    `levels` is the table of a footprint (workpiece.py). What was removed below a level is spread over the area that
    sinks from there on, so that no volume is lost.
    """
    at = ist[LEVEL_AT]
    while st[DEPTH] >= levels[0, at]:
        level, share, rarity = levels[0, at], levels[1, at], levels[2, at]
        if share == 0.0 or rarity == math.inf:
            st[DEPTH] = level
            return LOOK
        per_area = par[PER_DISC_AREA] / share
        st[DEPTH] = level + (st[DEPTH] - level) * per_area / par[PER_HOLE_AREA]
        par[PER_HOLE_AREA] = per_area
        st[RARITY] = rarity
        at += 1
        ist[LEVEL_AT] = at
    return NOTHING


@compiled
def pump_tick(par: Floats, st: Floats) -> None:
    """An opening gap draws clean oil in: the greater the stroke against the annulus, the cleaner."""
    opening = st[SURFACE] + st[DEPTH] + st[WEAR] - st[TRUE_Z] - FREE_GAP_UM
    if opening <= 0.0:
        st[OPENING] = 0.0
        return
    drawn = opening - st[OPENING]
    st[OPENING] = opening
    if drawn > 0.0:
        refill = par[ANNULUS_AREA] * st[DEPTH] + 3.0 * par[TOOL_AREA]
        st[DEBRIS] *= math.exp(-par[TOOL_AREA] * drawn / refill)
        st[CARBON] = 0.0


# ================================================================================================ plant: sensors
@compiled
def sensor_tick(par: Floats, st: Floats, ist: Ints, noise: Floats) -> None:
    """Inductive sensor: gain error, bend, drift, random walk, noise; and the controller's low-passed copy.

    A controller without a sensor takes its mean gain times the voltage applied instead.
    """
    at = ist[NOISE_AT]
    if ist[TICK] & 1023 == 0:
        st[WALK] += par[SENSOR_WALK] * noise[at]
        at += 1
    z = st[TRUE_Z]
    bend = BEND_PER_UM * z - BEND_AT
    st[SENSOR_Z] = (
        par[SENSOR_GAIN] * z
        + par[SENSOR_BEND] * bend * (1.0 - bend * bend)
        + par[SENSOR_DRIFT] * ist[TICK] * TICK_S
        + st[WALK]
        + par[SENSOR_NOISE] * noise[at]
    )
    ist[NOISE_AT] = at + 1
    if par[SENSOR_MISSING] == 1.0:
        st[SENSOR_Z] = st[APPLIED_V] / par[V_PER_UM]
    st[SLOW_Z] += par[DISPLACEMENT_ALPHA] * (st[SENSOR_Z] - st[SLOW_Z])


# ==================================================================================== controller: pulse judgement
@compiled
def judge_pulse(par: Floats, delay: float, plateau: float, discharge: float) -> int:
    """Class of a pulse from what the controller measures: current flag, ignition delay, plateau voltage."""
    if discharge == 0.0:
        return OPEN
    if plateau < par[SHORT_BELOW]:
        return SHORT
    if plateau < par[ARC_BELOW] and delay < par[ARC_DELAY]:
        return ARC
    return NORMAL


@compiled
def put16(buffer: Bytes, at: int, value: int) -> None:
    buffer[at] = value & 255
    buffer[at + 1] = (value >> 8) & 255


@compiled
def put32(buffer: Bytes, at: int, value: int) -> None:
    put16(buffer, at, value & 65535)
    put16(buffer, at + 2, (value >> 16) & 65535)


@compiled
def log_pulse(
    st: Floats,
    ist: Ints,
    time_ns: int,
    number: int,
    pulse_class: int,
    delay: float,
    discharge: float,
    plateau: float,
    energy: float,
    blocks: Bytes,
    pulses: Bytes,
) -> None:
    """Add one pulse to the log asked for: a 6-byte record each, or sums over blocks (layouts of the wire)."""
    if ist[LOG_N] == 0 and ist[BLOCK_COUNT] == 0:
        ist[LOG_PULSE_NO] = number
        ist[LOG_T0] = time_ns
    if ist[PULSE_LOG] == LOG_FULL:
        at = ist[LOG_N] * 6
        pulses[at] = pulse_class
        put16(pulses, at + 1, min(65535, int(delay * 10.0 + 0.5)))
        put16(pulses, at + 3, min(65535, int(discharge * 10.0 + 0.5)))
        pulses[at + 5] = min(255, int(plateau * 2.0 + 0.5))
        ist[LOG_N] += 1
        return
    ist[BLOCK_OPEN + pulse_class] += 1
    st[DELAY_SUM] += delay
    st[ENERGY_SUM] += energy
    ist[BLOCK_COUNT] += 1
    if ist[BLOCK_COUNT] == ist[BLOCK_SIZE]:
        close_block(st, ist, blocks)


@compiled
def close_block(st: Floats, ist: Ints, blocks: Bytes) -> None:
    """Write the block record begun, if any."""
    if ist[BLOCK_COUNT] == 0:
        return
    at = ist[LOG_N] * 12
    for i in range(4):
        blocks[at + i] = ist[BLOCK_OPEN + i]
        ist[BLOCK_OPEN + i] = 0
    put32(blocks, at + 4, int(st[DELAY_SUM] * 10.0 + 0.5))
    put32(blocks, at + 8, int(st[ENERGY_SUM] * 10.0 + 0.5))
    st[DELAY_SUM] = 0.0
    st[ENERGY_SUM] = 0.0
    ist[BLOCK_COUNT] = 0
    ist[LOG_N] += 1


# ======================================================================================== controller: the command
@compiled
def command_tick(par: Floats, st: Floats, ist: Ints) -> None:
    """Move the actuator's command by one millisecond, within slew and range, onto the converter's grid."""
    mode = ist[MODE]
    v = st[COMMAND_V]
    before = v
    if mode in (RAMP, TOUCH_BACK):
        step = st[RAMP_V_S] * TICK_S
        v = min(st[TARGET_V], v + step) if st[TARGET_V] > v else max(st[TARGET_V], v - step)
    elif mode == APPROACH:
        if ist[PHASE] >= SETTLE_TICKS:
            v += st[SLOW_V_S] * TICK_S
    elif mode == SERVO:
        v += st[RATE_V_S] * TICK_S
    elif mode in (JUMP_UP, JUMP_DOWN):
        share = s_curve(ist[PHASE] + 1, ist[PHASE_TICKS])
        back = st[JUMP_V] if mode == JUMP_UP else st[CLEARANCE_V] - st[JUMP_V]
        v = (st[START_V] if mode == JUMP_UP else st[START_V] - st[JUMP_V]) - back * share
    elif mode in (JUMP_RETURN, TOUCH_FAST):
        v += st[FAST_V_S] * TICK_S
    elif mode == TOUCH_SLOW:
        v += st[SLOW_V_S] * TICK_S
    elif mode == TOUCH_HUNT:
        v += (-1.0 if ist[CONTACT] == 1 else 1.0) * st[SLOW_V_S] * TICK_S
    most = par[SLEW_LIMIT] * TICK_S
    ist[SLEWED] = 1 if abs(v - before) > most else 0
    v = min(before + most, max(before - most, v))
    ist[LIMIT_TICKS] = ist[LIMIT_TICKS] + 1 if v > par[PIEZO_MAX] else 0
    v = min(par[PIEZO_MAX], max(0.0, v))
    st[COMMAND_V] = v
    st[APPLIED_V] = math.floor(v * STEPS_PER_V + 0.5) * DAC_V


@compiled
def s_curve(tick: int, ticks: int) -> float:
    """Share of a ramp after `tick` of `ticks`: constant speed with soft ends, so that the tool does not ring."""
    blend = min(BLEND_TICKS, 0.5 * ticks)
    peak = 1.0 / (ticks - blend)
    if tick < blend:
        return float(0.5 * peak * tick * tick / blend)
    if tick <= ticks - blend:
        return float(peak * (tick - 0.5 * blend))
    rest = ticks - tick
    return float(1.0 - 0.5 * peak * rest * rest / blend)


# ============================================================================================= controller: servo
@compiled
def servo_tick(par: Floats, st: Floats, ist: Ints, history: Floats) -> None:
    """Gap servo: filtered mean gap voltage -> comparator -> + or - ramp from the present level (or PI velocity).

    Muralidhara et al. 2009, Fig. 6. Decisions fall every SERVO_TICKS and act on the value SERVO_LATENCY
    decisions old. `history` is a ring of normalised voltages.
    """
    count = ist[SERVO_COUNT]
    if ist[SERVO_TICKS] > 1 and ist[PHASE] % ist[SERVO_TICKS] != 0:
        return
    per_duty_v = par[PER_DUTY_V]
    history[count & (HISTORY - 1)] = st[GAP_V] * per_duty_v
    ist[SERVO_COUNT] = count + 1
    s = history[max(0, count - ist[SERVO_LATENCY]) & (HISTORY - 1)]
    error = s - st[GAP_REF] * per_duty_v
    if ist[SHORTED] == 1:
        hurry = 4.0 if ist[SHORT_TICKS] > SHORT_HURRY_TICKS else 1.0
        st[RATE_V_S] = -hurry * par[SHORT_BACK] * par[V_PER_UM]
        ist[DIRECTION] = -1
        return
    if ist[LAW] == RELAY:
        if error > 0.5 * par[HYSTERESIS]:
            ist[DIRECTION] = 1
        elif error < -0.5 * par[HYSTERESIS]:
            ist[DIRECTION] = -1
        st[RATE_V_S] = (par[FORWARD] if ist[DIRECTION] > 0 else -par[BACK]) * par[V_PER_UM]
        return
    dt = ist[SERVO_TICKS] * TICK_S
    st[INTEGRAL] = min(par[FORWARD], max(-par[BACK], st[INTEGRAL] + par[KI] * error * dt))
    speed = min(par[FORWARD], max(-par[BACK], par[KP] * error + st[INTEGRAL]))
    ist[DIRECTION] = 1 if speed >= 0.0 else -1
    st[RATE_V_S] = speed * par[V_PER_UM]


@compiled
def measure_gap(par: Floats, st: Floats, ist: Ints, voltage_sum: float, count: int, shorts: int) -> int:
    """Feed the low-pass with this tick's mean gap voltage and keep the counters of the discharge faults.

    Between slow pulses ticks pass without one; the next pulse then speaks for all of them.
    """
    if count == 0:
        ist[SILENT_TICKS] += 1
        return NOTHING
    elapsed = ist[SILENT_TICKS] + 1
    ist[SILENT_TICKS] = 0
    mean_v = voltage_sum / count
    st[TICK_GAP_V] = mean_v
    keep = 1.0 - par[FILTER_ALPHA]
    st[GAP_V] = mean_v + (st[GAP_V] - mean_v) * (keep if elapsed == 1 else keep**elapsed)
    if shorts == count:
        ist[SHORTED] = 1
        ist[SHORT_TICKS] += elapsed
    else:
        ist[SHORTED] = 0
        ist[SHORT_TICKS] = 0
    if mean_v > 0.999 * par[DUTY_V]:
        # Open pulses on the way back from a retraction are no loss: only those at the last spark count.
        if st[SLOW_Z] >= st[LAST_SPARK_Z] - 1.0:
            ist[OPEN_TICKS] += elapsed
    else:
        ist[OPEN_TICKS] = 0
        st[LAST_SPARK_Z] = st[SENSOR_Z]  # the slow reading lags behind a tool that comes back from a jump
    if ist[MISREADS] >= ist[MISREADS_MAX]:
        return FAULT_GAP_SENSOR
    # Current over voltage drop in a discharge is the conductance that the generator really has.
    if st[TICK_CHARGE] > 0.0 and (
        par[OFF_TIME_A] > 0.0 or par[SIEMENS] > par[OVER_CURRENT] * par[NOMINAL_SIEMENS]
    ):
        return FAULT_GENERATOR
    if ist[SHORT_TICKS] > ist[SHORT_TICKS_MAX]:
        return FAULT_SHORT
    if ist[ARC_RUN] >= ist[ARC_RUN_MAX]:
        return FAULT_ARC
    return NOTHING


@compiled
def monitor_tick(par: Floats, st: Floats, ist: Ints) -> int:
    """Look at the voltage monitor of the actuator's amplifier: in its range, and near the command?"""
    monitor_v = monitor(par, st)
    if monitor_v > par[MONITOR_MAX] or monitor_v < par[MONITOR_MIN]:
        return FAULT_MONITOR
    if abs(st[APPLIED_V] - monitor_v) > par[TRACK_V]:
        ist[TRACK_TICKS] = ist[TRACK_TICKS] + 1 if ist[TRACK_AT] == ist[TICK] - 1 else 1
        ist[TRACK_AT] = ist[TICK]
        if ist[TRACK_TICKS] >= ist[TRACK_TICKS_MAX]:
            return FAULT_TRACK
    return NOTHING


@compiled
def monitor(par: Floats, st: Floats) -> float:
    """What the voltage monitor reads."""
    return float(par[MONITOR_GAIN] * st[AMPLIFIER_V] + par[MONITOR_ZERO])


# ========================================================================================== controller: sequences
@compiled
def sequence_tick(par: Floats, st: Floats, ist: Ints, history: Floats, noise: Floats) -> int:
    """Where the running motion stands after this tick: go on, change phase, or report what happened."""
    mode = ist[MODE]
    ist[PHASE] += 1
    if mode == HOLD:
        return NOTHING
    if mode == RAMP:
        if ist[CONTACT] == 1 and st[TARGET_V] > st[COMMAND_V]:
            return FAULT_COLLISION
        return end_motion(ist, RAMP_DONE) if st[COMMAND_V] == st[TARGET_V] else NOTHING
    if ist[LIMIT_TICKS] > LIMIT_TICKS_MAX:
        return FAULT_TRAVEL
    if mode == APPROACH:
        return approach_tick(st, ist)
    if mode == SERVO:
        return cut_tick(par, st, ist, history)
    if mode <= JUMP_RETURN:
        return jump_tick(par, st, ist)
    if mode >= TEST_OFF:
        return test_tick(st, ist)
    return touch_tick(par, st, ist, noise)


@compiled
def end_motion(ist: Ints, happened: int) -> int:
    """Pulses off, hold tool and stages, report."""
    ist[PULSES_ON] = 0
    ist[SCANNING] = 0
    ist[PATH_COUNT] = 0
    enter(ist, HOLD)
    return happened


@compiled
def enter(ist: Ints, mode: int) -> None:
    ist[MODE] = mode
    ist[PHASE] = 0
    ist[LIMIT_TICKS] = 0


@compiled
def approach_tick(st: Floats, ist: Ints) -> int:
    if ist[PHASE] <= SETTLE_TICKS:
        return NOTHING
    if st[GAP_V] <= st[GAP_REF]:
        return end_motion(ist, SPARK_FOUND)
    if st[SLOW_Z] - st[START_Z] > st[Z_MAX]:
        return FAULT_NO_SPARK
    return NOTHING


@compiled
def cut_tick(par: Floats, st: Floats, ist: Ints, history: Floats) -> int:
    servo_tick(par, st, ist, history)
    ist[TIME_TICKS] -= 1
    if ist[SCANNING] == 1:
        hold_at_limit(par, st)
        if st[SLOW_Z] >= st[Z_LIMIT] - HELD_WITHIN_UM:
            ist[OPEN_TICKS] = min(ist[OPEN_TICKS], LOST_TICKS + 1)  # where it waits, time tells nothing
    elif st[SLOW_Z] >= st[Z_LIMIT]:
        return end_motion(ist, CUT_DONE)
    if ist[TIME_TICKS] <= 0:
        return end_motion(ist, TIME_UP)
    lost = ist[OPEN_TICKS] > LOST_TICKS and st[SLOW_Z] - st[LAST_SPARK_Z] > par[OPEN_LOST]
    if lost or ist[OPEN_TICKS] > ist[OPEN_TICKS_MAX]:
        return FAULT_NO_SPARK
    return NOTHING


@compiled
def hold_at_limit(par: Floats, st: Floats) -> None:
    """Let the servo feed no faster than brings a scanning tool softly to its limit, from either side."""
    most = HOLD_PER_S * (st[Z_LIMIT] - st[SLOW_Z])
    if st[RATE_V_S] > most * par[V_PER_UM]:
        st[RATE_V_S] = max(most, -par[BACK]) * par[V_PER_UM]
        st[INTEGRAL] = min(st[INTEGRAL], max(0.0, most))


@compiled
def stage_tick(st: Floats, ist: Ints, path: Floats) -> int:
    """Move the stages of a scan by one millisecond along the path, and the limit with them.

    `path` is a ring of PATH_LINES lines. Nothing moves while the gap is shorted, or in a jump.
    """
    if ist[MODE] != SERVO or ist[SHORTED] == 1:
        return NOTHING
    left_s = TICK_S
    while ist[PATH_COUNT] > 0 and left_s > 0.0:
        line = path[ist[PATH_AT]]
        x, y = line[PATH_X] - st[STAGE_X], line[PATH_Y] - st[STAGE_Y]
        way = math.sqrt(x * x + y * y)
        needed_s = way / line[PATH_SPEED]
        if needed_s > left_s:
            share = left_s / needed_s
            st[STAGE_X] += share * x
            st[STAGE_Y] += share * y
            st[STAGE_ERROR_X] += share * (line[PATH_ERROR_X] - st[STAGE_ERROR_X])
            st[STAGE_ERROR_Y] += share * (line[PATH_ERROR_Y] - st[STAGE_ERROR_Y])
            st[Z_LIMIT] += share * (line[PATH_Z] - st[Z_LIMIT])
            st[STAGE_WAY] += share * way
            return NOTHING
        left_s -= needed_s
        st[STAGE_X], st[STAGE_Y] = line[PATH_X], line[PATH_Y]
        st[STAGE_ERROR_X], st[STAGE_ERROR_Y] = line[PATH_ERROR_X], line[PATH_ERROR_Y]
        st[Z_LIMIT] = line[PATH_Z]
        st[STAGE_WAY] += way
        ist[PATH_AT] = (ist[PATH_AT] + 1) % PATH_LINES
        ist[PATH_COUNT] -= 1
        if line[PATH_LAST] == 1.0:
            return end_motion(ist, PATH_DONE)
    return NOTHING


@compiled
def jump_tick(par: Floats, st: Floats, ist: Ints) -> int:
    mode = ist[MODE]
    if mode == JUMP_UP and ist[PHASE] >= ist[PHASE_TICKS]:
        enter(ist, JUMP_DWELL)
    elif mode == JUMP_DWELL and ist[PHASE] >= ist[DWELL_TICKS]:
        enter(ist, JUMP_DOWN)
    elif mode == JUMP_DOWN and ist[PHASE] >= ist[PHASE_TICKS]:
        if ist[JUMP_RESUMES] == 0:
            return end_motion(ist, JUMP_DONE)
        enter(ist, JUMP_RETURN)
        ist[PULSES_ON] = 1
        ist[NEXT_PULSE] = (ist[TICK] + 1) * TICK_NS
        st[TICK_GAP_V] = par[OPEN_V]
        return JUMP_RESUMED
    elif mode == JUMP_RETURN and jump_is_back(st):
        enter(ist, SERVO)
        ist[OPEN_TICKS] = 0
        return JUMP_DONE
    return NOTHING


@compiled
def jump_is_back(st: Floats) -> bool:
    """A millisecond as busy as the reference asks for, or well past where the jump began."""
    busy = st[TICK_GAP_V] <= st[GAP_REF]
    return bool(busy or st[COMMAND_V] >= st[START_V] + st[CLEARANCE_V])


@compiled
def touch_tick(par: Floats, st: Floats, ist: Ints, noise: Floats) -> int:
    mode = ist[MODE]
    if ist[STRAY_PULSES] > 0:
        return FAULT_MODE_SWITCH
    if ist[CONTACT] == 1 and st[TICK_GAP_V] > par[SHORT_BELOW]:
        return FAULT_GAP_SENSOR
    if st[SLOW_Z] > st[Z_MAX]:
        return FAULT_NO_CONTACT
    if mode == TOUCH_FAST:
        if ist[CONTACT] == 1:
            back_off(st, ist)
        elif st[SENSOR_Z] >= st[FAST_TO]:
            enter(ist, TOUCH_SLOW)
    elif mode == TOUCH_SLOW:
        if ist[CONTACT] == 1:
            st[TOUCH_V] = st[APPLIED_V]
            st[TOUCH_SUM] = 0.0
            ist[TOUCH_COUNT] = 0
            enter(ist, TOUCH_HUNT)
    elif mode == TOUCH_HUNT:
        st[TOUCH_SUM] += st[SENSOR_Z]
        ist[TOUCH_COUNT] += 1
        if ist[PHASE] >= ist[DWELL_TICKS]:
            ist[TOUCH_NO] += 1
            ist[TOUCHES_LEFT] -= 1
            back_off(st, ist)
            return TOUCHED
    elif st[COMMAND_V] == st[TARGET_V] and ist[PHASE] >= BACK_OFF_TICKS:
        if ist[CONTACT] == 1:
            return FAULT_STUCK_CONTACT
        if ist[TOUCHES_LEFT] <= 0:
            return end_motion(ist, TOUCHES_DONE)
        st[ASPERITY] = par[CONTACT_SD] * noise[ist[NOISE_AT]]
        ist[NOISE_AT] += 1
        enter(ist, TOUCH_SLOW)
    return NOTHING


@compiled
def back_off(st: Floats, ist: Ints) -> None:
    st[TARGET_V] = max(0.0, st[COMMAND_V] - st[BACK_V])
    st[RAMP_V_S] = st[FAST_V_S]
    enter(ist, TOUCH_BACK)


@compiled
def test_tick(st: Floats, ist: Ints) -> int:
    """Self test of the gap sensor: its mean with the generator off, then with the generator on."""
    ticks = TEST_OFF_TICKS if ist[MODE] == TEST_OFF else TEST_ON_TICKS
    if ist[PHASE] > ticks - TEST_MEAN_TICKS:
        st[TOUCH_SUM] += st[TICK_GAP_V]
        ist[TOUCH_COUNT] += 1
    if ist[PHASE] < ticks:
        return NOTHING
    if ist[MODE] == TEST_ON:
        return end_motion(ist, TESTED)
    st[TEST_OFF_V] = st[TOUCH_SUM] / ist[TOUCH_COUNT]
    st[TOUCH_SUM] = 0.0
    ist[TOUCH_COUNT] = 0
    ist[PULSES_ON] = 1
    ist[NEXT_PULSE] = (ist[TICK] + 1) * TICK_NS
    enter(ist, TEST_ON)
    return NOTHING


# =========================================================================================== controller: telemetry
@compiled
def write_sample(st: Floats, ist: Ints, tlm: Bytes) -> None:
    """Write a telemetry sample (16 bytes, layout of the wire)."""
    ist[TLM_NEXT] += ist[TLM_TICKS]
    at = ist[TLM_N] * 16
    put32(tlm, at, math.floor(st[SENSOR_Z] * 1000.0 + 0.5))
    put16(tlm, at + 4, int(st[APPLIED_V] * STEPS_PER_V + 0.5))
    put16(tlm, at + 6, min(65535, int(st[GAP_V] * 200.0 + 0.5)))
    mean_a = st[CHARGE] / (ist[TLM_TICKS] * 1000.0)
    put16(tlm, at + 8, min(65535, int(mean_a * 1000.0 + 0.5)))
    counts = ist[SAMPLE_COUNTS]
    tlm[at + 10] = min(255, count_of(counts, NORMAL))
    tlm[at + 11] = min(255, count_of(counts, ARC))
    tlm[at + 12] = min(255, count_of(counts, SHORT))
    tlm[at + 13] = min(255, count_of(counts, OPEN))
    tlm[at + 14] = ist[TLM_STATE]
    tlm[at + 15] = flags_of(ist)
    ist[TLM_N] += 1
    st[CHARGE] = 0.0
    ist[SAMPLE_COUNTS] = 0


@compiled
def flags_of(ist: Ints) -> int:
    """TlmFlags of now."""
    flags = ist[PULSES_ON] | ist[CONTACT] << 1 | ist[SHORTED] << 3 | ist[SLEWED] << 5
    flags |= (ist[DIRECTION] > 0) << 2 | (ist[LIMIT_TICKS] > 0) << 4
    return int(flags)


@compiled
def write_box(st: Floats, ist: Ints, box: Floats) -> None:
    """Keep this millisecond in the ring; whoever reads it makes a sample of it."""
    row = ist[TICK] & (BOX - 1)
    box[row, 0] = st[SENSOR_Z]
    box[row, 1] = st[APPLIED_V]
    box[row, 2] = st[GAP_V]
    box[row, 3] = st[TICK_CHARGE]
    box[row, 4] = ist[TICK_COUNTS]
    box[row, 5] = ist[TLM_STATE] * 256 + flags_of(ist)


@cached
def run(
    ticks: int,
    par: Floats,
    st: Floats,
    ist: Ints,
    plays: Floats,
    creep: Floats,
    history: Floats,
    random: Floats,
    tables: Floats,
    noise: Floats,
    tlm: Bytes,
    blocks: Bytes,
    pulses: Bytes,
    box: Floats,
    recent: Floats,
    path: Floats,
    levels: Floats,
) -> int:
    """Advance by up to `ticks` ms; stops early when something happened and says what (NOTHING .. LOOK).

    The caller provides `random` columns for every pulse and `noise` for every tick (two each, and touches).
    Zero ticks close the pulse block begun, for whoever wants to send everything now. `box`, shape
    (BOX, BOX_COLUMNS), is the ring of the last milliseconds, `recent` that of the last pulses; `path`, shape
    (PATH_LINES, PATH_COLUMNS), that of the lines to follow; `levels` is the table of what lies under the tool.
    """
    if ticks == 0:
        close_block(st, ist, blocks)
    for _ in range(ticks):
        command_tick(par, st, ist)
        actuator_tick(par, st, plays, creep)
        contact_tick(par, st, ist)
        pump_tick(par, st)
        if ist[TICK] & 63 == 0:  # depth changes by nanometres a tick
            renew_clearing(par, st, ist)
        happened = NOTHING
        if ist[PULSES_ON] == 1:
            voltage_sum, count, shorts = pulses_of_tick(par, st, ist, random, tables, blocks, pulses, recent)
            happened = measure_gap(par, st, ist, voltage_sum, count, shorts)
        else:
            rest_tick(par, st, ist)
        look = level_tick(par, st, ist, levels)
        sensor_tick(par, st, ist, noise)
        sequence = sequence_tick(par, st, ist, history, noise)
        if happened == NOTHING:
            happened = sequence
        if ist[WATCHED] == 1:
            voltage = monitor_tick(par, st, ist)
            if voltage != NOTHING:
                happened = voltage
        if ist[SCANNING] == 1 and happened == NOTHING:
            happened = stage_tick(st, ist, path)
            if st[STAGE_WAY] >= STAGE_STEP_UM:
                look = LOOK
        if happened == NOTHING:
            happened = look
        write_box(st, ist, box)
        if ist[TICK] + 1 == ist[TLM_NEXT]:
            write_sample(st, ist, tlm)
        ist[TICK] += 1
        if happened != NOTHING:
            return happened
    return NOTHING


@cached
def drive(
    command_v: Floats,
    par: Floats,
    st: Floats,
    ist: Ints,
    plays: Floats,
    creep: Floats,
    noise: Floats,
    applied_v: Floats,
    free_um: Floats,
    sensor_um: Floats,
) -> None:
    """Advance the actuator alone, one tick per command; voltage, displacement and reading go to the outputs (n,).

    Nothing stands in the tool's way. Commands pass the slew limit, the range and the converter as in
    `command_tick`. The caller provides `noise` for every tick, two each.
    """
    most = par[SLEW_LIMIT] * TICK_S
    for i in range(command_v.shape[0]):
        before = st[COMMAND_V]
        v = min(before + most, max(before - most, command_v[i]))
        v = min(par[PIEZO_MAX], max(0.0, v))
        st[COMMAND_V] = v
        st[APPLIED_V] = math.floor(v * STEPS_PER_V + 0.5) * DAC_V
        actuator_tick(par, st, plays, creep)
        st[TRUE_Z] = st[FREE_Z]
        sensor_tick(par, st, ist, noise)
        ist[TICK] += 1
        applied_v[i], free_um[i], sensor_um[i] = st[APPLIED_V], st[FREE_Z], st[SENSOR_Z]
