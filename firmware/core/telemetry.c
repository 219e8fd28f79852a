/* Samples and pulses, gathered into frames (docs/protocol.md, Telemetry). */
#include "core.h"

#define FRAME_BYTES 11 /* of every frame beside its payload: header, check, COBS, two zeros */
#define RESERVE R(1.25) /* of a line, for replies and events */
#define BITS_PER_BYTE R(10.0) /* on the line: 8 of data, start and stop bit */
#define BATCH_MOST 14 /* samples a frame, by the protocol */
#define BLOCK_MOST 4294967040u /* the greatest float below 2^32 */
#define FARTHEST R(2147483520.0) /* nm: the greatest float below 2^31 */
#define COUNT_MOST 255 /* pulses of a sample: a class is told by a byte */

_Static_assert(BATCH_MOST <= TLM_MOST, "a frame holds a batch");

/* Bytes a second on the line that a request asks for. */
static real bytes_per_second(const struct edm_controller *c, const struct tlm_start *request) {
    real samples_s = R(1e6) / (real)request->period_us;
    real bytes_s = samples_s * (TLM_RECORD_SIZE + R(FRAME_BYTES + TLM_SIZE) / (real)request->batch);
    real pulses_s = R(1e9) / (real)c->settings.pulse_period_ns;
    if (request->pulse_log == PULSE_LOG_FULL) {
        bytes_s += pulses_s * (PULSES_RECORD_SIZE + R(FRAME_BYTES + PULSES_SIZE) / PULSES_MOST);
    } else if (request->pulse_log == PULSE_LOG_BLOCKS) {
        real blocks_s = pulses_s / (real)c->settings.block_size;
        bytes_s += blocks_s * (PULSE_BLOCKS_RECORD_SIZE + R(FRAME_BYTES + PULSE_BLOCKS_SIZE) / PULSE_BLOCKS_MOST);
    }
    return bytes_s;
}

/* Forgets pulses that are pending, the block begun among them. */
static void begin_log(struct edm_telemetry *t) {
    t->log_pending = 0;
    t->block_pulses = 0;
    memset(&t->block_counts, 0, sizeof t->block_counts);
    t->block_delay_us = t->block_energy_uj = 0;
}

/* TLM_START; the period counts from controller time zero. */
uint8_t telemetry_start(struct edm_controller *c, const struct tlm_start *request) {
    struct edm_telemetry *t = &c->telemetry;
    int64_t period_ns = (int64_t)request->period_us * 1000;
    if (request->period_us % TICK_US != 0 || request->batch < 1 || request->batch > BATCH_MOST ||
        request->pulse_log > PULSE_LOG_FULL || period_ns > COUNT_MOST * (int64_t)c->settings.pulse_period_ns) {
        return STATUS_OUT_OF_RANGE;
    }
    real needed = RESERVE * bytes_per_second(c, request);
    if (c->identity.baud != 0 && needed > (real)c->identity.baud / BITS_PER_BYTE) {
        return STATUS_RATE_TOO_HIGH;
    }
    t->ticks = request->period_us / TICK_US;
    t->next = c->boot_tick + ((c->tick - c->boot_tick) / t->ticks + 1) * t->ticks;
    t->pending = 0;
    memset(&t->counts, 0, sizeof t->counts);
    t->charge_uc = 0;
    t->contact = false;
    t->batch = request->batch;
    t->log = request->pulse_log;
    begin_log(t);
    return STATUS_OK;
}

/* Stops at once; what is pending is lost. */
void telemetry_forget(struct edm_controller *c) {
    c->telemetry.next = -1;
    c->telemetry.log = PULSE_LOG_OFF;
    c->telemetry.pending = 0;
    begin_log(&c->telemetry);
}

/* TLM_STOP: what is pending goes first. */
void telemetry_stop(struct edm_controller *c) {
    telemetry_flush(c);
    c->telemetry.next = -1;
    c->telemetry.log = PULSE_LOG_OFF;
}

static uint8_t at_most_255(int32_t count) {
    return (uint8_t)(count < 255 ? count : 255);
}

/* Counts of a sample: the nearest, the greater one of two, within 0 and `high`. */
static uint32_t counts_up(real value, uint32_t high) {
    if (!(value > 0)) {
        return 0;
    }
    return value < (real)high ? (uint32_t)(value + R(0.5)) : high;
}

static uint16_t counts_up_u16(real value) {
    return (uint16_t)counts_up(value, UINT16_MAX);
}

/* Writes a sample as telemetry and black box carry it; its charge is that of `ticks` milliseconds. */
void telemetry_write(uint8_t *p, const struct edm_sample *sample, int32_t ticks) {
    real mean_a = sample->charge_uc / ((real)ticks * R(1000.0));
    const struct tlm_record record = {
        .displacement_um = floor_of(within(sample->displacement_um * R(1000.0) + R(0.5), FARTHEST)),
        .actuator_v = counts_up_u16(sample->actuator_v * STEPS_PER_V),
        .gap_v = counts_up_u16(sample->gap_v * R(200.0)),
        .current_a = counts_up_u16(mean_a * R(1000.0)),
        .n_normal = sample->counts[PULSE_CLASS_NORMAL],
        .n_arc = sample->counts[PULSE_CLASS_ARC],
        .n_short = sample->counts[PULSE_CLASS_SHORT],
        .n_open = sample->counts[PULSE_CLASS_OPEN],
        .state = sample->state,
        .flags = sample->flags,
    };
    tlm_record_write(p, &record);
}

/* Ends a telemetry sample. Samples that nobody has sent are discarded, and counted. */
void telemetry_sample(struct edm_controller *c, uint8_t flags) {
    struct edm_telemetry *t = &c->telemetry;
    if (t->pending == EDM_PENDING_SAMPLES) {
        t->dropped += (uint32_t)t->pending;
        t->pending = 0;
    }
    t->next += t->ticks;
    struct edm_sample sample = {
        .displacement_um = c->gap.displacement_um,
        .actuator_v = c->drive.actuator_v,
        .gap_v = c->gap.gap_v,
        .charge_uc = t->charge_uc,
        .state = c->state,
        .flags = (uint8_t)(flags | (t->contact ? TLM_FLAGS_CONTACT : 0)),
    };
    for (int k = 0; k < 4; k++) {
        sample.counts[k] = at_most_255(t->counts.of[k]);
    }
    telemetry_write(t->samples[t->pending++], &sample, t->ticks);
    t->charge_uc = 0;
    t->contact = false;
    memset(&t->counts, 0, sizeof t->counts);
}

/* Makes a record of the block begun, whole or not. */
static void close_block(struct edm_telemetry *t) {
    if (t->block_pulses == 0) {
        return;
    }
    const struct pulse_blocks_record block = {
        .n_open = (uint8_t)t->block_counts.of[PULSE_CLASS_OPEN],
        .n_normal = (uint8_t)t->block_counts.of[PULSE_CLASS_NORMAL],
        .n_arc = (uint8_t)t->block_counts.of[PULSE_CLASS_ARC],
        .n_short = (uint8_t)t->block_counts.of[PULSE_CLASS_SHORT],
        .delay_us = counts_up(t->block_delay_us * R(10.0), BLOCK_MOST),
        .energy_uj = counts_up(t->block_energy_uj * R(10.0), BLOCK_MOST),
    };
    pulse_blocks_record_write(t->records + (size_t)t->log_pending * PULSE_BLOCKS_RECORD_SIZE, &block);
    int32_t pending = t->log_pending + 1;
    begin_log(t);
    t->log_pending = pending;
}

/* Makes a record of pulse i of the tick. */
static void log_one(struct edm_telemetry *t, const struct edm_readings *readings, int i, uint8_t pulse_class) {
    const struct pulses_record pulse = {
        .pulse_class = pulse_class,
        .delay_us = counts_up_u16(readings->delay_us[i] * R(10.0)),
        .discharge_us = counts_up_u16(readings->discharge_us[i] * R(10.0)),
        .plateau_v = (uint8_t)counts_up(readings->plateau_v[i] * R(2.0), UINT8_MAX),
    };
    pulses_record_write(t->records + (size_t)t->log_pending++ * PULSES_RECORD_SIZE, &pulse);
}

/* Adds pulse i of the tick to what TLM_START asked for: a record each, or sums over block_pulses of them. */
static void log_pulse(struct edm_controller *c, int i, uint8_t pulse_class) {
    struct edm_telemetry *t = &c->telemetry;
    if (t->log_pending == EDM_PENDING_PULSES) {
        begin_log(t); /* nobody has sent them: the counter of the frames tells */
        t->pulse_counter++;
    }
    if (t->log_pending == 0 && t->block_pulses == 0) {
        t->log_pulse_no = c->gap.pulse_no + (uint32_t)i;
        t->log_t0_ns = c->readings.first_pulse_ns + (int64_t)i * c->settings.pulse_period_ns;
    }
    if (t->log == PULSE_LOG_FULL) {
        log_one(t, &c->readings, i, pulse_class);
        return;
    }
    t->block_counts.of[pulse_class]++;
    t->block_delay_us += c->readings.delay_us[i];
    t->block_energy_uj += c->readings.energy_uj[i];
    t->block_pulses++;
    if (t->block_pulses == c->settings.block_size) {
        close_block(t);
    }
}

/* Adds all pulses of the tick. */
void telemetry_log_pulses(struct edm_controller *c, const uint8_t *classes) {
    for (int i = 0; i < c->readings.pulses; i++) {
        log_pulse(c, i, classes[i]);
    }
}

/* Sends the first `count` samples. */
static void send_samples(struct edm_controller *c, int32_t count) {
    struct edm_telemetry *t = &c->telemetry;
    int64_t last_tick = t->next - t->ticks - c->boot_tick;
    int64_t first_us = (last_tick - (int64_t)(t->pending - 1) * t->ticks) * TICK_US;
    int32_t n;
    for (int32_t at = 0; at < count; at += n) {
        uint8_t payload[MAX_PAYLOAD];
        n = count - at < t->batch ? count - at : t->batch;
        const struct tlm header = {
            .counter = t->counter++,
            .t0_us = (uint32_t)(first_us + (int64_t)at * t->ticks * TICK_US),
            .period_us = (uint16_t)(t->ticks * TICK_US),
            .n = (uint8_t)n,
            .dropped = at_most_255((int32_t)(t->dropped < 255 ? t->dropped : 255)),
        };
        t->dropped = 0;
        tlm_write(payload, &header);
        memcpy(payload + TLM_SIZE, t->samples[at], (size_t)n * TLM_RECORD_SIZE);
        delivery_send(c, MSG_TLM, payload, (size_t)(TLM_SIZE + n * TLM_RECORD_SIZE));
    }
    t->pending -= count;
    memmove(t->samples, t->samples[count], (size_t)t->pending * TLM_RECORD_SIZE);
}

/* Sends n records, pulses or blocks, in a frame; the time of the next one follows from theirs. */
static void send_pulse_frame(struct edm_controller *c, const uint8_t *records, int32_t n) {
    struct edm_telemetry *t = &c->telemetry;
    uint8_t payload[MAX_PAYLOAD];
    int32_t header, size;
    uint32_t t0_us = (uint32_t)((t->log_t0_ns - c->boot_tick * TICK_NS) / 1000);
    uint32_t period_ns = (uint32_t)c->settings.pulse_period_ns;
    int32_t pulses = n;
    if (t->log == PULSE_LOG_FULL) {
        const struct pulses head = {t->pulse_counter++, t->log_pulse_no, t0_us, period_ns, (uint8_t)n};
        pulses_write(payload, &head);
        header = PULSES_SIZE;
        size = n * PULSES_RECORD_SIZE;
    } else {
        uint8_t block = (uint8_t)c->settings.block_size;
        const struct pulse_blocks head = {t->pulse_counter++, t->log_pulse_no, t0_us, period_ns, block, (uint8_t)n};
        pulse_blocks_write(payload, &head);
        header = PULSE_BLOCKS_SIZE;
        size = n * PULSE_BLOCKS_RECORD_SIZE;
        pulses = n * c->settings.block_size;
    }
    memcpy(payload + header, records, (size_t)size);
    delivery_send(c, t->log == PULSE_LOG_FULL ? MSG_PULSES : MSG_PULSE_BLOCKS, payload, (size_t)header + (size_t)size);
    t->log_pulse_no += (uint32_t)pulses;
    t->log_t0_ns += (int64_t)pulses * c->settings.pulse_period_ns;
}

/* Sends the first `count` records of pulses or blocks. */
static void send_pulses(struct edm_controller *c, int32_t count) {
    struct edm_telemetry *t = &c->telemetry;
    bool full = t->log == PULSE_LOG_FULL;
    int32_t per_frame = full ? PULSES_MOST : PULSE_BLOCKS_MOST;
    size_t size = full ? PULSES_RECORD_SIZE : PULSE_BLOCKS_RECORD_SIZE;
    int32_t n;
    for (int32_t at = 0; at < count; at += n) {
        n = count - at < per_frame ? count - at : per_frame;
        send_pulse_frame(c, t->records + (size_t)at * size, n);
    }
    t->log_pending -= count;
    memmove(t->records, t->records + (size_t)count * size, (size_t)t->log_pending * size);
}

/* Sends every frame that is full. */
void telemetry_send_full(struct edm_controller *c) {
    const struct edm_telemetry *t = &c->telemetry;
    int32_t per_frame = t->log == PULSE_LOG_FULL ? PULSES_MOST : PULSE_BLOCKS_MOST;
    if (t->batch > 0 && t->pending >= t->batch) {
        send_samples(c, t->pending / t->batch * t->batch);
    }
    if (t->log_pending >= per_frame) {
        send_pulses(c, t->log_pending / per_frame * per_frame);
    }
}

/* Sends everything pending, the begun block included: what an event ends. */
void telemetry_flush(struct edm_controller *c) {
    struct edm_telemetry *t = &c->telemetry;
    if (t->pending > 0) {
        send_samples(c, t->pending);
    }
    close_block(t);
    if (t->log_pending > 0) {
        send_pulses(c, t->log_pending);
    }
}
