/* The controller in the caller's memory, over the records of the plant and those that edmctl/core/library.py declares. */
#ifndef EDM_HOST_H
#define EDM_HOST_H

#include "../edm.h"
#include "../plant/plant.h"

#define OUT_BYTES (256 * 1024)

/* library.Inputs: written by the caller before edm_host_receive, edm_host_watch and edm_host_create. */
struct host_inputs {
    int64_t estop, door_open, hv_supply_ok, level_ok, limit_switch;
    double flow_lpm, temperature_c, monitor_v;
};

/* library.Seen: what stands in the controller, renewed by every call but those of the tick. */
struct host_seen {
    int64_t tick, boot_tick, state, armed, fault, boot_count, frozen_tick, watchdog_ticks, param_crc;
    int64_t mode, tick_counts, pulse_no, tlm_next, scanning;
    double command_v, displacement_um, slow_displacement_um, gap_v;
    int64_t rx_bad, rx_drop, rx_frames, urgent, due, advanced, advancing, advance_us, reboot_asked;
    int64_t arms, touch_offs, out_bytes, lost_frames;
};

/* library.Callbacks: what only the machine's model can do; none is called within a tick. */
struct host_callbacks {
    double (*set_generator)(double on_us, double off_us, double open_v, double peak_a, double discharge_us);
    void (*stage_stop)(int64_t axis, double at);
    void (*path_begin)(void);
    void (*path_line)(int64_t row);
    void (*path_end)(void);
    int64_t (*wave_memory)(void);
    void (*wave_keep)(void);
    void (*wave_forget)(int64_t kept);
    void (*wave_read)(int64_t offset, int64_t samples, int16_t *counts);
};

struct edm_host {
    struct edm_controller core;
    struct host_inputs inputs;
    struct host_seen seen;
    struct drive *drive;
    const struct readings *readings;
    struct host_callbacks callbacks;
    uint8_t last_samples[FRAME_MOST]; /* the newest TLM frame */
    uint8_t out[OUT_BYTES];
};

void edm_host_begin(struct edm_host *h);
int64_t edm_host_end(struct edm_host *h);

#endif
