/* States, the safe state, and what ends a motion (docs/protocol.md, States, Safe state and watchdog). */
#include "core.h"

#define USUAL_PERIOD_NS 434783 /* of the generator at the start */
#define RANGE_V R(150.0) /* of the actuator; what its monitor reads above it is the monitor's error */
#define FAULT_LEAST 1000 /* what happened is a fault from here on */

static bool is_armed_state(uint8_t state) {
    return state >= STATE_ARMED && state <= STATE_MOVING;
}

/* In APPROACH both halves of SELF_TEST: with the gate off the generator is to give nothing. */
bool edm_generator_at_gap(const struct edm_controller *c) {
    return c->drive.pulses_on || c->state == STATE_APPROACH || c->state == STATE_MACHINING || c->state == STATE_JUMP;
}

/* Enters a state. The watchdog runs, inputs and monitors count while it is an armed one. */
void states_enter(struct edm_controller *c, uint8_t state) {
    c->state = state;
    c->armed = is_armed_state(state);
}

static void latch(struct edm_controller *c, uint16_t code) {
    c->keeps.fault = code;
    hal_persist(c->board, &c->keeps);
}

/* Keeps what is known of the time before a fault. */
static void freeze(struct edm_controller *c) {
    blackbox_freeze(c);
    waveforms_freeze(c);
}

/* Pulses off, retract, latch, report. The first fault stays the latched one, but for an emergency stop. */
void states_raise(struct edm_controller *c, uint16_t code, int32_t detail) {
    uint16_t latched = c->keeps.fault;
    motion_ramp(c, 0, c->settings.retract_v_s);
    if (latched != 0 && (code != FAULT_ESTOP || latched == FAULT_ESTOP)) {
        return;
    }
    latch(c, code); /* before anything that takes time: the supply may go with the fault */
    telemetry_flush(c);
    freeze(c);
    stages_stop(c);
    c->disarming = c->pulses_allowed = false;
    states_enter(c, code == FAULT_ESTOP ? STATE_ESTOP : STATE_FAULT);
    events_emit_fault(c, code, detail);
}

void edm_fault(struct edm_controller *c, uint16_t code, int32_t detail) {
    states_raise(c, code, detail);
}

void edm_pulses_broken(struct edm_controller *c) {
    if (c->keeps.fault != 0) {
        return;
    }
    waveforms_freeze(c); /* they are shorter than the fault may take to come */
    if (edm_generator_at_gap(c)) { /* a jump without pulses, too */
        motion_gate(c, false);
        motion_enter(c, HOLD);
    }
}

/* Leaves FAULT or ESTOP for IDLE. */
void states_clear_fault(struct edm_controller *c) {
    latch(c, 0);
    blackbox_thaw(c);
    waveforms_thaw(c);
    states_enter(c, STATE_IDLE);
}

/* Pulses off, holds the tool where it is. */
void states_stop_motion(struct edm_controller *c) {
    motion_hold(c);
    states_enter(c, STATE_ARMED);
    events_emit(c, EVENT_CODE_STOPPED);
}

/* The end of a ramp is an event, but for that of BOOT or of a fault. */
static void end_ramp(struct edm_controller *c) {
    if (c->state == STATE_BOOT) {
        states_enter(c, STATE_IDLE);
    } else if (c->keeps.fault == 0) {
        states_enter(c, c->disarming ? STATE_IDLE : STATE_ARMED);
        c->disarming = false;
        events_emit(c, EVENT_CODE_MOVE_DONE);
    }
}

static void end_motion(struct edm_controller *c, uint8_t state, uint16_t event) {
    states_enter(c, state);
    events_emit(c, event);
}

void edm_conclude(struct edm_controller *c, int happened) {
    if (happened >= FAULT_LEAST) {
        motion_gate(c, false); /* before the samples go out */
    }
    telemetry_send_full(c);
    scan_release(c);
    switch (happened) {
    case NOTHING:
    case JUMP_RESUMED:
        break;
    case RAMP_DONE:
        end_ramp(c);
        break;
    case SPARK_FOUND:
        end_motion(c, STATE_ARMED, EVENT_CODE_APPROACH_DONE);
        break;
    case CUT_DONE:
        end_motion(c, STATE_ARMED, EVENT_CODE_CUT_DONE);
        break;
    case TIME_UP:
        end_motion(c, STATE_ARMED, EVENT_CODE_TIME_UP);
        break;
    case PATH_IS_DONE:
        end_motion(c, STATE_ARMED, EVENT_CODE_PATH_DONE);
        break;
    case JUMP_IS_DONE:
        end_motion(c, c->jump.resumes ? STATE_MACHINING : STATE_ARMED, EVENT_CODE_JUMP_DONE);
        break;
    case TOUCHED:
        events_emit_touch(c);
        break;
    case TOUCHES_DONE:
        end_motion(c, STATE_ARMED, EVENT_CODE_TOUCH_DONE);
        break;
    case TESTED:
        self_test_judge(c);
        break;
    default:
        states_raise(c, (uint16_t)happened, 0);
        break;
    }
}

void edm_send_full_frames(struct edm_controller *c) {
    telemetry_send_full(c);
}

/* Where a reset has left the actuator, by its monitor. A monitor that cannot be right says nothing: to drive the tool where
 * it says, so as to come back from there, might drive it into the work. */
static real command_left(const struct edm_controller *c, real monitor_v) {
    if (!(monitor_v <= c->settings.monitor_max_v)) {
        return 0;
    }
    return most(0, least(monitor_v, RANGE_V));
}

static void create(struct edm_controller *c, void *board, const struct edm_identity *identity,
                   const struct edm_persistent *keeps) {
    /* The setting of the start (Session); without a discharge time: isofrequency. */
    static const struct edm_generator usual = {.on_time_us = R(130.435), .off_time_us = R(304.348), .open_v = 40,
                                               .peak_a = R(0.12)};
    struct edm_inputs inputs;
    c->board = board;
    c->identity = *identity;
    if (keeps != NULL) {
        c->keeps = *keeps;
    }
    if (c->keeps.nonce_count > EDM_NONCES) { /* words that did not last */
        c->keeps.nonce_count = 0;
    }
    c->events.repeat_tick = NEVER;
    c->telemetry.next = -1;
    motion_gate(c, false);
    parameters_reset(c);
    waveforms_forget(c);
    parameters_set_generator(c, &usual, USUAL_PERIOD_NS);
    hal_inputs(board, &inputs);
    c->motion.command_v = command_left(c, inputs.monitor_v);
    c->drive.actuator_v = on_grid(c->motion.command_v);
    states_enter(c, STATE_IDLE);
}

void edm_create(struct edm_controller *c, void *board, const struct edm_identity *identity,
                const struct edm_persistent *keeps) {
    memset(c, 0, sizeof *c);
    create(c, board, identity, keeps);
}

void edm_create_again(struct edm_controller *c, void *board, const struct edm_identity *identity,
                      const struct edm_persistent *keeps, bool waveforms) {
    const int64_t tick = c->tick, boot_tick = c->boot_tick;
    memset(c, 0, offsetof(struct edm_controller, box));
    c->tick = tick;
    c->boot_tick = boot_tick;
    c->keeps.fault = keeps != NULL ? keeps->fault : 0;
    if (!blackbox_recover(c)) {
        c->tick = c->boot_tick = 0;
        memset(&c->box, 0, sizeof c->box);
    }
    if (waveforms && c->box.frozen && c->waveforms.frozen) {
        int64_t end_tick = (c->waveforms.end_ns + TICK_NS - 1) / TICK_NS;
        c->tick = end_tick > c->tick ? end_tick : c->tick;
    } else {
        memset(&c->waveforms, 0, sizeof c->waveforms);
        hal_wave_forget(board, true);
    }
    create(c, board, identity, keeps);
}

void edm_stands_at(struct edm_controller *c, real actuator_v) {
    c->motion.command_v = most(0, least(actuator_v, RANGE_V));
    c->drive.actuator_v = on_grid(c->motion.command_v);
}

_Static_assert(offsetof(struct edm_controller, waveforms) > offsetof(struct edm_controller, box),
               "what outlasts a reset stands at the end");

void edm_start(struct edm_controller *c, uint8_t cause) {
    struct edm_persistent *keeps = &c->keeps;
    motion_gate(c, false);
    telemetry_forget(c);
    c->telemetry.counter = c->telemetry.pulse_counter = 0;
    memset(&c->receiver, 0, sizeof c->receiver);
    c->guards.bad_seen = c->guards.bad_count = 0;
    c->link.drop = 0;
    session_begin(c, 0);
    parameters_reset(c);
    if (cause == RESET_CAUSE_POWER_ON) { /* the converter stands at 0 V, whatever the monitor reads */
        c->motion.command_v = c->drive.actuator_v = 0;
    }
    motion_ramp(c, 0, c->settings.retract_v_s);
    stages_stop(c);
    c->link.reboot_asked = c->disarming = c->pulses_allowed = false;
    if (keeps->fault == 0 && (cause == RESET_CAUSE_WATCHDOG || cause == RESET_CAUSE_BROWN_OUT)) {
        freeze(c);
        keeps->fault = FAULT_RESET;
    }
    waveforms_forget(c);
    keeps->boot_count++;
    hal_persist(c->board, keeps);
    c->boot_tick = c->tick;
    if (keeps->fault != 0 && !c->box.frozen) { /* the samples of the fault did not last, and none that come are its */
        blackbox_thaw(c);
        blackbox_freeze(c);
    }
    c->reset_cause = cause;
    c->events.repeat_tick = NEVER;
    bool at_rest = c->motion.command_v <= 0;
    if (keeps->fault != 0) {
        states_enter(c, keeps->fault == FAULT_ESTOP ? STATE_ESTOP : STATE_FAULT);
    } else {
        states_enter(c, at_rest ? STATE_IDLE : STATE_BOOT);
    }
    if (at_rest) {
        motion_hold(c);
    }
    uint8_t payload[BOOT_SIZE];
    const struct boot boot = {.reset_cause = cause, .boot_count = keeps->boot_count};
    boot_write(payload, &boot);
    delivery_send(c, MSG_BOOT, payload, BOOT_SIZE);
}
