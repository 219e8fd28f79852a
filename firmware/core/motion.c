/* What moves the tool, millisecond by millisecond: the command within slew and range, and where a motion stands. */
#include "core.h"

#define SETTLE_TICKS 100 /* generator on before the approach judges the gap voltage */
#define LIMIT_TICKS_MAX 500 /* fault 2001 */

/* Begins a mode. */
void motion_enter(struct edm_controller *c, enum edm_mode mode) {
    c->motion.mode = mode;
    c->motion.phase = 0;
    c->motion.limit_ticks = 0;
    c->motion.rest_v = 0;
}

/* Shuts the gate of the generator at once, or lets it open with the millisecond that begins: what that one's end finds,
 * and inputs, watchdog and line before it, may still forbid it. Opening begins the period of the pulses anew. */
void motion_gate(struct edm_controller *c, bool on) {
    c->drive.pulses_on = on;
    if (on) {
        c->drive.pulse_starts++;
        c->gap.silent_ticks = 0;
    } else {
        c->motion.gate_open = false;
        hal_gate(c->board, false);
    }
}

/* Opens the gate where pulses are to flow in the millisecond that begins. */
void motion_open_gate(struct edm_controller *c) {
    if (c->drive.pulses_on && !c->motion.gate_open) {
        c->motion.gate_open = true;
        hal_gate(c->board, true);
    }
}

/* Pulses off, tool and stages held where they are. */
void motion_hold(struct edm_controller *c) {
    motion_gate(c, false);
    scan_end(c);
    motion_enter(c, HOLD);
}

/* Whether the converter goes up for a voltage: both as it makes them, for float rounds them in different ways. */
bool motion_feeds(const struct edm_controller *c, real target_v) {
    return on_grid(target_v) > c->drive.actuator_v;
}

/* Pulses off, then the actuator ramps to a voltage. */
void motion_ramp(struct edm_controller *c, real target_v, real slew_v_s) {
    motion_gate(c, false);
    scan_end(c);
    c->motion.target_v = target_v;
    c->motion.ramp_v_s = slew_v_s;
    c->motion.feeds = motion_feeds(c, target_v);
    motion_enter(c, RAMP);
}

/* Pulses on, with fresh counters of what would stop them. */
void motion_pulses_on(struct edm_controller *c) {
    struct edm_gap *gap = &c->gap;
    motion_gate(c, true);
    gap->open_ticks = gap->short_ticks = 0;
    gap->sparkless_ticks = 0;
    gap->shorted = false;
    gap->arc_run = gap->misreads = 0;
    gap->last_spark_um = gap_place(c);
}

/* Ends a motion within a tick: pulses off, tool and stages held; returns what happened. */
int motion_end(struct edm_controller *c, int happened) {
    motion_gate(c, false);
    c->scan.scanning = false;
    c->scan.count = 0;
    motion_enter(c, HOLD);
    return happened;
}

/* The command a millisecond later at a slope. What it asks for is compared as it was told: sums are rounded. */
static real sloped(struct edm_controller *c, real slope_v_s) {
    struct edm_motion *m = &c->motion;
    m->slewed = magnitude(slope_v_s) > c->settings.slew_limit_v_s;
    return added(m->command_v, slope_v_s * TICK_S, &m->rest_v);
}

/* The command of a ramp after one more millisecond, V. */
static real ramp_command(struct edm_controller *c) {
    struct edm_motion *m = &c->motion;
    bool is_up = m->target_v > m->command_v;
    real v = sloped(c, is_up ? m->ramp_v_s : -m->ramp_v_s);
    m->slewed = m->slewed && magnitude(m->target_v - m->command_v) > c->settings.slew_limit_v_s * TICK_S;
    return is_up ? least(m->target_v, v) : most(m->target_v, v);
}

/* Where the mode wants the command, before slew and range. A jump asks for no more than the limit by its plan. */
static real wanted_command(struct edm_controller *c) {
    struct edm_motion *m = &c->motion;
    m->slewed = false;
    switch (m->mode) {
    case SERVO:
        return sloped(c, c->servo.rate_v_s);
    case RAMP:
    case TOUCH_BACK:
        return ramp_command(c);
    case APPROACH:
        return m->phase >= SETTLE_TICKS && !c->gap.shorted ? sloped(c, m->slow_v_s) : m->command_v;
    case JUMP_UP:
    case JUMP_DOWN:
        return jump_command(c);
    case JUMP_RETURN:
    case TOUCH_FAST:
        return sloped(c, m->fast_v_s);
    case TOUCH_SLOW:
        return sloped(c, m->slow_v_s);
    case TOUCH_HUNT: /* the slope flips with the contact */
        return sloped(c, (c->readings.contact ? R(-1.0) : R(1.0)) * m->slow_v_s);
    case HOLD:
    case JUMP_DWELL:
    case TEST_OFF:
    case TEST_ON:
    default:
        return m->command_v;
    }
}

/* Moves the command by one millisecond, within slew and range, onto the converter's grid (2.5 mV). */
void motion_command(struct edm_controller *c) {
    struct edm_motion *m = &c->motion;
    real before = m->command_v;
    real v = wanted_command(c);
    real step = c->settings.slew_limit_v_s * TICK_S;
    v = least(before + step, most(before - step, v));
    real top = most(c->settings.piezo_max_v, before); /* what a reset has left beyond the range comes down by its ramp */
    m->limit_ticks = v > top ? m->limit_ticks + 1 : 0;
    m->command_v = least(top, most(0, v));
    c->drive.actuator_v = on_grid(m->command_v);
}

/* APPROACH: sparks pull the mean gap voltage down to the reference; max_travel_um without them is fault 3005. */
static int approach_tick(struct edm_controller *c) {
    if (c->motion.phase <= SETTLE_TICKS) {
        return NOTHING;
    }
    if (c->gap.gap_v <= c->servo.gap_ref_v) {
        return motion_end(c, SPARK_FOUND);
    }
    real z_um = c->gap.slow_displacement_um;
    if (z_um >= DISPLACEMENT_FAILED_UM || z_um - c->motion.start_z_um > c->motion.z_max_um) {
        return FAULT_NO_SPARK;
    }
    return NOTHING;
}

/* Where the running motion stands after this tick: goes on, changes its phase, or tells what happened. */
int motion_tick(struct edm_controller *c) {
    struct edm_motion *m = &c->motion;
    m->phase++;
    if (m->mode == HOLD) {
        return NOTHING;
    }
    if (m->mode == RAMP) {
        if (c->readings.contact && m->feeds) {
            return FAULT_COLLISION;
        }
        bool there = !(m->command_v < m->target_v || m->command_v > m->target_v);
        return there ? motion_end(c, RAMP_DONE) : NOTHING;
    }
    if (m->limit_ticks > LIMIT_TICKS_MAX) {
        return FAULT_TRAVEL_LIMIT;
    }
    switch (m->mode) {
    case APPROACH:
        return approach_tick(c);
    case SERVO:
        return servo_tick(c);
    case JUMP_UP:
    case JUMP_DWELL:
    case JUMP_DOWN:
    case JUMP_RETURN:
        return jump_tick(c);
    case TEST_OFF:
    case TEST_ON:
        return self_test_tick(c);
    case TOUCH_FAST:
    case TOUCH_SLOW:
    case TOUCH_HUNT:
    case TOUCH_BACK:
    case HOLD:
    case RAMP:
    default:
        return touch_tick(c);
    }
}
