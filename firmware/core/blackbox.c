/* One sample of every millisecond; a fault freezes them (docs/protocol.md, Black box). They are kept as they were measured,
 * and read bit for bit as TLM with a period of 1000 µs carries them. */
#include "core.h"

#define PER_REPLY 14

/* Check of a sample with its millisecond and the start of its controller: memory that has outlasted a reset is right where
 * they agree, and what stands beside the ring with it. */
static uint16_t check_of(const struct edm_sample *sample, int64_t tick, int64_t boot_tick) {
    static const uint32_t keys[] = {0x9E3779B1u, 0x85EBCA77u, 0xC2B2AE3Du, 0x27D4EB2Fu, 0x165667B1u,
                                    0xD3A2646Du, 0xFD7046C5u, 0xB55A4F09u, 0x8CB92BA7u, 0xDB4F0B91u};
    uint32_t words[sizeof *sample / sizeof(uint32_t)];
    struct edm_sample unchecked = *sample;
    unchecked.check = 0;
    memcpy(words, &unchecked, sizeof words);
    uint64_t sum = (uint64_t)tick * 0x9E3779B97F4A7C15u + (uint64_t)boot_tick * 0xBF58476D1CE4E5B9u;
    for (size_t i = 0; i < sizeof words / sizeof words[0]; i++) {
        sum += (uint64_t)words[i] * keys[i];
    }
    sum ^= sum >> 32;
    return (uint16_t)(sum ^ sum >> 16);
}

_Static_assert(sizeof(struct edm_sample) <= 10 * sizeof(uint32_t), "a key for every word of a sample");

/* Records the millisecond. */
void blackbox_record(struct edm_controller *c, uint8_t flags) {
    struct edm_black_box *box = &c->box;
    box->newest_flags = flags;
    if (box->frozen) {
        return;
    }
    struct edm_sample *sample = &box->ring[(size_t)(c->tick - 1) % EDM_BOX_SAMPLES];
    sample->displacement_um = c->gap.displacement_um;
    sample->actuator_v = c->drive.actuator_v;
    sample->gap_v = c->gap.gap_v;
    sample->charge_uc = gap_charge(c);
    for (int k = 0; k < 4; k++) {
        sample->counts[k] = (uint8_t)c->gap.tick.of[k]; /* EDM_MOST_PULSES at most */
    }
    sample->state = c->state;
    sample->flags = flags;
    if (EDM_BOX_LASTS) {
        sample->check = check_of(sample, c->tick, c->boot_tick);
    }
}

void blackbox_freeze(struct edm_controller *c) {
    struct edm_black_box *box = &c->box;
    if (!box->frozen) {
        box->frozen = true;
        box->frozen_tick = c->tick;
        box->frozen_boot_tick = c->boot_tick;
    }
}

/* CLEAR_FAULT: the record begins anew. */
void blackbox_thaw(struct edm_controller *c) {
    struct edm_black_box *box = &c->box;
    box->frozen = false;
    box->since_tick = c->tick;
}

/* After a reset, in memory that has outlasted it: keeps the samples that are right, from the newest one back, and the clock
 * that counts them. False where none is, or where the latched fault does not agree with them. */
bool blackbox_recover(struct edm_controller *c) {
    struct edm_black_box *box = &c->box;
    int64_t end = box->frozen ? box->frozen_tick : c->tick;
    int64_t boot = box->frozen ? box->frozen_boot_tick : c->boot_tick;
    if (box->frozen != (c->keeps.fault != 0) || end <= 0 || boot < 0 || boot > end || box->since_tick > end) {
        return false;
    }
    int64_t first = end > EDM_BOX_SAMPLES ? end - EDM_BOX_SAMPLES : 0;
    first = first < boot ? boot : first;
    first = first < box->since_tick ? box->since_tick : first;
    int64_t tick = end;
    while (tick > first) {
        const struct edm_sample *sample = &box->ring[(size_t)(tick - 1) % EDM_BOX_SAMPLES];
        if (sample->check != check_of(sample, tick, boot)) {
            break;
        }
        tick--;
    }
    box->since_tick = tick;
    c->tick = end;
    c->boot_tick = boot;
    return tick < end;
}

/* BLACKBOX_READ: up to 14 samples from sample `offset` on, the oldest being sample 0. */
void blackbox_read(struct edm_controller *c, uint16_t offset, struct edm_reply *reply) {
    const struct edm_black_box *box = &c->box;
    int64_t end = box->frozen ? box->frozen_tick : c->tick;
    int64_t boot = box->frozen ? box->frozen_boot_tick : c->boot_tick;
    int64_t origin = box->since_tick > boot ? box->since_tick : boot;
    int64_t total = end - origin < EDM_BOX_SAMPLES ? end - origin : EDM_BOX_SAMPLES;
    int64_t first = end - total + offset;
    int64_t rest = total > offset ? total - offset : 0;
    uint8_t n = (uint8_t)(rest < PER_REPLY ? rest : PER_REPLY);
    const struct blackbox_read_reply header = {
        .total = (uint16_t)total,
        .t0_us = (uint32_t)((first + 1 - boot) * TICK_US),
        .n = n,
    };
    blackbox_read_reply_write(reply->payload, &header);
    for (uint8_t i = 0; i < n; i++) {
        telemetry_write(reply->payload + BLACKBOX_READ_REPLY_SIZE + (size_t)i * TLM_RECORD_SIZE,
                        &box->ring[(size_t)(first + i) % EDM_BOX_SAMPLES], 1);
    }
    reply->size = (uint8_t)(BLACKBOX_READ_REPLY_SIZE + n * TLM_RECORD_SIZE);
}

_Static_assert((EDM_BOX_SAMPLES & (EDM_BOX_SAMPLES - 1)) == 0, "a power of two, so that places wrap");
_Static_assert(EDM_BOX_SAMPLES >= 500 && EDM_BOX_SAMPLES <= 2048, "what the protocol asks for");
_Static_assert(BLACKBOX_READ_REPLY_RECORD_SIZE == TLM_RECORD_SIZE && PER_REPLY <= BLACKBOX_READ_REPLY_MOST,
               "samples are those of TLM");
