/* Commands that move the tool or a stage, or let pulses flow; the ends of motions are events (docs/protocol.md, States).
 * Each has a function of its name, which returns the status of the reply; values are in the unit of their name. */
#include "core.h"

#define BLEND_TICKS 8 /* of a jump's ramp, at each end: jump.c */
#define MOST_BELOW_ZERO_UM R(5.0) /* SET_ZERO: a tool at rest reads no further from its home */
#define MOST_ABOVE_ZERO_UM R(25.0) /* more than creep leaves of a deep cut */

/* Volts that move the tool by a length, by the mean gain. */
static real volts(const struct edm_controller *c, real length_um) {
    return length_um * c->settings.v_per_um;
}

/* A duration in ticks, one at least. */
static int64_t ticks(real seconds) {
    int64_t n = nearest(seconds / TICK_S);
    return n > 1 ? n : 1;
}

/* Nothing moves, and the actuator is at 0 V. */
static bool armed_at_rest(const struct edm_controller *c) {
    return c->state == STATE_ARMED && c->motion.mode == HOLD && c->motion.command_v <= 0;
}

static uint8_t piezo_set(struct edm_controller *c, const struct edm_frame *frame) {
    struct piezo_set request;
    piezo_set_read(&request, frame->payload);
    if (c->state != STATE_ARMED) {
        return STATUS_BAD_STATE;
    }
    if (request.actuator_v > c->settings.piezo_max_v || request.slew_v_s <= 0) {
        return STATUS_OUT_OF_RANGE;
    }
    if (c->readings.contact && motion_feeds(c, request.actuator_v)) {
        states_raise(c, FAULT_COLLISION, 0);
        return STATUS_OK;
    }
    states_enter(c, STATE_MOVING);
    motion_ramp(c, request.actuator_v, request.slew_v_s);
    return STATUS_OK;
}

static uint8_t stage_move(struct edm_controller *c, const struct edm_frame *frame) {
    struct stage_move request;
    stage_move_read(&request, frame->payload);
    if (c->state != STATE_ARMED) {
        return STATUS_BAD_STATE;
    }
    if (request.axis > AXIS_THETA || request.speed == 0) {
        return STATUS_OUT_OF_RANGE;
    }
    real speed = (real)request.speed * R(1e-3);
    uint8_t status = stages_judge_speed(c, request.axis, speed);
    if (status != STATUS_OK) {
        return status;
    }
    if (c->gap.slow_displacement_um - c->zero_um > c->settings.safe_z_um) {
        return STATUS_INTERLOCK;
    }
    stages_start(c, request.axis, (real)request.target * R(1e-3), speed);
    states_enter(c, STATE_MOVING);
    return STATUS_OK;
}

static uint8_t stage_stop(struct edm_controller *c) {
    if (!c->stages.travels) {
        return STATUS_BAD_STATE;
    }
    stages_stop(c);
    states_stop_motion(c);
    return STATUS_OK;
}

static uint8_t set_zero(struct edm_controller *c, const struct edm_frame *frame) {
    struct set_zero request;
    set_zero_read(&request, frame->payload);
    if (!armed_at_rest(c)) {
        return STATUS_BAD_STATE;
    }
    real above_um = c->gap.slow_displacement_um - request.zero_um;
    if (!(above_um >= -MOST_BELOW_ZERO_UM && above_um <= MOST_ABOVE_ZERO_UM)) {
        return STATUS_OUT_OF_RANGE;
    }
    c->zero_um = request.zero_um;
    return STATUS_OK;
}

static uint8_t approach(struct edm_controller *c, const struct edm_frame *frame) {
    struct approach request;
    approach_read(&request, frame->payload);
    if (c->state != STATE_ARMED || !c->pulses_allowed) {
        return STATUS_BAD_STATE;
    }
    if (request.speed_um_s <= 0 || request.gap_ref_v <= 0) {
        return STATUS_OUT_OF_RANGE;
    }
    c->servo.gap_ref_v = request.gap_ref_v;
    c->motion.slow_v_s = volts(c, request.speed_um_s);
    c->motion.start_z_um = gap_place(c);
    c->motion.z_max_um = request.max_travel_um;
    c->gap.gap_v = c->settings.duty_v;
    motion_pulses_on(c);
    motion_enter(c, APPROACH);
    states_enter(c, STATE_APPROACH);
    return STATUS_OK;
}

static uint8_t servo_start(struct edm_controller *c, const struct edm_frame *frame) {
    struct servo_start request; /* SCAN_START is laid out alike */
    servo_start_read(&request, frame->payload);
    if (c->state != STATE_ARMED || !c->pulses_allowed) {
        return STATUS_BAD_STATE;
    }
    struct edm_servo *servo = &c->servo;
    servo->gap_ref_v = c->gap.gap_v = request.gap_ref_v;
    servo->z_limit_um = request.z_limit_um;
    servo->rate_v_s = servo->integral_um_s = 0;
    uint32_t time_ms = get_u32(frame->payload + SERVO_START_SIZE - sizeof(uint32_t)); /* counts: float has 24 bits */
    servo->time_ticks = time_ms > 1 ? time_ms : 1;
    servo->count = 0;
    servo->direction = 1;
    motion_pulses_on(c);
    motion_enter(c, SERVO);
    states_enter(c, STATE_MACHINING);
    return STATUS_OK;
}

_Static_assert(SCAN_START_SIZE == SERVO_START_SIZE, "SCAN_START is read as SERVO_START");

static uint8_t scan_start(struct edm_controller *c, const struct edm_frame *frame) {
    uint8_t status = servo_start(c, frame);
    if (status == STATUS_OK) {
        scan_begin(c);
    }
    return status;
}

static uint8_t path_move(struct edm_controller *c, const struct edm_frame *frame) {
    struct path_move request;
    path_move_read(&request, frame->payload);
    if (c->state != STATE_MACHINING || !c->scan.scanning || c->scan.path_ends) {
        return STATUS_BAD_STATE;
    }
    if (request.speed_um_s <= 0) {
        return STATUS_OUT_OF_RANGE;
    }
    for (uint8_t axis = AXIS_X; axis <= (uint8_t)AXIS_Y; axis++) {
        uint8_t status = stages_judge_speed(c, axis, request.speed_um_s);
        if (status != STATUS_OK) {
            return status;
        }
    }
    const struct edm_line line = {
        .x_um = request.x_um,
        .y_um = request.y_um,
        .speed_um_s = request.speed_um_s,
        .z_um = request.z_limit_um,
        .last = request.last != 0,
    };
    return scan_append(c, &line) ? STATUS_OK : STATUS_BUSY;
}

static uint8_t servo_stop(struct edm_controller *c) {
    if (!c->armed || c->stages.travels || c->disarming) {
        return STATUS_BAD_STATE;
    }
    states_stop_motion(c);
    return STATUS_OK;
}

static uint8_t jump(struct edm_controller *c, const struct edm_frame *frame) {
    struct jump request;
    jump_read(&request, frame->payload);
    bool resumes = c->state == STATE_MACHINING;
    if (!resumes && c->state != STATE_ARMED) {
        return STATUS_BAD_STATE;
    }
    if (request.speed_um_s <= 0) {
        return STATUS_OUT_OF_RANGE;
    }
    struct edm_motion *motion = &c->motion;
    struct edm_jump *jump = &c->jump;
    real slew = least(volts(c, request.speed_um_s), c->settings.slew_limit_v_s);
    jump->start_v = motion->command_v;
    jump->jump_v = least(volts(c, request.height_um), motion->command_v);
    jump->clearance_v = least(volts(c, request.clearance_um), jump->jump_v);
    jump->resumes = resumes;
    motion->fast_v_s = volts(c, c->settings.short_back_um_s);
    motion->phase_ticks = ceiling_of(jump->jump_v / slew / TICK_S) + BLEND_TICKS;
    motion->dwell_ticks = ticks(request.dwell_s);
    motion_gate(c, false);
    telemetry_flush(c);
    motion_enter(c, JUMP_UP);
    states_enter(c, STATE_JUMP);
    return STATUS_OK;
}

static uint8_t touch_off(struct edm_controller *c, const struct edm_frame *frame) {
    struct touch_off request;
    touch_off_read(&request, frame->payload);
    if (c->state != STATE_ARMED) {
        return STATUS_BAD_STATE;
    }
    if (request.touches == 0 || request.speed_um_s <= 0 || request.fast_um_s <= 0) {
        return STATUS_OUT_OF_RANGE;
    }
    if (c->readings.contact) {
        states_raise(c, FAULT_STUCK_CONTACT, 0);
        return STATUS_OK;
    }
    struct edm_motion *motion = &c->motion;
    motion->fast_v_s = volts(c, request.fast_um_s);
    motion->slow_v_s = volts(c, request.speed_um_s);
    motion->z_max_um = request.z_max_um;
    motion->dwell_ticks = ticks(request.dwell_s);
    c->touch.fast_to_um = request.fast_to_um;
    c->touch.back_v = volts(c, request.back_off_um);
    c->touch.left = request.touches;
    c->touch.number = 0;
    motion_enter(c, TOUCH_FAST);
    states_enter(c, STATE_TOUCH);
    c->touch_offs++;
    return STATUS_OK;
}

static uint8_t self_test(struct edm_controller *c) {
    if (!armed_at_rest(c) || !c->pulses_allowed) {
        return STATUS_BAD_STATE;
    }
    self_test_begin(c);
    states_enter(c, STATE_APPROACH);
    return STATUS_OK;
}

static uint8_t pulse_config(struct edm_controller *c, const struct edm_frame *frame) {
    struct pulse_config request;
    pulse_config_read(&request, frame->payload);
    if (c->state != STATE_IDLE && c->state != STATE_ARMED) {
        return STATUS_BAD_STATE;
    }
    uint64_t on_ns = get_u32(frame->payload), period_ns = on_ns + get_u32(frame->payload + 4); /* counts of the wire */
    bool times_fit = on_ns > 0 && period_ns >= on_ns + EDM_OFF_NS_MIN && period_ns >= EDM_PERIOD_NS_MIN &&
                     period_ns <= EDM_PERIOD_NS_MAX;
    bool isopulse = request.mode == PULSE_MODE_ISOPULSE;
    bool mode_fits = request.mode <= PULSE_MODE_ISOPULSE && (request.discharge_us > 0 || !isopulse);
    bool supply_fits = request.open_voltage_v > 0 && request.open_voltage_v <= EDM_OPEN_V_MAX &&
                       request.peak_current_a > 0 && request.peak_current_a <= EDM_CURRENT_A_MAX;
    if (!times_fit || !mode_fits || !supply_fits) {
        return STATUS_OUT_OF_RANGE;
    }
    const struct edm_generator setting = {
        .on_time_us = request.on_time_us,
        .off_time_us = request.off_time_us,
        .open_v = request.open_voltage_v,
        .peak_a = request.peak_current_a,
        .discharge_us = isopulse ? request.discharge_us : 0,
    };
    waveforms_forget(c);
    parameters_set_generator(c, &setting, (int32_t)period_ns);
    return STATUS_OK;
}

static uint8_t pulse_enable(struct edm_controller *c, const struct edm_frame *frame) {
    struct pulse_enable request;
    pulse_enable_read(&request, frame->payload);
    if (request.on != 0 && c->state != STATE_ARMED) {
        return STATUS_BAD_STATE;
    }
    c->pulses_allowed = request.on != 0;
    bool sparks = c->state == STATE_APPROACH || c->state == STATE_MACHINING || c->state == STATE_JUMP;
    if (request.on == 0 && sparks) {
        states_stop_motion(c);
    }
    return STATUS_OK;
}

/* As commands_execute, for what moves. */
uint8_t motion_commands_execute(struct edm_controller *c, const struct edm_frame *frame) {
    switch (frame->type) {
    case MSG_PIEZO_SET:
        return piezo_set(c, frame);
    case MSG_STAGE_MOVE:
        return stage_move(c, frame);
    case MSG_STAGE_STOP:
        return stage_stop(c);
    case MSG_SET_ZERO:
        return set_zero(c, frame);
    case MSG_APPROACH:
        return approach(c, frame);
    case MSG_SERVO_START:
        return servo_start(c, frame);
    case MSG_SCAN_START:
        return scan_start(c, frame);
    case MSG_PATH_MOVE:
        return path_move(c, frame);
    case MSG_SERVO_STOP:
        return servo_stop(c);
    case MSG_JUMP:
        return jump(c, frame);
    case MSG_TOUCH_OFF:
        return touch_off(c, frame);
    case MSG_SELF_TEST:
        return self_test(c);
    case MSG_PULSE_CONFIG:
        return pulse_config(c, frame);
    case MSG_PULSE_ENABLE:
        return pulse_enable(c, frame);
    default:
        return STATUS_UNKNOWN_TYPE;
    }
}
