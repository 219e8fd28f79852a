/* SELF_TEST: the mean gap voltage with the generator off must be zero, with it on duty x open voltage. */
#include "core.h"

#define OFF_TICKS 100
#define ON_TICKS 200
#define MEAN_TICKS 100 /* the last ones of each half speak */

/* Begins the mean of a half. */
static void begin_mean(struct edm_touch *touch) {
    touch->sum = 0;
    touch->count = 0;
}

void self_test_begin(struct edm_controller *c) {
    begin_mean(&c->touch);
    c->gap.misreads = 0;
    c->gap.short_ticks = 0;
    motion_gate(c, false);
    motion_enter(c, TEST_OFF);
}

/* A millisecond of either half; the means are judged when both are there. */
int self_test_tick(struct edm_controller *c) {
    struct edm_touch *touch = &c->touch;
    int64_t ticks = c->motion.mode == TEST_OFF ? OFF_TICKS : ON_TICKS;
    if (c->motion.phase > ticks - MEAN_TICKS) {
        touch->sum += c->gap.tick_gap_v;
        touch->count++;
    }
    if (c->motion.phase < ticks) {
        return NOTHING;
    }
    if (c->motion.mode == TEST_ON) {
        return motion_end(c, TESTED);
    }
    touch->test_off_v = touch->sum / (real)touch->count;
    begin_mean(touch);
    motion_gate(c, true);
    motion_enter(c, TEST_ON);
    return NOTHING;
}

/* TEST_DONE with the mean in mV, or fault 3003. */
void self_test_judge(struct edm_controller *c) {
    const struct edm_touch *touch = &c->touch;
    real duty_v = c->settings.duty_v;
    real on_v = touch->sum / (real)(touch->count > 1 ? touch->count : 1);
    int32_t on_mv = counts_i32(R(1000.0) * on_v);
    real error_v = c->settings.test_error * duty_v;
    if (!(magnitude(touch->test_off_v) <= error_v && magnitude(on_v - duty_v) <= error_v)) {
        states_raise(c, FAULT_GAP_SENSOR, on_mv);
        return;
    }
    states_enter(c, STATE_ARMED);
    events_emit_arg(c, EVENT_CODE_TEST_DONE, on_mv);
}
