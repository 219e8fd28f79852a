/* Events until they are acknowledged (docs/protocol.md, Events). */
#include "core.h"

#define REPEAT_TICKS 100
#define FOR_FAULTS 2 /* places that only a FAULT takes */

/* Number of the next event; 0 means none. */
static uint16_t next_number(struct edm_controller *c) {
    c->keeps.event_no = (uint16_t)(c->keeps.event_no % UINT16_MAX + 1);
    hal_persist(c->board, &c->keeps);
    return c->keeps.event_no;
}

/* All that are kept are due again 100 ms of the host after the last one that was sent. */
static void repeat_later(struct edm_controller *c) {
    c->events.repeat_tick = c->tick + host_ticks(c, REPEAT_TICKS);
}

/* Sends an event or fault and keeps it: there is a place, for EVENTs leave two to FAULTs, and CLEAR_FAULT waits for them. */
static void send_and_keep(struct edm_controller *c, uint8_t type, uint16_t number, const uint8_t *payload) {
    struct edm_events *events = &c->events;
    uint8_t frame[FRAME_MOST];
    size_t size = frame_encode(frame, type, 0, c->link.session, 0, payload, EVENT_SIZE);
    if (events->count < EDM_EVENTS) {
        struct edm_kept_event *kept = &events->kept[events->count++];
        kept->number = number;
        memcpy(kept->frame, frame, EVENT_FRAME);
    }
    hal_send(c->board, frame, size);
    repeat_later(c);
}

_Static_assert(EVENT_SIZE == FAULT_SIZE && EVENT_FRAME == EVENT_SIZE + 11, "events and faults are of one size");

/* Whether two more FAULTs may wait: the one that latches, and an emergency stop over it. */
bool events_take_faults(const struct edm_controller *c) {
    return c->events.count <= EDM_EVENTS - FOR_FAULTS;
}

/* Sends EVENT, after the telemetry up to it. A host that leaves no place for it is one that does not listen. */
static void emit(struct edm_controller *c, struct event *event) {
    uint8_t payload[EVENT_SIZE];
    if (c->events.count >= EDM_EVENTS - FOR_FAULTS) {
        states_raise(c, FAULT_HOST_SILENT, event->code);
        return;
    }
    telemetry_flush(c);
    event->event_no = next_number(c);
    event_write(payload, event);
    send_and_keep(c, MSG_EVENT, event->event_no, payload);
}

void events_emit_arg(struct edm_controller *c, uint16_t code, int32_t arg) {
    struct event event = {
        .t_us = (uint32_t)time_us(c),
        .code = code,
        .arg = arg,
        .displacement_um = c->gap.displacement_um,
        .actuator_v = c->drive.actuator_v,
    };
    emit(c, &event);
}

void events_emit(struct edm_controller *c, uint16_t code) {
    events_emit_arg(c, code, 0);
}

/* TOUCH: when contact was made, the mean of the sensor while hunting, the command at first contact. */
void events_emit_touch(struct edm_controller *c) {
    const struct edm_touch *touch = &c->touch;
    struct event event = {
        .t_us = (uint32_t)(time_us(c) - (uint64_t)c->motion.dwell_ticks * TICK_US),
        .code = EVENT_CODE_TOUCH,
        .arg = touch->number,
        .displacement_um = touch->sum / (real)(touch->count > 1 ? touch->count : 1),
        .actuator_v = touch->peak_v,
    };
    emit(c, &event);
}

/* Sends FAULT; the caller has flushed telemetry. */
void events_emit_fault(struct edm_controller *c, uint16_t code, int32_t detail) {
    uint8_t payload[FAULT_SIZE];
    const struct fault fault = {
        .event_no = next_number(c),
        .t_us = (uint32_t)time_us(c),
        .code = code,
        .detail = detail,
        .displacement_um = c->gap.displacement_um,
        .gap_v = c->gap.gap_v,
    };
    fault_write(payload, &fault);
    send_and_keep(c, MSG_FAULT, fault.event_no, payload);
}

/* Forgets every event up to and with `last`; a number that is not kept covers nothing. */
void events_acknowledge(struct edm_controller *c, uint16_t last) {
    struct edm_events *events = &c->events;
    for (uint8_t i = 0; i < events->count; i++) {
        if (events->kept[i].number == last) {
            uint8_t rest = (uint8_t)(events->count - i - 1);
            memmove(events->kept, events->kept + i + 1, rest * sizeof events->kept[0]);
            events->count = rest;
            return;
        }
    }
}

/* Sends again, every 100 ms, what is not acknowledged. */
void events_repeat(struct edm_controller *c) {
    struct edm_events *events = &c->events;
    if (c->tick < events->repeat_tick) {
        return;
    }
    for (uint8_t i = 0; i < events->count; i++) {
        hal_send(c->board, events->kept[i].frame, EVENT_FRAME);
    }
    if (events->count > 0) {
        repeat_later(c);
    } else {
        events->repeat_tick = NEVER;
    }
}
