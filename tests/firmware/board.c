/* The least board: what has to be there so that the core compiles and links for a microcontroller. */
#include "../../firmware/edm.h"

static struct edm_controller c;
static const struct edm_identity identity = {.serial = "NOTHING", .board = 1, .host_time_scale = 1};
static volatile uint8_t line; /* something that the compiler cannot know */

void hal_send(void *board, const uint8_t *frame, size_t size) { (void)board; line = frame[size - 1]; }
void hal_inputs(void *board, struct edm_inputs *inputs) { (void)board; *inputs = (struct edm_inputs){.estop = line}; }
void hal_gate(void *board, bool on) { (void)board; line = on; }
real hal_set_generator(void *board, const struct edm_generator *setting) { (void)board; return setting->peak_a / 20; }
real hal_stage_speed_max(void *board, uint8_t axis) { (void)board; (void)axis; return R(1e30); }
real hal_stage_place(void *board, uint8_t axis, real at) { (void)board; (void)axis; return at; }
void hal_stage_start(void *board, uint8_t axis, real at, real speed) { (void)board; (void)axis; (void)at; (void)speed; }
void hal_stage_stop(void *board, uint8_t axis, real at) { (void)board; (void)axis; (void)at; }
void hal_path_begin(void *board) { (void)board; }
void hal_path_line(void *board, uint8_t row) { (void)board; (void)row; }
void hal_path_end(void *board) { (void)board; }
uint32_t hal_wave_memory(void *board) { (void)board; return 0; }
void hal_wave_keep(void *board, int64_t begin_ns, int64_t end_ns) { (void)board; (void)begin_ns; (void)end_ns; }
void hal_wave_read(void *board, uint32_t at, uint8_t n, int16_t *counts) { (void)board; (void)at; (void)n; counts[0] = 0; }
void hal_wave_forget(void *board, bool what) { (void)board; (void)what; }
void hal_persist(void *board, const struct edm_persistent *words) { (void)board; line = words->nonce_count; }

void _start(void) {
    edm_create(&c, NULL, &identity, NULL);
    edm_start(&c, RESET_CAUSE_POWER_ON);
    edm_tick_begin(&c);
    for (;;) {
        uint8_t byte = line;
        c.readings.pulses = line;
        edm_conclude(&c, edm_tick_end(&c));
        edm_watch(&c);
        edm_receive(&c, &byte, 1);
        edm_line_read(&c);
        edm_tick_begin(&c);
    }
}
