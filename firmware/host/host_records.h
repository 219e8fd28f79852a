/* Made from edmctl/core/library.py by `python -m tools.generate`; edit those. */
#ifndef EDM_HOST_RECORDS_H
#define EDM_HOST_RECORDS_H

#include <stdint.h>

#define BOX_TICKS 2048
#define PACK 12
#define SAMPLES_BYTES 262144

struct inputs {
    int64_t estop;
    int64_t door_open;
    int64_t hv_supply_ok;
    int64_t level_ok;
    int64_t limit_switch;
    double flow_lpm;
    double temperature_c;
    double monitor_v;
};
_Static_assert(sizeof(struct inputs) == 64, "inputs");

struct seen {
    int64_t tick;
    int64_t boot_tick;
    int64_t state;
    int64_t armed;
    int64_t fault;
    int64_t boot_count;
    int64_t frozen_tick;
    int64_t watchdog_ticks;
    int64_t param_crc;
    int64_t mode;
    int64_t tick_counts;
    int64_t pulse_no;
    int64_t tlm_next;
    int64_t scanning;
    double command_v;
    double displacement_um;
    double slow_displacement_um;
    double gap_v;
    int64_t rx_bad;
    int64_t rx_drop;
    int64_t rx_frames;
    int64_t urgent;
    int64_t due;
    int64_t advanced;
    int64_t advancing;
    int64_t advance_us;
    int64_t reboot_asked;
    int64_t arms;
    int64_t touch_offs;
    int64_t out_bytes;
    int64_t lost_frames;
    int64_t session;
    double zero_um;
    int64_t interlocks;
    int64_t pulses_allowed;
    int64_t pulse_period_ns;
    double duty_v;
    int64_t sensor_fitted;
    int64_t watched;
    int64_t merges;
    int64_t sample_bytes;
};
_Static_assert(sizeof(struct seen) == 328, "seen");

struct merged {
    int64_t counter;
    int64_t t0_us;
    int64_t period_us;
    int64_t samples;
    int64_t dropped;
    int64_t frames;
};
_Static_assert(sizeof(struct merged) == 48, "merged");

struct kept {
    int64_t fault;
    int64_t event_no;
    int64_t boot_count;
    int64_t boot_tick;
    int64_t since_tick;
    int64_t frozen;
    int64_t frozen_tick;
    int64_t frozen_boot_tick;
    int64_t flags;
    int64_t waves_frozen;
    int64_t waves_empty;
    int64_t waves_begin_ns;
    int64_t waves_end_ns;
    int64_t waves_boot_ns;
    double displacement_um[2048];
    double actuator_v[2048];
    double gap_v[2048];
    double charge_uc[2048];
    double opens[2048];
    double normals[2048];
    double arcs[2048];
    double shorts[2048];
    double states[2048];
    double all_flags[2048];
};
_Static_assert(sizeof(struct kept) == 163952, "kept");

/* Of each class in Python the size. */
#define HOST_RECORDS "Inputs 64 Seen 328 Merged 48 Kept 163952"

#endif
