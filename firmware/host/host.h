/* The core as a shared library: one controller in the caller's memory, over records laid out as
 * edmctl/simulator/plant_interface.py and edmctl/firmware/library.py declare them. */
#ifndef EDM_HOST_H
#define EDM_HOST_H

#include "../edm.h"

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

#define OUT_BYTES (256 * 1024)

/* plant_interface.Drive */
struct host_drive {
    double actuator_v;
    int64_t pulses_on, generator, pulse_starts, contact_tests;
    double stage_x_um, stage_y_um;
    int64_t stage_moves, stage_line, stage_lines_done;
    double stage_share, stage_way_um;
};

/* plant_interface.Readings */
struct host_readings {
    int64_t tick;
    double sensor_um;
    int64_t contact;
    double monitor_v, gap_v, charge_uc, generator_siemens, off_time_a;
    int64_t stray_pulses, first_pulse_ns, pulses;
    double delay_us[EDM_MOST_PULSES], discharge_us[EDM_MOST_PULSES], plateau_v[EDM_MOST_PULSES],
        energy_uj[EDM_MOST_PULSES];
};

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
    struct host_drive *drive;
    const struct host_readings *readings;
    struct host_callbacks callbacks;
    uint8_t last_samples[FRAME_MOST]; /* the newest TLM frame */
    uint8_t out[OUT_BYTES];
};

#endif
