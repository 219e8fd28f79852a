/* Gap voltage and current about a fault (docs/protocol.md, Waveforms). The board samples them; here stands from when to when
 * they are kept, and how they are read. */
#include "core.h"

#define SAMPLE_NS 1000
#define PULSES_BEFORE 64
#define PERIODS_AFTER 16
#define MOST_SAMPLES 65536
#define SHARE_AFTER 5 /* a fifth of the memory is for the time after a fault */
#define PER_REPLY 58

/* Notes when the pulses of the tick began. */
void waveforms_note_pulses(struct edm_controller *c) {
    struct edm_waveforms *w = &c->waveforms;
    int pulses = c->readings.pulses;
    int64_t start_ns = c->readings.first_pulse_ns;
    for (int i = 0; i < pulses; i++, start_ns += c->settings.pulse_period_ns) {
        w->start_ns[w->at] = start_ns;
        w->at = (uint8_t)((w->at + 1) % SCOPE_PULSES);
    }
    w->count = (uint8_t)(w->count + pulses < SCOPE_PULSES ? w->count + pulses : SCOPE_PULSES);
}

/* Begins a new record, as after a reset or with another setting of the generator; what is kept stays. */
void waveforms_forget(struct edm_controller *c) {
    c->waveforms.count = 0;
    hal_wave_forget(c->board, false);
}

/* A fault: from the begin of the 64th pulse before it to 16 periods after it, as far as the memory goes. */
void waveforms_freeze(struct edm_controller *c) {
    struct edm_waveforms *w = &c->waveforms;
    if (w->frozen) {
        return;
    }
    int64_t period_ns = c->settings.pulse_period_ns;
    int64_t fault_ns = c->tick * TICK_NS;
    int64_t before_ns = PULSES_BEFORE * period_ns;
    int64_t after_ns = PERIODS_AFTER * period_ns;
    uint32_t memory = hal_wave_memory(c->board);
    memory = memory < MOST_SAMPLES ? memory : MOST_SAMPLES;
    int64_t most_after_ns = (int64_t)(memory / SHARE_AFTER) * SAMPLE_NS;
    int64_t most_before_ns = (int64_t)memory * SAMPLE_NS - most_after_ns;
    int64_t oldest_ns = fault_ns - (before_ns < most_before_ns ? before_ns : most_before_ns);
    w->empty = true;
    w->begin_ns = fault_ns;
    for (int i = w->count; i > 0 && w->empty; i--) {
        int64_t start_ns = w->start_ns[(w->at + SCOPE_PULSES - i) % SCOPE_PULSES];
        if (start_ns >= oldest_ns && start_ns <= fault_ns) {
            w->empty = false;
            w->begin_ns = start_ns / SAMPLE_NS * SAMPLE_NS;
        }
    }
    w->end_ns = fault_ns + (after_ns < most_after_ns ? after_ns : most_after_ns);
    w->boot_ns = c->boot_tick * TICK_NS;
    w->frozen = true;
    hal_wave_keep(c->board, w->begin_ns, w->end_ns);
}

/* CLEAR_FAULT forgets them. */
void waveforms_thaw(struct edm_controller *c) {
    c->waveforms.frozen = false;
    hal_wave_forget(c->board, true);
}

/* WAVEFORM_READ: up to 58 samples from sample `offset` on; BUSY while the time after the fault still runs. */
uint8_t waveforms_read(struct edm_controller *c, uint32_t offset, struct edm_reply *reply) {
    const struct edm_waveforms *w = &c->waveforms;
    struct waveform_read_reply header = {.period_ns = SAMPLE_NS};
    int16_t counts[2 * PER_REPLY];
    if (w->frozen && !w->empty) {
        if (c->tick * TICK_NS < w->end_ns) {
            return STATUS_BUSY;
        }
        header.total = (uint32_t)((w->end_ns - w->begin_ns) / SAMPLE_NS);
        header.t0_us = (uint32_t)((w->begin_ns - w->boot_ns) / 1000);
        uint32_t rest = header.total > offset ? header.total - offset : 0;
        header.n = (uint8_t)(rest < PER_REPLY ? rest : PER_REPLY);
    }
    waveform_read_reply_write(reply->payload, &header);
    if (header.n > 0) {
        hal_wave_read(c->board, offset, header.n, counts);
    }
    for (int i = 0; i < 2 * header.n; i++) {
        put_i16(reply->payload + WAVEFORM_READ_REPLY_SIZE + sizeof(int16_t) * (size_t)i, counts[i]);
    }
    reply->size = (uint8_t)(WAVEFORM_READ_REPLY_SIZE + header.n * WAVEFORM_READ_REPLY_RECORD_SIZE);
    return STATUS_OK;
}
