/* Parameters: staged by SET_PARAM, current after COMMIT_PROFILE, made ready for the tick (docs/protocol.md, Parameters). */
#include "../math/elementary.h"
#include "core.h"

#define FULL_SCALE_V R(150.0) /* what track_error is a share of */
#define DISPLACEMENT_FILTER_S R(0.05) /* low-pass of the sensor for depth limits */
#define PI R(3.141592653589793)

/* Row of a parameter; -1 where there is none of that id. */
int parameters_row(uint16_t id) {
    for (int row = 0; row < PARAMS; row++) {
        if (edm_params[row].id == id) {
            return row;
        }
    }
    return -1;
}

/* The check of COMMIT_PROFILE and ARM over all wire values. */
static uint32_t check_of(const int32_t values[PARAMS]) {
    uint32_t crc = 0;
    for (int row = 0; row < PARAMS; row++) {
        uint8_t bytes[6];
        put_u16(bytes, edm_params[row].id);
        put_i32(bytes + 2, values[row]);
        crc = frame_crc(crc, bytes, sizeof bytes);
    }
    return crc;
}

/* A current value in the parameter's unit. */
static real value_of(const struct edm_controller *c, int row) {
    return (real)c->parameters.current[row] / (real)edm_params[row].divisor;
}

/* A current duration, s in the table, in ticks. */
static int32_t ticks_of(const struct edm_controller *c, int row) {
    return (int32_t)nearest(value_of(c, row) / TICK_S);
}

static int32_t at_least_one(int32_t value) {
    return value > 1 ? value : 1;
}

static real exponential(real x) {
#ifdef EDM_REAL_DOUBLE
    return edm_exp(x);
#else
    return edm_expf(x);
#endif
}

/* Makes ready for the tick what is current. */
static void apply(struct edm_controller *c) {
    struct edm_settings *s = &c->settings;
    const int32_t *wire = c->parameters.current;
    s->piezo_max_v = value_of(c, PARAM_PIEZO_MAX_V);
    s->slew_limit_v_s = value_of(c, PARAM_SLEW_LIMIT_V_S);
    s->v_per_um = R(1.0) / value_of(c, PARAM_GAIN_UM_PER_V);
    s->safe_z_um = value_of(c, PARAM_SAFE_Z_UM);
    s->retract_v_s = value_of(c, PARAM_RETRACT_V_S);
    s->sensor_missing = wire[PARAM_SENSOR_FITTED] == 0;
    s->law = wire[PARAM_SERVO_LAW];
    s->forward_um_s = value_of(c, PARAM_FORWARD_UM_S);
    s->back_um_s = value_of(c, PARAM_BACK_UM_S);
    s->short_back_um_s = value_of(c, PARAM_SHORT_BACK_UM_S);
    s->filter_alpha = R(1.0) - exponential(R(-2.0) * PI * value_of(c, PARAM_FILTER_HZ) * TICK_S);
    s->displacement_alpha = R(1.0) - exponential(-TICK_S / DISPLACEMENT_FILTER_S);
    s->hysteresis = value_of(c, PARAM_HYSTERESIS);
    s->kp_um_s = value_of(c, PARAM_KP_UM_S);
    s->ki_um_s2 = value_of(c, PARAM_KI_UM_S2);
    s->servo_ticks = at_least_one((int32_t)nearest((real)wire[PARAM_SERVO_PERIOD_US] / R(1000.0)));
    s->latency_decisions = wire[PARAM_SERVO_LATENCY];
    s->short_v = value_of(c, PARAM_SHORT_V);
    s->arc_v = value_of(c, PARAM_ARC_V);
    s->arc_delay_us = value_of(c, PARAM_ARC_DELAY_US);
    s->block_size = wire[PARAM_BLOCK_PULSES];
    s->short_ticks_max = ticks_of(c, PARAM_SHORT_STUCK_S);
    s->arc_run_max = wire[PARAM_ARC_RUN];
    s->open_lost_um = value_of(c, PARAM_OPEN_LOST_UM);
    s->open_ticks_max = ticks_of(c, PARAM_OPEN_LOST_S);
    s->watchdog_ticks = ticks_of(c, PARAM_WATCHDOG_S);
    s->dielectric_required = wire[PARAM_DIELECTRIC_REQUIRED] != 0;
    s->flow_min_lpm = value_of(c, PARAM_FLOW_MIN_LPM);
    s->temperature_max_c = value_of(c, PARAM_TEMPERATURE_MAX_C);
    s->monitor_min_v = value_of(c, PARAM_MONITOR_MIN_V);
    s->monitor_max_v = value_of(c, PARAM_MONITOR_MAX_V);
    s->track_v = value_of(c, PARAM_TRACK_ERROR) * FULL_SCALE_V;
    s->track_ticks_max = at_least_one(ticks_of(c, PARAM_TRACK_S));
    s->misreads_max = wire[PARAM_MISREAD_PULSES];
    s->over_current = value_of(c, PARAM_OVER_CURRENT);
    s->bad_frames = wire[PARAM_BAD_FRAMES];
    s->test_error = value_of(c, PARAM_TEST_ERROR);
}

/* Every parameter at its default, as after a reset. */
void parameters_reset(struct edm_controller *c) {
    struct edm_parameters *p = &c->parameters;
    for (int row = 0; row < PARAMS; row++) {
        p->current[row] = p->staged[row] = edm_params[row].default_wire;
    }
    p->crc = check_of(p->current);
    apply(c);
}

/* Stages a value; false for an unknown parameter, a value out of range, or a servo period off the tick. */
bool parameters_stage(struct edm_controller *c, uint16_t id, int32_t value) {
    int row = parameters_row(id);
    if (row < 0 || value < edm_params[row].least || value > edm_params[row].most) {
        return false;
    }
    if (row == PARAM_SERVO_PERIOD_US && value % TICK_US != 0) {
        return false;
    }
    c->parameters.staged[row] = value;
    return true;
}

/* Makes the staged values current if their check agrees; otherwise they are forgotten. */
bool parameters_commit(struct edm_controller *c, uint32_t crc) {
    struct edm_parameters *p = &c->parameters;
    if (check_of(p->staged) != crc) {
        memcpy(p->staged, p->current, sizeof p->staged);
        return false;
    }
    memcpy(p->current, p->staged, sizeof p->current);
    p->crc = crc;
    apply(c);
    return true;
}

/* Sets the generator, and what the judgement of its pulses goes by. */
void parameters_set_generator(struct edm_controller *c, const struct edm_generator *g, int32_t period_ns) {
    struct edm_settings *s = &c->settings;
    s->nominal_siemens = hal_set_generator(c->board, g);
    s->open_v = g->open_v;
    s->pulse_period_ns = period_ns; /* float would not know the nanoseconds of a long one */
    s->duty_v = g->open_v * g->on_time_us / (g->on_time_us + g->off_time_us);
    s->per_duty_v = R(1.0) / s->duty_v;
}
