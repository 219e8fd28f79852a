/* Samples on their way to a host that waits: which end its wait, and those that it takes without frames. */
#include "host.h"

#include "../core/core.h"

#define CALM 16
#define JUDGED_TICKS 100 /* shares over less time scatter too much */

/* Whether a supervisor has to see the newest samples at once: the state has changed, or since it was asked last, JUDGED_TICKS
 * ago at least, no discharge was normal or more than one pulse in CALM was an arc or a short. */
bool host_samples_are_urgent(struct edm_host *h) {
    const int64_t *of = h->pulses;
    int64_t state = h->core.state, before = h->samples_state, pulses = of[0] + of[1] + of[2] + of[3];
    bool calm = pulses == 0 || (of[1] > 0 && CALM * (of[2] + of[3]) <= pulses);
    bool is_due = h->core.tick - h->judged_tick >= JUDGED_TICKS;
    h->samples_state = state;
    if (is_due) {
        h->judged_tick = h->core.tick;
        memset(h->pulses, 0, sizeof h->pulses);
    }
    return state != before || (is_due && state == STATE_MACHINING && !calm);
}

/* Takes a TLM frame out of its encoding: to what came before, if it goes on from there without a gap. */
bool host_merge_samples(struct edm_host *h, const uint8_t *frame, size_t size) {
    struct edm_receiver receiver = {.filled = 0};
    struct edm_frame plain;
    if (h->seen.sample_bytes + (int64_t)(sizeof(struct merged) + MAX_PAYLOAD) > SAMPLES_BYTES) {
        return false;
    }
    frame_fill(&receiver, frame + 1, size - 2);
    if (!frame_end(&receiver, &plain)) {
        return false;
    }
    struct tlm head;
    tlm_read(&head, plain.payload);
    struct merged *last = (struct merged *)(h->samples + h->merged_at);
    bool goes_on = h->seen.sample_bytes > 0 && head.dropped == 0 && head.period_us == last->period_us &&
                   head.t0_us == (uint32_t)(last->t0_us + last->samples * last->period_us);
    if (!goes_on) {
        h->merged_at = (size_t)h->seen.sample_bytes;
        last = (struct merged *)(h->samples + h->merged_at);
        *last = (struct merged){.t0_us = head.t0_us, .period_us = head.period_us, .dropped = head.dropped};
        h->seen.sample_bytes += (int64_t)sizeof *last;
    }
    last->counter = head.counter;
    last->frames++;
    last->samples += head.n;
    size_t bytes = (size_t)head.n * TLM_RECORD_SIZE;
    memcpy(h->samples + h->seen.sample_bytes, plain.payload + TLM_SIZE, bytes);
    h->seen.sample_bytes += (int64_t)bytes;
    return true;
}
