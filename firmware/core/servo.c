/* The gap servo (SERVO_START, SCAN_START). Muralidhara et al. 2009, Fig. 6: filtered mean gap voltage, comparator, ramp up
 * or down from the present level; or a PI law for the velocity. */
#include "core.h"

#define SHORT_HURRY_TICKS 500 /* a short this long retracts four times as fast */
#define HOLD_PER_S R(4.0) /* of the way to a scan's limit; well below the bandwidth of the displacement's low-pass */
#define HELD_WITHIN_UM R(1.0) /* of its limit a scanning tool is held */
#define LOST_TICKS 100 /* all open, before the way since the last spark counts */

/* Full speed one way or the other; `error` is the gap voltage above its reference, over the duty voltage. */
static void relay(struct edm_controller *c, real error) {
    const struct edm_settings *s = &c->settings;
    struct edm_servo *servo = &c->servo;
    if (error > R(0.5) * s->hysteresis) {
        servo->direction = 1;
    } else if (error < R(-0.5) * s->hysteresis) {
        servo->direction = -1;
    }
    servo->rate_v_s = (servo->direction > 0 ? s->forward_um_s : -s->back_um_s) * s->v_per_um;
}

/* Speed in proportion to that error and to its integral, within the two speeds. */
static void pi_law(struct edm_controller *c, real error) {
    const struct edm_settings *s = &c->settings;
    struct edm_servo *servo = &c->servo;
    real dt = (real)s->servo_ticks * TICK_S;
    servo->integral_um_s =
        least(s->forward_um_s, most(-s->back_um_s, servo->integral_um_s + s->ki_um_s2 * error * dt));
    real speed = least(s->forward_um_s, most(-s->back_um_s, s->kp_um_s * error + servo->integral_um_s));
    servo->direction = speed >= 0 ? 1 : -1;
    servo->rate_v_s = speed * s->v_per_um;
}

/* One decision, every servo_period_us, on the value that is servo_latency decisions old; voltages over duty x open. */
static void decide(struct edm_controller *c) {
    const struct edm_settings *s = &c->settings;
    struct edm_servo *servo = &c->servo;
    if (s->servo_ticks > 1 && c->motion.phase % s->servo_ticks != 0) {
        return;
    }
    uint32_t count = servo->count;
    uint32_t latency = (uint32_t)s->latency_decisions;
    servo->history[count % HISTORY] = c->gap.gap_v * s->per_duty_v;
    servo->count = count + 1;
    real seen = servo->history[(count > latency ? count - latency : 0) % HISTORY];
    real error = seen - servo->gap_ref_v * s->per_duty_v;
    if (c->gap.shorted) {
        real hurry = c->gap.short_ticks > SHORT_HURRY_TICKS ? R(4.0) : R(1.0);
        servo->rate_v_s = -hurry * s->short_back_um_s * s->v_per_um;
        servo->direction = -1;
    } else if (s->law == SERVO_LAW_RELAY) {
        relay(c, error);
    } else {
        pi_law(c, error);
    }
}

/* Lets the servo feed no faster than brings a scanning tool softly to its limit, from either side. Nothing slows down the
 * way back out of a short. */
static void hold_at_limit(struct edm_controller *c) {
    const struct edm_settings *s = &c->settings;
    struct edm_servo *servo = &c->servo;
    real fastest = HOLD_PER_S * (servo->z_limit_um - c->gap.slow_displacement_um);
    if (servo->rate_v_s > fastest * s->v_per_um) {
        servo->rate_v_s = least(servo->rate_v_s, most(fastest, -s->back_um_s) * s->v_per_um);
        servo->integral_um_s = least(servo->integral_um_s, most(0, fastest));
    }
}

/* What no millisecond with pulses of a cut or scan passes: a depth that is not known (fault 2001), lost sparks (3005). Its time
 * counts. */
int servo_watch(struct edm_controller *c) {
    struct edm_gap *gap = &c->gap;
    if (gap->displacement_um >= DISPLACEMENT_FAILED_UM) {
        return FAULT_TRAVEL_LIMIT; /* nobody knows how deep: no limit that has been reached */
    }
    c->servo.time_ticks--;
    bool held = c->scan.scanning && gap->slow_displacement_um >= c->servo.z_limit_um - HELD_WITHIN_UM;
    if (held && gap->open_ticks > LOST_TICKS + 1) {
        gap->open_ticks = LOST_TICKS + 1; /* where it waits, time tells nothing */
    }
    real way_um = gap->slow_displacement_um - gap->last_spark_um;
    bool lost = gap->open_ticks > LOST_TICKS && way_um > c->settings.open_lost_um;
    return lost || (!held && gap->open_ticks > c->settings.open_ticks_max) ? FAULT_NO_SPARK : NOTHING;
}

/* Whether the tool is at its limit. */
bool servo_is_deep(const struct edm_controller *c) {
    return c->gap.slow_displacement_um >= c->servo.z_limit_um;
}

/* A millisecond of a cut or scan: the end of the one, the hold of the other, time, and what is watched. */
int servo_tick(struct edm_controller *c) {
    int found = servo_watch(c);
    if (found == FAULT_TRAVEL_LIMIT) {
        return found;
    }
    decide(c);
    if (c->scan.scanning) {
        hold_at_limit(c);
    } else if (servo_is_deep(c)) {
        return motion_end(c, CUT_DONE);
    }
    return c->servo.time_ticks <= 0 ? motion_end(c, TIME_UP) : found;
}
