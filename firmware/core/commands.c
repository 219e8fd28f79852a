/* Commands but for motions: session, arming, faults, parameters, status, telemetry (docs/protocol.md, Messages). Each has
 * a function, which returns the status of the reply and leaves its payload in c->link. */
#include "core.h"
#include "version.h"

#define TLM_MAX_HZ 1000
#define REBOOT_MAGIC 0x0B007EDBu

static uint8_t greet(struct edm_controller *c, const struct edm_frame *frame) {
    struct hello request;
    hello_read(&request, frame->payload);
    struct hello_reply reply = {
        .proto_major = PROTO_MAJOR,
        .proto_minor = PROTO_MINOR,
        .host_nonce = request.host_nonce,
        .schema_hash = SCHEMA_HASH,
        .fw_major = FW_MAJOR,
        .fw_minor = FW_MINOR,
        .fw_patch = FW_PATCH,
        .board = c->identity.board,
        .servo_hz = EDM_SERVO_HZ,
        .tlm_max_hz = TLM_MAX_HZ,
        .rx_window = 1,
        .boot_count = c->keeps.boot_count,
        .reset_cause = c->reset_cause,
        .fault = c->keeps.fault,
        .state = c->state,
        .clock = c->identity.driven ? CLOCK_DRIVEN : CLOCK_RUNNING,
        .baud = c->identity.baud,
    };
    memcpy(reply.serial, c->identity.serial, sizeof reply.serial);
    hello_reply_write(c->link.reply.payload, &reply);
    c->link.reply.size = HELLO_REPLY_SIZE;
    bool served = request.proto_major == PROTO_MAJOR && request.schema_hash == SCHEMA_HASH;
    return served ? STATUS_OK : STATUS_VERSION;
}

static uint8_t answer_beat(struct edm_controller *c, const struct edm_frame *frame) {
    struct heartbeat request;
    heartbeat_read(&request, frame->payload);
    events_acknowledge(c, request.last_event);
    const struct heartbeat_reply reply = {
        .t_host_us = request.t_host_us,
        .t_dev_us = time_us(c),
        .state = c->state,
        .fault = c->keeps.fault,
        .rx_bad = (uint16_t)c->receiver.bad,
        .rx_drop = (uint16_t)c->link.drop,
    };
    heartbeat_reply_write(c->link.reply.payload, &reply);
    c->link.reply.size = HEARTBEAT_REPLY_SIZE;
    return STATUS_OK;
}

static uint8_t read_schema(struct edm_controller *c, const struct edm_frame *frame) {
    struct get_schema request;
    get_schema_read(&request, frame->payload);
    uint32_t rest = request.offset < SCHEMA_BYTES ? (uint32_t)SCHEMA_BYTES - request.offset : 0u;
    uint8_t n = (uint8_t)(rest < GET_SCHEMA_REPLY_MOST ? rest : GET_SCHEMA_REPLY_MOST);
    const struct get_schema_reply reply = {.total = SCHEMA_BYTES, .n = n};
    get_schema_reply_write(c->link.reply.payload, &reply);
    if (n > 0) {
        memcpy(c->link.reply.payload + GET_SCHEMA_REPLY_SIZE, edm_schema + request.offset, n);
    }
    c->link.reply.size = (uint8_t)(GET_SCHEMA_REPLY_SIZE + n);
    return STATUS_OK;
}

static uint8_t tell_status(struct edm_controller *c) {
    struct edm_inputs inputs;
    uint16_t interlocks = guards_interlocks(c, &inputs);
    const struct get_status_reply reply = {
        .state = c->state,
        .fault = c->keeps.fault,
        .interlocks = interlocks,
        .displacement_um = c->gap.displacement_um,
        .x_um = c->stages.at[AXIS_X],
        .y_um = c->stages.at[AXIS_Y],
        .theta_deg = c->stages.at[AXIS_THETA],
        .actuator_v = c->drive.actuator_v,
        .gap_v = c->gap.gap_v,
        .temperature_c = inputs.temperature_c,
        .flow_lpm = inputs.flow_lpm,
        .monitor_v = inputs.monitor_v,
        .flags = c->box.newest_flags,
    };
    get_status_reply_write(c->link.reply.payload, &reply);
    c->link.reply.size = GET_STATUS_REPLY_SIZE;
    return STATUS_OK;
}

/* Refuses with the interlocks that are open; STATUS_OK where none is. */
static uint8_t look_at_interlocks(struct edm_controller *c) {
    struct edm_inputs inputs;
    uint16_t open = guards_interlocks(c, &inputs);
    if (open == 0) {
        return STATUS_OK;
    }
    put_u16(c->link.reply.payload, open);
    c->link.reply.size = 2;
    return STATUS_INTERLOCK;
}

static uint8_t arm(struct edm_controller *c, const struct edm_frame *frame) {
    struct arm request;
    arm_read(&request, frame->payload);
    if (c->state != STATE_IDLE) {
        return STATUS_BAD_STATE;
    }
    if (request.param_crc != c->parameters.crc) {
        return STATUS_PROFILE_MISMATCH;
    }
    struct edm_inputs inputs;
    hal_inputs(c->board, &inputs);
    if (inputs.stage_moves) {
        return STATUS_BUSY;
    }
    uint8_t interlocks = look_at_interlocks(c);
    if (interlocks != STATUS_OK) {
        return interlocks;
    }
    watchdog_feed(c);
    c->zero_um = 0;
    states_enter(c, STATE_ARMED);
    c->arms++;
    return STATUS_OK;
}

static uint8_t disarm(struct edm_controller *c) {
    if (!c->armed) {
        return STATUS_BAD_STATE;
    }
    stages_stop(c);
    c->pulses_allowed = false;
    c->disarming = true;
    states_enter(c, STATE_MOVING);
    motion_ramp(c, 0, c->settings.retract_v_s);
    return STATUS_OK;
}

static uint8_t clear_fault(struct edm_controller *c, const struct edm_frame *frame) {
    struct clear_fault request;
    clear_fault_read(&request, frame->payload);
    if (c->state != STATE_FAULT && c->state != STATE_ESTOP) {
        return STATUS_BAD_STATE;
    }
    if (request.fault != c->keeps.fault) {
        return STATUS_OUT_OF_RANGE;
    }
    if (c->motion.mode != HOLD || !events_take_faults(c)) {
        return STATUS_BUSY;
    }
    uint8_t interlocks = look_at_interlocks(c);
    if (interlocks == STATUS_OK) {
        states_clear_fault(c);
    }
    return interlocks;
}

static uint8_t set_param(struct edm_controller *c, const struct edm_frame *frame) {
    struct set_param request;
    set_param_read(&request, frame->payload);
    if (c->state != STATE_IDLE) {
        return STATUS_BAD_STATE;
    }
    return parameters_stage(c, request.param, request.value) ? STATUS_OK : STATUS_OUT_OF_RANGE;
}

static uint8_t get_param(struct edm_controller *c, const struct edm_frame *frame) {
    struct get_param request;
    get_param_read(&request, frame->payload);
    int row = parameters_row(request.param);
    if (row < 0) {
        return STATUS_OUT_OF_RANGE;
    }
    const struct get_param_reply reply = {.value = c->parameters.current[row]};
    get_param_reply_write(c->link.reply.payload, &reply);
    c->link.reply.size = GET_PARAM_REPLY_SIZE;
    return STATUS_OK;
}

static uint8_t commit_profile(struct edm_controller *c, const struct edm_frame *frame) {
    struct commit_profile request;
    commit_profile_read(&request, frame->payload);
    if (c->state != STATE_IDLE) {
        return STATUS_BAD_STATE;
    }
    return parameters_commit(c, request.crc) ? STATUS_OK : STATUS_PROFILE_MISMATCH;
}

static uint8_t start_telemetry(struct edm_controller *c, const struct edm_frame *frame) {
    struct tlm_start request;
    tlm_start_read(&request, frame->payload);
    if ((uint32_t)request.period_us * TLM_MAX_HZ < 1000000u) {
        return STATUS_RATE_TOO_HIGH;
    }
    return telemetry_start(c, &request);
}

/* REBOOT is answered, then the board carries it out: it looks at link.reboot_asked. */
static uint8_t reboot(struct edm_controller *c, const struct edm_frame *frame) {
    struct reboot request;
    reboot_read(&request, frame->payload);
    if (c->armed) {
        return STATUS_BAD_STATE;
    }
    if (request.magic != REBOOT_MAGIC) {
        return STATUS_OUT_OF_RANGE;
    }
    c->link.reboot_asked = true;
    telemetry_forget(c); /* or the reply of a board would never be the last thing on the line */
    return STATUS_OK;
}

/* Carries out a command whose payload has its length; returns the status of the reply, whose payload is in c->link. */
uint8_t commands_execute(struct edm_controller *c, const struct edm_frame *frame) {
    switch (frame->type) {
    case MSG_HELLO:
        return greet(c, frame);
    case MSG_HEARTBEAT:
        return answer_beat(c, frame);
    case MSG_GET_SCHEMA:
        return read_schema(c, frame);
    case MSG_ADVANCE: /* of a clock that runs */
        return STATUS_UNKNOWN_TYPE;
    case MSG_GET_STATUS:
        return tell_status(c);
    case MSG_ARM:
        return arm(c, frame);
    case MSG_DISARM:
        return disarm(c);
    case MSG_CLEAR_FAULT:
        return clear_fault(c, frame);
    case MSG_SET_PARAM:
        return set_param(c, frame);
    case MSG_GET_PARAM:
        return get_param(c, frame);
    case MSG_COMMIT_PROFILE:
        return commit_profile(c, frame);
    case MSG_TLM_START:
        return start_telemetry(c, frame);
    case MSG_TLM_STOP:
        telemetry_stop(c);
        return STATUS_OK;
    case MSG_BLACKBOX_READ:
        blackbox_read(c, get_u16(frame->payload), &c->link.reply);
        return STATUS_OK;
    case MSG_WAVEFORM_READ:
        return waveforms_read(c, get_u32(frame->payload), &c->link.reply);
    case MSG_REBOOT:
        return reboot(c, frame);
    default:
        return motion_commands_execute(c, frame);
    }
}
