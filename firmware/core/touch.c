/* TOUCH_OFF: fast, slow until contact, hunt about it for a dwell, back off; n touches. */
#include "core.h"

#define BACK_OFF_TICKS 200 /* for the contact to open after a back-off */
#define OPEN_TICKS 50      /* in a row it has to be open at rest: one that comes and goes tells no place */
#define PATIENCE_TICKS 100 /* more for that, so that a single disturbance is no fault */

/* Lets the tool go back by back_off_um, not below 0 V. */
static void back_off(struct edm_controller *c) {
    struct edm_motion *m = &c->motion;
    m->target_v = most(0, m->command_v - c->touch.back_v);
    m->ramp_v_s = m->fast_v_s;
    m->phase_ticks = 0; /* known when the ramp has ended */
    motion_enter(c, TOUCH_BACK);
}

/* The mean of the sensor while hunting is the touch. */
static int hunt(struct edm_controller *c) {
    struct edm_touch *touch = &c->touch;
    touch->sum = added(touch->sum, c->gap.displacement_um, &touch->rest);
    touch->count++;
    if (c->motion.phase < c->motion.dwell_ticks) {
        return NOTHING;
    }
    touch->number++;
    touch->left--;
    back_off(c);
    return TOUCHED;
}

/* The tool rests after a back-off until contact has been open for a while; then the next touch, or the end. */
static int end_of_back_off(struct edm_controller *c) {
    struct edm_motion *m = &c->motion;
    if (m->phase_ticks == 0) { /* the ramp has just ended */
        m->phase_ticks = m->phase + OPEN_TICKS > BACK_OFF_TICKS ? m->phase + OPEN_TICKS : BACK_OFF_TICKS;
        c->touch.open_ticks = 0;
        return NOTHING;
    }
    c->touch.open_ticks = c->readings.contact ? 0 : c->touch.open_ticks + 1;
    if (m->phase < m->phase_ticks) {
        return NOTHING;
    }
    if (c->touch.open_ticks < OPEN_TICKS) {
        return m->phase < m->phase_ticks + PATIENCE_TICKS ? NOTHING : FAULT_STUCK_CONTACT;
    }
    if (c->touch.left <= 0) {
        return motion_end(c, TOUCHES_DONE);
    }
    c->drive.contact_tests++;
    motion_enter(c, TOUCH_SLOW);
    return NOTHING;
}

/* A millisecond of a touch: what it must not see, then its phase. */
int touch_tick(struct edm_controller *c) {
    const struct edm_motion *m = &c->motion;
    bool contact = c->readings.contact != 0;
    if (c->readings.stray_pulses > 0) {
        return FAULT_MODE_SWITCH;
    }
    if (contact && c->gap.tick_gap_v > c->settings.short_v) {
        return FAULT_GAP_SENSOR;
    }
    if (c->gap.slow_displacement_um >= DISPLACEMENT_FAILED_UM || c->gap.slow_displacement_um > m->z_max_um) {
        return FAULT_NO_CONTACT;
    }
    if (m->mode == TOUCH_FAST) {
        if (contact) {
            back_off(c);
        } else if (c->gap.displacement_um >= c->touch.fast_to_um) {
            motion_enter(c, TOUCH_SLOW);
        }
    } else if (m->mode == TOUCH_SLOW) {
        if (contact) {
            c->touch.peak_v = c->drive.actuator_v;
            c->touch.sum = c->touch.rest = 0;
            c->touch.count = 0;
            motion_enter(c, TOUCH_HUNT);
        }
    } else if (m->mode == TOUCH_HUNT) {
        return hunt(c);
    } else if (!(m->command_v > m->target_v || m->command_v < m->target_v)) {
        return end_of_back_off(c);
    }
    return NOTHING;
}
