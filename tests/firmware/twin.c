/* The core as an image has it, float, on the host: fed with what a board's half has measured, millisecond by millisecond.
 * Calls come in the order of firmware/board/stm32f4/main.c. Built and driven by board_twin.py. */
#include <string.h>

#include "board/measure.h"
#include "board/scale.h"
#include "edm.h"

#define OUT_BYTES 65536

static struct edm_controller c;
static struct edm_inputs now;
static uint8_t out[OUT_BYTES];
static uint32_t out_bytes;

_Static_assert(sizeof(real) == 4, "a board calculates in float");

void hal_send(void *board, const uint8_t *frame, size_t size) {
    (void)board;
    if (out_bytes + size <= OUT_BYTES) {
        memcpy(out + out_bytes, frame, size);
        out_bytes += (uint32_t)size;
    }
}

void hal_inputs(void *board, struct edm_inputs *inputs) {
    (void)board;
    *inputs = now;
}

real hal_set_generator(void *board, const struct edm_generator *setting) {
    (void)board;
    return setting->peak_a / most(setting->open_v - EDM_NORMAL_PLATEAU_V, R(0.1));
}

void hal_gate(void *board, bool on) { (void)board; (void)on; }
real hal_stage_speed_max(void *board, uint8_t axis) { (void)board; (void)axis; return R(1e30); }
real hal_stage_place(void *board, uint8_t axis, real at) { (void)board; (void)axis; return at; }
void hal_stage_start(void *board, uint8_t axis, real at, real speed) { (void)board; (void)axis; (void)at; (void)speed; }
void hal_stage_stop(void *board, uint8_t axis, real at) { (void)board; (void)axis; (void)at; }
void hal_path_begin(void *board) { (void)board; }
void hal_path_line(void *board, uint8_t row) { (void)board; (void)row; }
void hal_path_end(void *board) { (void)board; }
uint32_t hal_wave_memory(void *board) { (void)board; return 0; }
void hal_wave_keep(void *board, int64_t begin_ns, int64_t end_ns) { (void)board; (void)begin_ns; (void)end_ns; }
void hal_wave_read(void *board, uint32_t at, uint8_t n, int16_t *counts) { (void)board; (void)at; (void)n; (void)counts; }
void hal_wave_forget(void *board, bool what) { (void)board; (void)what; }
void hal_persist(void *board, const struct edm_persistent *words) { (void)board; (void)words; }

const uint32_t twin_layout[] = {
    sizeof(struct edm_readings),
    offsetof(struct edm_readings, contact),
    offsetof(struct edm_readings, pulses),
    offsetof(struct edm_readings, first_pulse_ns),
    offsetof(struct edm_readings, delay_us),
    offsetof(struct edm_readings, energy_uj),
    sizeof(struct edm_identity),
};

/* Levels of port G; slow channels as their ring holds them. */
void twin_inputs(uint32_t port, int stage_moves, const uint16_t *slow, uint32_t size, uint32_t at, int good) {
    const struct scans scans = {.ring = slow, .size = size, .at = at, .good = good != 0};
    now = (struct edm_inputs){
        .estop = (port & 1u) == 0,
        .door_open = (port & 2u) == 0,
        .hv_supply_ok = (port & 4u) != 0,
        .level_ok = (port & 8u) != 0,
        .limit_switch = (port & 16u) == 0,
        .stage_moves = stage_moves != 0,
        .flow_lpm = measure_slow(&scans, SLOW_FLOW),
        .temperature_c = measure_slow(&scans, SLOW_TEMPERATURE),
        .monitor_v = measure_slow(&scans, SLOW_MONITOR),
    };
}

/* A board that has been switched on. */
void twin_start(const struct edm_identity *identity) {
    static const struct edm_persistent none;
    out_bytes = 0;
    edm_create(&c, NULL, identity, &none);
    c.stages.at[AXIS_X] = (real)nearest(EDM_PARKED_X_UM / EDM_STEP_UM) * EDM_STEP_UM;
    edm_start(&c, RESET_CAUSE_POWER_ON);
    edm_tick_begin(&c);
}

/* A millisecond with those readings, and the bytes of the line that come behind it; returns how many there are to send. */
uint32_t twin_millisecond(const struct edm_readings *readings, const uint8_t *bytes, uint32_t size) {
    c.readings = *readings;
    edm_conclude(&c, edm_tick_end(&c));
    edm_watch(&c);
    edm_receive(&c, bytes, size);
    edm_line_read(&c);
    edm_tick_begin(&c);
    return out_bytes;
}

const uint8_t *twin_taken(void) {
    out_bytes = 0;
    return out;
}
