/* JUMP: pulses off, up, dwell, down to a clearance above the start, then sparks and the way back to them. */
#include "core.h"

#define BLEND_TICKS R(8.0) /* of a ramp, at each end */

/* Share of a ramp after `tick` of `ticks`: constant speed with soft ends, so that the tool does not ring. */
static real s_curve(real tick, real ticks) {
    real blend = least(BLEND_TICKS, R(0.5) * ticks);
    real peak = R(1.0) / (ticks - blend);
    if (tick < blend) {
        return R(0.5) * peak * tick * tick / blend;
    }
    if (tick <= ticks - blend) {
        return peak * (tick - R(0.5) * blend);
    }
    real rest = ticks - tick;
    return R(1.0) - R(0.5) * peak * rest * rest / blend;
}

/* The command of the ramps up and down, V. */
real jump_command(const struct edm_controller *c) {
    const struct edm_jump *jump = &c->jump;
    real share = s_curve((real)(c->motion.phase + 1), (real)c->motion.phase_ticks);
    if (c->motion.mode == JUMP_UP) {
        return jump->start_v - jump->jump_v * share;
    }
    real back = jump->clearance_v - jump->jump_v;
    return (jump->start_v - jump->jump_v) - back * share;
}

/* A millisecond as busy as the reference asks for, or of shorts alone, which a reference below their voltage does not show, or
 * well past where the jump began; or the cut's limit or the end of its time, which the servo then finds. */
static bool is_back(const struct edm_controller *c) {
    return c->gap.tick_gap_v <= c->servo.gap_ref_v || (c->gap.shorted && c->readings.pulses > 0) ||
           c->motion.command_v >= c->jump.start_v + c->jump.clearance_v || servo_is_deep(c) ||
           c->servo.time_ticks <= 0;
}

/* A millisecond of the way back, with pulses: watched as the cut is. */
static int return_tick(struct edm_controller *c) {
    int found = servo_watch(c);
    if (found != NOTHING || !is_back(c)) {
        return found;
    }
    motion_enter(c, SERVO);
    c->gap.open_ticks = 0;
    return JUMP_IS_DONE;
}

/* A millisecond of a jump: its next phase, or the way on in the cut. */
int jump_tick(struct edm_controller *c) {
    const struct edm_motion *m = &c->motion;
    if (m->mode == JUMP_UP && m->phase >= m->phase_ticks) {
        motion_enter(c, JUMP_DWELL);
    } else if (m->mode == JUMP_DWELL && m->phase >= m->dwell_ticks) {
        motion_enter(c, JUMP_DOWN);
    } else if (m->mode == JUMP_DOWN && m->phase >= m->phase_ticks) {
        if (!c->jump.resumes) {
            return motion_end(c, JUMP_IS_DONE);
        }
        motion_enter(c, JUMP_RETURN);
        motion_gate(c, true);
        c->gap.tick_gap_v = c->settings.open_v;
        c->gap.open_ticks = 0;
        return JUMP_RESUMED;
    } else if (m->mode == JUMP_RETURN) {
        return return_tick(c);
    }
    return NOTHING;
}
