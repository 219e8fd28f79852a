/* Which command is carried out, and how it is answered (docs/protocol.md, Delivery). */
#include "core.h"

#define HALF 128 /* commands may run so far ahead of the newest one */

/* Sends a message unasked. */
void delivery_send(struct edm_controller *c, uint8_t type, const uint8_t *payload, size_t size) {
    uint8_t frame[FRAME_MOST];
    size_t encoded = frame_encode(frame, type, 0, c->link.session, 0, payload, size);
    hal_send(c->board, frame, encoded);
}

/* Sends the reply that was made to a command. */
void delivery_answer(struct edm_controller *c, uint8_t type, uint8_t seq, uint8_t session) {
    const struct edm_reply *reply = &c->link.reply;
    uint8_t frame[FRAME_MOST];
    size_t size = frame_encode(frame, type | REPLY_BIT, seq, session, reply->status, reply->payload, reply->size);
    hal_send(c->board, frame, size);
}

/* Sends a reply that no ADVANCE of a session is waited for with. */
void delivery_answer_now(struct edm_controller *c, const struct edm_frame *frame) {
    delivery_answer(c, frame->type, frame->seq, frame->session);
    c->link.urgent = c->link.due = true;
}

/* Carries a command out and makes its reply. */
void delivery_execute(struct edm_controller *c, const struct edm_frame *frame) {
    struct edm_reply *reply = &c->link.reply;
    int size = edm_request_size(frame->type);
    reply->size = 0;
    if (size < 0) {
        reply->status = STATUS_UNKNOWN_TYPE;
    } else if (size != frame->size) {
        reply->status = STATUS_BAD_LENGTH;
    } else {
        reply->status = commands_execute(c, frame);
    }
}

static const struct edm_kept_reply *kept_reply(const struct edm_link *link, uint8_t type, uint8_t seq) {
    for (int i = 0; i < link->reply_count; i++) {
        if (link->replies[i].type == type && link->replies[i].seq == seq) {
            return &link->replies[i];
        }
    }
    return NULL;
}

/* A command of the session, by the rules 2 to 4; whether it was answered. */
static bool answer_command(struct edm_controller *c, const struct edm_frame *frame) {
    struct edm_link *link = &c->link;
    const struct edm_kept_reply *before = kept_reply(link, frame->type, frame->seq);
    if (before != NULL) {
        hal_send(c->board, before->frame, before->size);
        return true;
    }
    uint8_t ahead = (uint8_t)(frame->seq - link->newest);
    if (link->has_newest && !(ahead > 0 && ahead < HALF)) {
        link->drop++;
        return false;
    }
    watchdog_feed(c);
    delivery_execute(c, frame);
    link->newest = frame->seq;
    link->has_newest = true;
    struct edm_kept_reply *kept = &link->replies[link->reply_at];
    link->reply_at = (uint8_t)((link->reply_at + 1) % EDM_REPLIES);
    if (link->reply_count < EDM_REPLIES) {
        link->reply_count++;
    }
    kept->type = frame->type;
    kept->seq = frame->seq;
    kept->size = (uint16_t)frame_encode(kept->frame, frame->type | REPLY_BIT, frame->seq, frame->session,
                                        link->reply.status, link->reply.payload, link->reply.size);
    hal_send(c->board, kept->frame, kept->size);
    return true;
}

/* Rule 1: a heartbeat feeds the watchdog if it is later than all before; a line that repeats one is no host. */
static void answer_heartbeat(struct edm_controller *c, const struct edm_frame *frame) {
    struct edm_link *link = &c->link;
    if (frame->size == HEARTBEAT_SIZE) {
        uint64_t beat_us = get_u64(frame->payload);
        if (!link->has_beat || beat_us > link->newest_beat_us) {
            link->has_beat = true;
            link->newest_beat_us = beat_us;
            watchdog_feed(c);
        }
    }
    delivery_execute(c, frame);
    delivery_answer(c, frame->type, frame->seq, frame->session);
}

/* ADVANCE on a driven clock needs no session. The caller lets time pass, then calls edm_advanced. */
static void take_advance(struct edm_controller *c, const struct edm_frame *frame) {
    struct edm_link *link = &c->link;
    link->advanced = true;
    link->advancing = link->advance_came = true;
    link->advance_seq = frame->seq;
    link->advance_session = frame->session;
    link->advance_status = frame->size == ADVANCE_SIZE ? STATUS_OK : STATUS_BAD_LENGTH;
    link->advance_us = frame->size == ADVANCE_SIZE ? get_u32(frame->payload) : 0;
}

void edm_advanced(struct edm_controller *c) {
    struct edm_link *link = &c->link;
    if (!link->advancing) {
        return;
    }
    link->advancing = false;
    struct edm_reply *reply = &link->reply;
    reply->status = link->advance_status;
    reply->size = 0;
    if (reply->status == STATUS_OK) {
        const struct advance_reply now = {.t_dev_us = time_us(c)};
        advance_reply_write(reply->payload, &now);
        reply->size = ADVANCE_REPLY_SIZE;
    }
    delivery_answer(c, MSG_ADVANCE, link->advance_seq, link->advance_session);
    link->due = true;
}

/* A whole frame that came. */
void delivery_handle(struct edm_controller *c, const struct edm_frame *frame) {
    struct edm_link *link = &c->link;
    if (frame->type == 0 || frame->type >= REPLY_BIT) {
        link->drop++; /* an echo of what the controller sent must not feed its watchdog */
        return;
    }
    link->frames++;
    if (c->identity.driven && frame->type == MSG_ADVANCE) {
        take_advance(c, frame);
    } else if (frame->session == 0 || link->reboot_asked) { /* the session ends with REBOOT */
        link->drop++;
    } else if (frame->type == MSG_HELLO) {
        session_greet(c, frame);
    } else if (frame->session != link->session) {
        if (frame->type == MSG_GET_SCHEMA) {
            delivery_execute(c, frame);
            delivery_answer_now(c, frame);
        } else {
            link->drop++;
        }
    } else if (frame->type == MSG_HEARTBEAT) {
        answer_heartbeat(c, frame);
        link->due = link->due || (c->identity.driven && link->urgent && !link->advanced);
    } else if (answer_command(c, frame)) {
        link->urgent = true;
        link->due = link->due || (c->identity.driven && !link->advanced);
    }
}

size_t edm_receive(struct edm_controller *c, const uint8_t *bytes, size_t size) {
    size_t taken = 0;
    c->link.advance_came = false;
    while (taken < size && !c->link.advance_came) {
        struct edm_frame frame;
        taken += frame_fill(&c->receiver, bytes + taken, size - taken);
        if (taken == size) {
            break;
        }
        taken++; /* a zero */
        bool aborts = frame_aborts(&c->receiver);
        if (frame_end(&c->receiver, &frame)) {
            delivery_handle(c, &frame);
        }
        if (aborts) {
            edm_abort(c);
        }
    }
    return taken;
}

void edm_abort(struct edm_controller *c) {
    states_raise(c, FAULT_ABORT_RUN, 0);
}

void edm_line_read(struct edm_controller *c) {
    if (guards_too_noisy(c)) {
        states_raise(c, FAULT_LINE_NOISE, c->settings.bad_frames);
    }
}
