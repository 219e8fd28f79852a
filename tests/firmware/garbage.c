/* Senseless input for the core on a board of nothing, to be run under sanitizers: `garbage SEED MEGABYTES`.
 *
 * Half of it is bytes that are no frames: none may be taken for a command. The other half are whole frames of every
 * type with any payload, and milliseconds with any readings. */
#include <stdio.h>
#include <stdlib.h>

#include "core.h"

static uint64_t state;

static uint32_t draw(uint32_t below) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)((state >> 33) % below);
}

void hal_send(void *board, const uint8_t *frame, size_t size) {
    if (size > FRAME_MOST || frame[0] != 0 || frame[size - 1] != 0 || memchr(frame + 1, 0, size - 2) != NULL) abort();
    *(uint64_t *)board += size;
}
void hal_inputs(void *board, struct edm_inputs *inputs) {
    (void)board;
    memset(inputs, 0, sizeof *inputs);
    inputs->hv_supply_ok = inputs->level_ok = true;
    inputs->flow_lpm = 1;
    inputs->estop = draw(2000) == 0;
    inputs->door_open = draw(2000) == 0;
    inputs->limit_switch = draw(500) == 0;
}
void hal_gate(void *board, bool on) { (void)board; (void)on; }
real hal_set_generator(void *board, const struct edm_generator *setting) { (void)board; return setting->peak_a / 20; }
real hal_stage_speed_max(void *board, uint8_t axis) { (void)board; (void)axis; return R(1e30); }
real hal_stage_place(void *board, uint8_t axis, real at) { (void)board; (void)axis; return at; }
void hal_stage_start(void *board, uint8_t axis, real target, real speed) {
    (void)board; (void)target;
    if (axis > 2 || !(speed > 0)) abort();
}
void hal_stage_stop(void *board, uint8_t axis, real at) { (void)board; (void)at; if (axis > 2) abort(); }
void hal_path_begin(void *board) { (void)board; }
void hal_path_line(void *board, uint8_t row) { (void)board; if (row >= EDM_PATH_LINES) abort(); }
void hal_path_end(void *board) { (void)board; }
uint32_t hal_wave_memory(void *board) { (void)board; return draw(3) * 40000; }
void hal_wave_keep(void *board, int64_t begin_ns, int64_t end_ns) { (void)board; (void)begin_ns; (void)end_ns; }
void hal_wave_read(void *board, uint32_t offset, uint8_t samples, int16_t *counts) {
    (void)board; (void)offset;
    memset(counts, 1, (size_t)samples * 4);
}
void hal_wave_forget(void *board, bool kept) { (void)board; (void)kept; }
void hal_persist(void *board, const struct edm_persistent *words) { (void)board; (void)words; }

static real any(real usual) {
    static const real odd[] = {0, -1, 1e-9, 5, 40, 1e6, -1e6, 1e30, -1e30};
    return draw(20) != 0 ? usual * (real)draw(1000) / 1000 : odd[draw(9)];
}

static void tick(struct edm_controller *c) {
    struct edm_readings *r = &c->readings;
    edm_tick_begin(c);
    if (!(c->drive.actuator_v >= 0 && c->drive.actuator_v <= 150)) abort();
    r->sensor_um = any(60);
    r->monitor_v = draw(100) ? c->drive.actuator_v : any(150);
    r->gap_v = draw(10) ? any(14) : -1;
    r->charge_uc = any(3);
    r->generator_siemens = c->settings.nominal_siemens * (real)(draw(2000) ? 1 : 9);
    r->off_time_a = draw(5000) ? 0 : 1;
    r->contact = draw(30) == 0;
    r->stray_pulses = draw(3000) == 0;
    r->pulses = c->drive.pulses_on ? (uint8_t)draw(draw(10) ? 5 : EDM_MOST_PULSES + 1) : 0;
    r->first_pulse_ns = c->tick * TICK_NS;
    for (int i = 0; i < r->pulses; i++) {
        r->delay_us[i] = any(100);
        r->discharge_us[i] = any(100);
        r->plateau_v[i] = any(45);
        r->energy_uj[i] = any(400);
    }
    edm_conclude(c, edm_tick_end(c));
    edm_watch(c);
}

static void bytes(struct edm_controller *c, uint8_t *data, size_t size, int kind) {
    for (size_t i = 0; i < size; i++) {
        data[i] = kind == 0 ? (uint8_t)draw(256) : kind == 1 ? (uint8_t)(draw(20) ? draw(256) : 0) : (uint8_t)draw(3);
    }
    for (size_t at = 0; at < size;) at += edm_receive(c, data + at, size - at);
    edm_line_read(c);
}

static void frame(struct edm_controller *c) {
    uint8_t payload[MAX_PAYLOAD], out[FRAME_MOST];
    static uint8_t seq;
    uint8_t type = (uint8_t)(draw(30) ? draw(REPLY_BIT) : draw(256));
    int size = edm_request_size(type);
    size_t n = size >= 0 && draw(20) ? (size_t)size : draw(MAX_PAYLOAD + 1);
    uint32_t plain = draw(3);
    for (size_t i = 0; i < n; i++) payload[i] = (uint8_t)(plain == 0 ? draw(256) : i % 4 > plain ? 0 : draw(256));
    uint8_t session = draw(50) ? c->link.session : (uint8_t)draw(256);
    if (type == MSG_HELLO && n == HELLO_SIZE) {
        payload[0] = PROTO_MAJOR;
        put_u32(payload + 6, SCHEMA_HASH);
        session = (uint8_t)(1 + draw(255));
    }
    if (type == MSG_ARM && n == ARM_SIZE) put_u32(payload, c->parameters.crc);
    if (type == MSG_CLEAR_FAULT && n == CLEAR_FAULT_SIZE) put_u16(payload, c->keeps.fault);
    if (type == MSG_HEARTBEAT && n == HEARTBEAT_SIZE) {
        put_u64(payload, (uint64_t)c->tick * 1000u);
        put_u16(payload + 8, c->keeps.event_no);
    }
    seq = (uint8_t)(seq + draw(2) + (draw(100) ? 0 : draw(256)));
    size_t total = frame_encode(out, type, seq, session, 0, payload, n);
    for (size_t at = 0; at < total;) at += edm_receive(c, out + at, total - at);
    edm_advanced(c);
    edm_line_read(c);
    if (c->link.reboot_asked) edm_start(c, RESET_CAUSE_COMMANDED);
}

int main(int argc, char **argv) {
    static struct edm_controller c;
    static uint8_t data[65536];
    static uint64_t sent;
    uint64_t taken = 0, wanted = (argc > 2 ? strtoull(argv[2], NULL, 10) : 1) << 20;
    const struct edm_identity identity = {.serial = "GARBAGE", .host_time_scale = 1};
    unsigned states = 0;
    state = argc > 1 ? strtoull(argv[1], NULL, 10) : 1;
    edm_create(&c, &sent, &identity, NULL);
    edm_start(&c, RESET_CAUSE_POWER_ON);
    for (; taken < wanted; taken += sizeof data) bytes(&c, data, sizeof data, (int)draw(3));
    if (c.link.frames != 0) {
        printf("%u commands in garbage\n", c.link.frames);
        return 1;
    }
    for (uint64_t i = 0; i < wanted / 32; i++) {
        frame(&c);
        if (draw(3) == 0) tick(&c);
        if (draw(50000) == 0) edm_start(&c, (uint8_t)draw(5));
        states |= 1u << c.state;
    }
    printf("%llu bytes of garbage, %u frames, %lld ms, states %#x, %llu bytes sent\n", (unsigned long long)taken,
           c.link.frames, (long long)c.tick, states, (unsigned long long)sent);
    return 0;
}
