/* The board that the core finds in a process: records of the virtual plant, callbacks into its model, bytes in memory. */
#include "host.h"

#include "../core/core.h"

#include <stddef.h>

_Static_assert(offsetof(struct edm_host, core) == 0, "the core is first");
_Static_assert(EDM_BOX_SAMPLES == BOX_TICKS, "the black box of a library");

static struct edm_host *host_of(void *board) {
    return board;
}

void hal_send(void *board, const uint8_t *frame, size_t size) {
    struct edm_host *h = host_of(board);
    uint8_t type = frame[2];
    if (type == MSG_TLM) {
        memcpy(h->last_samples, frame, size);
    }
    if (type == MSG_EVENT || type == MSG_FAULT || type == MSG_BOOT || (type == MSG_TLM && host_samples_are_urgent(h))) {
        h->urgent = true;
    }
    if (type == MSG_TLM && h->seen.merges && host_merge_samples(h, frame, size)) {
        return;
    }
    if (h->seen.out_bytes + (int64_t)size > OUT_BYTES) {
        h->seen.lost_frames++;
        return;
    }
    memcpy(h->out + h->seen.out_bytes, frame, size);
    h->seen.out_bytes += (int64_t)size;
}

void hal_inputs(void *board, struct edm_inputs *inputs) {
    const struct inputs *now = &host_of(board)->inputs;
    inputs->estop = now->estop != 0;
    inputs->door_open = now->door_open != 0;
    inputs->hv_supply_ok = now->hv_supply_ok != 0;
    inputs->level_ok = now->level_ok != 0;
    inputs->limit_switch = now->limit_switch != 0;
    inputs->stage_moves = false; /* the model's stages keep their time */
    inputs->flow_lpm = (real)now->flow_lpm;
    inputs->temperature_c = (real)now->temperature_c;
    inputs->monitor_v = (real)now->monitor_v;
}

void hal_gate(void *board, bool on) {
    (void)board; /* the plant reads it in the drive */
    (void)on;
}

real hal_set_generator(void *board, const struct edm_generator *g) {
    const struct host_callbacks *model = &host_of(board)->callbacks;
    return (real)model->set_generator((double)g->on_time_us, (double)g->off_time_us, (double)g->open_v,
                                      (double)g->peak_a, (double)g->discharge_us);
}

real hal_stage_speed_max(void *board, uint8_t axis) {
    (void)board; /* the model's stages are as fast as they are told to be */
    (void)axis;
    return (real)__builtin_inf();
}

real hal_stage_place(void *board, uint8_t axis, real at) {
    (void)board; /* and stand where they are told to be */
    (void)axis;
    return at;
}

void hal_stage_start(void *board, uint8_t axis, real target, real speed) {
    (void)board; /* the model's stage lands when it is told that it has */
    (void)axis;
    (void)target;
    (void)speed;
}

void hal_stage_stop(void *board, uint8_t axis, real at) {
    host_of(board)->callbacks.stage_stop(axis, (double)at);
}

void hal_path_begin(void *board) {
    host_of(board)->follows_path = true;
    host_of(board)->callbacks.path_begin();
}

void hal_path_line(void *board, uint8_t row) {
    host_of(board)->callbacks.path_line(row);
}

void hal_path_end(void *board) {
    host_of(board)->follows_path = false;
    host_of(board)->callbacks.path_end();
}

uint32_t hal_wave_memory(void *board) {
    return (uint32_t)host_of(board)->callbacks.wave_memory();
}

void hal_wave_keep(void *board, int64_t begin_ns, int64_t end_ns) {
    (void)begin_ns; /* the model keeps its newest pulses */
    (void)end_ns;
    host_of(board)->callbacks.wave_keep();
}

void hal_wave_read(void *board, uint32_t offset, uint8_t samples, int16_t *counts) {
    host_of(board)->callbacks.wave_read(offset, samples, counts);
}

void hal_wave_forget(void *board, bool kept) {
    host_of(board)->callbacks.wave_forget(kept);
}

void hal_persist(void *board, const struct edm_persistent *words) {
    (void)board; /* they stand in the memory that the caller keeps */
    (void)words;
}

static void put_drive(struct edm_host *h) {
    const struct edm_drive *from = &h->core.drive;
    struct drive *to = h->drive;
    to->actuator_v = (double)from->actuator_v;
    to->pulses_on = from->pulses_on;
    to->pulse_starts = from->pulse_starts;
    to->contact_tests = from->contact_tests;
    to->stage_moves = from->stage_moves;
    if (from->stage_moves || h->core.scan.follows) {
        to->stage_x_um = (double)from->stage_um[AXIS_X];
        to->stage_y_um = (double)from->stage_um[AXIS_Y];
        to->stage_line = from->stage_line;
        to->stage_lines_done = from->stage_lines_done;
        to->stage_share = (double)from->stage_share;
        to->stage_way_um = (double)from->stage_way_um;
    }
}

static void take_readings(struct edm_host *h) {
    const struct readings *from = h->readings;
    struct edm_readings *to = &h->core.readings;
    int pulses = from->pulses < EDM_MOST_PULSES ? (int)from->pulses : EDM_MOST_PULSES;
    to->sensor_um = (real)from->sensor_um;
    to->monitor_v = (real)from->monitor_v;
    to->gap_v = (real)from->gap_v;
    to->charge_uc = (real)from->charge_uc;
    to->generator_siemens = (real)from->generator_siemens;
    to->off_time_a = (real)from->off_time_a;
    to->contact = from->contact != 0;
    to->stray_pulses = (uint8_t)(from->stray_pulses < 255 ? from->stray_pulses : 255);
    to->pulses = (uint8_t)pulses;
    to->first_pulse_ns = from->first_pulse_ns;
    for (int i = 0; i < pulses; i++) {
        to->delay_us[i] = (real)from->delay_us[i];
        to->discharge_us[i] = (real)from->discharge_us[i];
        to->plateau_v[i] = (real)from->plateau_v[i];
        to->energy_uj[i] = (real)from->energy_uj[i];
    }
}

/* Shows the caller what stands in the controller. */
static void show(struct edm_host *h) {
    const struct edm_controller *c = &h->core;
    struct seen *seen = &h->seen;
    put_drive(h);
    seen->tick = c->tick;
    seen->boot_tick = c->boot_tick;
    seen->state = c->state;
    seen->armed = c->armed;
    seen->fault = c->keeps.fault;
    seen->boot_count = c->keeps.boot_count;
    seen->frozen_tick = c->box.frozen ? c->box.frozen_tick : -1;
    seen->watchdog_ticks = c->settings.watchdog_ticks;
    seen->param_crc = c->parameters.crc;
    seen->mode = c->motion.mode;
    seen->tick_counts = 0;
    for (int k = 0; k < 4; k++) {
        seen->tick_counts |= (int64_t)c->gap.tick.of[k] << (PACK * k);
    }
    seen->pulse_no = c->gap.pulse_no;
    seen->tlm_next = c->telemetry.next;
    seen->scanning = c->scan.scanning;
    seen->command_v = (double)c->motion.command_v;
    seen->displacement_um = (double)c->gap.displacement_um;
    seen->slow_displacement_um = (double)c->gap.slow_displacement_um;
    seen->gap_v = (double)c->gap.gap_v;
    seen->rx_bad = c->receiver.bad;
    seen->rx_drop = c->link.drop;
    seen->rx_frames = c->link.frames;
    seen->urgent = c->link.urgent || h->urgent;
    seen->due = c->link.due;
    seen->advanced = c->link.advanced;
    seen->advancing = c->link.advance_came;
    seen->advance_us = c->link.advance_us;
    seen->reboot_asked = c->link.reboot_asked;
    seen->arms = c->arms;
    seen->touch_offs = c->touch_offs;
    seen->session = c->link.session;
    seen->zero_um = (double)c->zero_um;
    struct edm_inputs inputs;
    seen->interlocks = guards_interlocks(&h->core, &inputs);
    seen->pulses_allowed = c->pulses_allowed;
    seen->pulse_period_ns = c->settings.pulse_period_ns;
    seen->duty_v = (double)c->settings.duty_v;
    seen->sensor_fitted = !c->settings.sensor_missing;
}

EDM_EXPORT size_t edm_host_size(void);
EDM_EXPORT size_t edm_host_inputs_at(void);
EDM_EXPORT size_t edm_host_seen_at(void);
EDM_EXPORT size_t edm_host_out_at(void);
EDM_EXPORT size_t edm_host_last_samples_at(void);
EDM_EXPORT size_t edm_host_samples_at(void);
EDM_EXPORT int edm_host_real_bytes(void);
EDM_EXPORT uint32_t edm_host_schema_hash(void);
EDM_EXPORT void edm_host_bind(struct edm_host *h, struct drive *drive, const struct readings *readings,
                            const struct host_callbacks *callbacks);
EDM_EXPORT void edm_host_create(struct edm_host *h, const char serial[12], const double stages_at[3]);
EDM_EXPORT void edm_host_set(struct edm_host *h, int board, uint32_t baud, int driven, double host_time_scale);
EDM_EXPORT size_t edm_host_receive(struct edm_host *h, const uint8_t *bytes, size_t size);
EDM_EXPORT void edm_host_line_read(struct edm_host *h);
EDM_EXPORT void edm_host_advanced(struct edm_host *h);
EDM_EXPORT void edm_host_taken(struct edm_host *h);
EDM_EXPORT void edm_host_heard(struct edm_host *h);
EDM_EXPORT void edm_host_count_from(struct edm_host *h, int64_t since_us, uint16_t event_no, uint32_t boot_count,
                                  uint32_t frames, uint32_t pulse_no);
EDM_EXPORT void edm_host_fault(struct edm_host *h, int code, int detail);
EDM_EXPORT void edm_host_reset(struct edm_host *h, int cause);
EDM_EXPORT void edm_host_keep(const struct edm_host *h, struct kept *kept);
EDM_EXPORT void edm_host_take_up(struct edm_host *h, const struct kept *kept);

size_t edm_host_size(void) {
    return sizeof(struct edm_host);
}

size_t edm_host_inputs_at(void) {
    return offsetof(struct edm_host, inputs);
}

size_t edm_host_seen_at(void) {
    return offsetof(struct edm_host, seen);
}

size_t edm_host_out_at(void) {
    return offsetof(struct edm_host, out);
}

size_t edm_host_last_samples_at(void) {
    return offsetof(struct edm_host, last_samples);
}

size_t edm_host_samples_at(void) {
    return offsetof(struct edm_host, samples);
}

int edm_host_real_bytes(void) {
    return (int)sizeof(real);
}

uint32_t edm_host_schema_hash(void) {
    return SCHEMA_HASH;
}

/* Tells where the records and the model are; again after the memory has been copied. */
void edm_host_bind(struct edm_host *h, struct drive *drive, const struct readings *readings,
                   const struct host_callbacks *callbacks) {
    h->core.board = h;
    h->drive = drive;
    h->readings = readings;
    h->callbacks = *callbacks;
}

/* Makes the controller of a machine that has been switched on, in memory that edm_host_bind was called on. The stages are
 * at these places: x, y in µm and theta in degrees. */
void edm_host_create(struct edm_host *h, const char serial[12], const double stages_at[3]) {
    struct edm_identity identity = {.host_time_scale = 1};
    const struct edm_persistent keeps = {.boot_count = 1};
    memcpy(identity.serial, serial, sizeof identity.serial);
    edm_create(&h->core, h, &identity, &keeps);
    h->core.tick = h->core.boot_tick = h->readings->tick;
    for (int axis = AXIS_X; axis <= AXIS_THETA; axis++) {
        h->core.stages.at[axis] = (real)stages_at[axis];
    }
    show(h);
}

void edm_host_set(struct edm_host *h, int board, uint32_t baud, int driven, double host_time_scale) {
    struct edm_identity *identity = &h->core.identity;
    identity->board = (uint16_t)board;
    identity->baud = baud;
    identity->driven = driven != 0;
    identity->host_time_scale = (real)host_time_scale;
}

size_t edm_host_receive(struct edm_host *h, const uint8_t *bytes, size_t size) {
    size_t taken = edm_receive(&h->core, bytes, size);
    show(h);
    return taken;
}

void edm_host_line_read(struct edm_host *h) {
    edm_line_read(&h->core);
    show(h);
}

void edm_host_advanced(struct edm_host *h) {
    edm_advanced(&h->core);
    show(h);
}

/* What there was to send has been taken. */
void edm_host_taken(struct edm_host *h) {
    h->core.link.urgent = h->core.link.due = h->urgent = false;
    h->seen.urgent = h->seen.due = 0;
}

void edm_host_heard(struct edm_host *h) {
    h->core.heard_tick = h->core.tick;
}

/* Lets the clock be that of the plant, and every counter of the link what it is after a long time: for tests of a machine
 * that has been on for hours, and of the wrap of counters. */
void edm_host_count_from(struct edm_host *h, int64_t since_us, uint16_t event_no, uint32_t boot_count, uint32_t frames,
                         uint32_t pulse_no) {
    struct edm_controller *c = &h->core;
    c->tick = h->readings->tick;
    c->boot_tick = c->tick - since_us / TICK_US;
    c->telemetry.counter = c->telemetry.pulse_counter = (uint16_t)frames;
    c->keeps.event_no = event_no;
    c->keeps.boot_count = boot_count;
    c->receiver.bad = c->link.drop = frames;
    c->gap.pulse_no = pulse_no;
    show(h);
}

void edm_host_begin(struct edm_host *h) {
    edm_tick_begin(&h->core);
    h->drive->actuator_v = (double)h->core.drive.actuator_v;
    h->drive->generator = edm_generator_at_gap(&h->core);
    h->drive->stage_moves = 0; /* the rest stands there since the last call */
}

int64_t edm_host_end(struct edm_host *h) {
    take_readings(h);
    int happened = edm_tick_end(&h->core);
    for (int k = 0; k < 4; k++) {
        h->pulses[k] += h->core.gap.tick.of[k];
    }
    put_drive(h);
    return happened;
}

void edm_host_conclude(struct edm_host *h, int64_t happened) {
    edm_conclude(&h->core, (int)happened);
    show(h);
}

void edm_host_watch(struct edm_host *h) {
    edm_watch(&h->core);
    show(h);
}

/* The tick by which the core has to be called: something is due, or a telemetry frame is full. */
int64_t edm_host_slice_end(const struct edm_host *h) {
    const struct edm_telemetry *t = &h->core.telemetry;
    int64_t end = h->core.tick + EDM_LINGER_TICKS, due = edm_next_deadline(&h->core);
    int64_t full = t->next + (int64_t)(t->batch - 1 - t->pending) * t->ticks;
    end = due < end ? due : end;
    return t->next >= 0 && full < end ? full : end;
}

void edm_host_fault(struct edm_host *h, int code, int detail) {
    edm_fault(&h->core, (uint16_t)code, detail);
    show(h);
}

void edm_host_reset(struct edm_host *h, int cause) {
    edm_start(&h->core, (uint8_t)cause);
    show(h);
}

/* What outlives a loss of power, by names, so that another version of the core can take it up. */
void edm_host_keep(const struct edm_host *h, struct kept *kept) {
    const struct edm_controller *c = &h->core;
    const struct edm_black_box *box = &c->box;
    kept->fault = c->keeps.fault;
    kept->event_no = c->keeps.event_no;
    kept->boot_count = c->keeps.boot_count;
    kept->boot_tick = c->boot_tick;
    kept->since_tick = box->since_tick;
    kept->frozen = box->frozen;
    kept->frozen_tick = box->frozen_tick;
    kept->frozen_boot_tick = box->frozen_boot_tick;
    kept->flags = box->newest_flags;
    kept->waves_frozen = c->waveforms.frozen;
    kept->waves_empty = c->waveforms.empty;
    kept->waves_begin_ns = c->waveforms.begin_ns;
    kept->waves_end_ns = c->waveforms.end_ns;
    kept->waves_boot_ns = c->waveforms.boot_ns;
    for (int i = 0; i < BOX_TICKS; i++) {
        const struct edm_sample *sample = &box->ring[i];
        kept->displacement_um[i] = (double)sample->displacement_um;
        kept->actuator_v[i] = (double)sample->actuator_v;
        kept->gap_v[i] = (double)sample->gap_v;
        kept->charge_uc[i] = (double)sample->charge_uc;
        kept->opens[i] = sample->counts[0];
        kept->normals[i] = sample->counts[1];
        kept->arcs[i] = sample->counts[2];
        kept->shorts[i] = sample->counts[3];
        kept->states[i] = sample->state;
        kept->all_flags[i] = sample->flags;
    }
}

/* A byte of a file that may hold anything. */
static uint8_t byte_of(double value) {
    return value >= 0 && value <= UINT8_MAX ? (uint8_t)value : 0;
}

/* The controller of a machine that was kept, before it is switched on again. */
void edm_host_take_up(struct edm_host *h, const struct kept *kept) {
    struct edm_controller *c = &h->core;
    struct edm_black_box *box = &c->box;
    c->tick = h->readings->tick;
    c->boot_tick = kept->boot_tick < 0 || kept->boot_tick > c->tick ? c->tick : kept->boot_tick;
    c->keeps.fault = (uint16_t)kept->fault;
    c->keeps.event_no = (uint16_t)kept->event_no;
    c->keeps.boot_count = (uint32_t)kept->boot_count;
    box->since_tick = kept->since_tick;
    box->frozen = kept->frozen != 0;
    box->frozen_tick = kept->frozen_tick;
    box->frozen_boot_tick = kept->frozen_boot_tick;
    box->newest_flags = (uint8_t)kept->flags;
    c->waveforms.frozen = kept->waves_frozen != 0;
    c->waveforms.empty = kept->waves_empty != 0;
    c->waveforms.begin_ns = kept->waves_begin_ns;
    c->waveforms.end_ns = kept->waves_end_ns;
    c->waveforms.boot_ns = kept->waves_boot_ns;
    for (int i = 0; i < BOX_TICKS; i++) {
        box->ring[i] = (struct edm_sample){
            .displacement_um = (real)kept->displacement_um[i],
            .actuator_v = (real)kept->actuator_v[i],
            .gap_v = (real)kept->gap_v[i],
            .charge_uc = (real)kept->charge_uc[i],
            .counts = {byte_of(kept->opens[i]), byte_of(kept->normals[i]), byte_of(kept->arcs[i]), byte_of(kept->shorts[i])},
            .state = byte_of(kept->states[i]),
            .flags = byte_of(kept->all_flags[i]),
        };
    }
    show(h);
}
