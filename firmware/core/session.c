/* Who is the host: HELLO, and what begins and ends with a session (docs/protocol.md, Session). */
#include "core.h"

/* Moves the nonce of the present session among the former ones. */
static void retire_nonce(struct edm_controller *c) {
    struct edm_persistent *keeps = &c->keeps;
    if (!keeps->has_session) {
        return;
    }
    if (keeps->nonce_count == EDM_NONCES) {
        memmove(keeps->nonces, keeps->nonces + 1, (EDM_NONCES - 1) * sizeof keeps->nonces[0]);
        keeps->nonce_count--;
    }
    keeps->nonces[keeps->nonce_count++] = keeps->present_nonce;
    keeps->has_session = false;
}

/* Forgets what belonged to the session before; 0 is none. */
void session_begin(struct edm_controller *c, uint8_t session) {
    struct edm_link *link = &c->link;
    retire_nonce(c);
    link->session = session;
    link->advanced = false;
    link->has_newest = link->has_beat = false;
    link->reply_count = link->reply_at = 0;
    c->events.count = 0;
    hal_persist(c->board, &c->keeps);
}

/* Whether a HELLO with that nonce has opened the present session or one of the last ones. */
static bool is_used(const struct edm_controller *c, uint32_t nonce) {
    const struct edm_persistent *keeps = &c->keeps;
    if (keeps->has_session && nonce == keeps->present_nonce) {
        return true;
    }
    for (int i = 0; i < keeps->nonce_count; i++) {
        if (keeps->nonces[i] == nonce) {
            return true;
        }
    }
    return false;
}

/* What the host left running has nobody who watches it any more. */
static void open_session(struct edm_controller *c, const struct edm_frame *frame, uint32_t nonce) {
    struct edm_link *link = &c->link;
    session_begin(c, frame->session);
    memcpy(link->hello, frame->payload, HELLO_SIZE);
    link->newest = frame->seq;
    link->has_newest = true;
    c->keeps.present_nonce = nonce;
    c->keeps.has_session = true;
    hal_persist(c->board, &c->keeps);
    telemetry_forget(c);
    watchdog_feed(c);
    if (c->armed && !c->disarming) {
        states_raise(c, FAULT_HOST_SILENT, 0);
    }
}

/* Answers a HELLO. Only a new one that is answered OK opens a session; no other changes or feeds anything. */
void session_greet(struct edm_controller *c, const struct edm_frame *frame) {
    struct edm_link *link = &c->link;
    struct edm_reply *reply = &link->reply;
    if (frame->session == link->session && frame->size == HELLO_SIZE &&
        memcmp(frame->payload, link->hello, HELLO_SIZE) == 0) {
        reply->status = STATUS_OK;
        reply->size = HELLO_REPLY_SIZE;
        memcpy(reply->payload, link->welcome, HELLO_REPLY_SIZE);
        delivery_answer_now(c, frame);
        return;
    }
    delivery_execute(c, frame);
    if (reply->status == STATUS_OK) {
        struct hello request;
        hello_read(&request, frame->payload);
        if (is_used(c, request.host_nonce)) {
            link->drop++; /* a late copy must not open, with an empty memory, what it opened once */
            return;
        }
        open_session(c, frame, request.host_nonce);
        delivery_execute(c, frame); /* state and fault as they are after what the former host left running has ended */
        memcpy(link->welcome, reply->payload, HELLO_REPLY_SIZE);
    }
    delivery_answer_now(c, frame);
}
