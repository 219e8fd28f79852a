/* Made from plant_records.py in edmctl/simulator by `python -m tools.generate`; edit those. */
#ifndef EDM_PLANT_RECORDS_H
#define EDM_PLANT_RECORDS_H

#include <stdint.h>

#define MOST_PULSES 64
#define PATH_LINES 16
#define TABLE 1024
#define PLAYS 40
#define CREEP_TERMS 12
#define BURNING 256
#define SCOPE_PULSES 64
#define STUCK_AT_GENERATOR 1
#define STUCK_AT_CONTACT 2

struct unit {
    double tool_area_um2;
    double per_tool_area;
    double per_disc_area;
    double annulus_area_um2;
    double per_rim_um;
    double work_factor;
    double tool_factor;
    double work_um3_per_uj[256];
    double tool_um3_per_uj[256];
    double threshold_uj;
    double per_redeposition;
    double arc_work;
    double arc_tool;
    double deionisation_us[256];
    double deionisation_debris;
    double deionisation_after_arc;
    double longest_memory_us;
    double discharge_v;
    double arc_plateau_v;
    double short_plateau_v;
    double tau_reference_us;
    double gap_exponent;
    double formative_us;
    double roughness_um;
    double debris_gap_factor;
    double flush_time_s;
    double working_gap_um;
    double free_gap_um;
    double per_flush_depth;
    double arc_base;
    double arc_debris;
    double arc_delay_us;
    double arc_pause;
    double bridge_base;
    double particle_um;
    double bridge_clear;
    double side_base;
    double side_debris;
    double open_v;
    double on_time_us;
    double off_time_us;
    double discharge_set_us;
    double siemens;
    double nominal_siemens;
    double per_open_gap;
    int64_t pulse_period_ns;
    double amplifier_decay;
    double envelope_um;
    double envelope_centre_um;
    double envelope_steepness;
    double actuator_zero_um;
    double mode_a11;
    double mode_a12;
    double mode_a21;
    double mode_a22;
    double play_threshold_v[40];
    double play_um_per_v[40];
    double creep_decay[12];
    double creep_share[12];
    double contact_compliance;
    double contact_sd_um;
    double sensor_gain;
    double sensor_bend_um;
    double sensor_drift_um_s;
    double sensor_noise_um;
    double sensor_walk_um;
    double machine_drift_um_s;
    double monitor_gain;
    double monitor_zero_v;
    double amplifier_gain;
    double stroke_share;
    double gap_stuck_v;
    double gap_closed_um;
    double off_time_a;
    int64_t stray_pulses;
    int64_t dac_open;
    int64_t contact_inverted;
    int64_t contact_open;
    double sensor_wire;
    double gap_wire;
    int64_t gate_stuck;
    int64_t gate_open;
    int64_t mode_stuck;
    int64_t supply_off;
    double battery_v;
};
_Static_assert(sizeof(struct unit) == 7600, "unit");

struct plant {
    double amplifier_v;
    double play_sum_um;
    double mode_velocity_um_s;
    double free_z_um;
    double true_z_um;
    double play_v[40];
    double creep_um[12];
    double surface_um;
    double machine_um;
    double depth_um;
    double wear_um;
    double per_hole_area;
    double rarity;
    double next_level_um;
    int64_t level_at;
    double asperity_um;
    double debris_um3;
    double clearing;
    double tick_clearing;
    double bridge_until_um;
    double carbon;
    int64_t true_arc_run;
    double opening_um;
    double previous_burning;
    double previous_arc;
    double wall_um;
    double crater_um3;
    double crater_um6;
    double arc_um3;
    double crater_depth_um;
    int64_t next_pulse_ns;
    int64_t pulse_starts;
    int64_t contact_tests;
    double walk_um;
    double stage_error_x_um;
    double stage_error_y_um;
    double stage_way_um;
    double line_error_x_um[16];
    double line_error_y_um[16];
    int64_t random_at;
    int64_t noise_at;
};
_Static_assert(sizeof(struct plant) == 968, "plant");

struct scope {
    int64_t at;
    double start_ns[64];
    double delay_us[64];
    double discharge_us[64];
    double plateau_v[64];
    double siemens[64];
    double leak_a[64];
    double stuck_v[64];
};
_Static_assert(sizeof(struct scope) == 3592, "scope");

struct drive {
    double actuator_v;
    int64_t pulses_on;
    int64_t generator;
    int64_t pulse_starts;
    int64_t contact_tests;
    double stage_x_um;
    double stage_y_um;
    int64_t stage_moves;
    int64_t stage_line;
    int64_t stage_lines_done;
    double stage_share;
    double stage_way_um;
};
_Static_assert(sizeof(struct drive) == 96, "drive");

struct readings {
    int64_t tick;
    double sensor_um;
    int64_t contact;
    double monitor_v;
    double gap_v;
    double charge_uc;
    double generator_siemens;
    double off_time_a;
    int64_t stray_pulses;
    int64_t first_pulse_ns;
    int64_t pulses;
    double delay_us[64];
    double discharge_us[64];
    double plateau_v[64];
    double energy_uj[64];
};
_Static_assert(sizeof(struct readings) == 2136, "readings");

struct machine {
    const struct unit *unit;
    struct plant *plant;
    struct scope *scope;
    struct drive *drive;
    struct readings *readings;
    const double *decide;
    const double *shape;
    const double *delay;
    const double *noise;
    const double *half_normal;
    const double *lognormal;
    const double *level_um;
    const double *level_share;
    const double *level_rarity;
};
_Static_assert(sizeof(struct machine) == 112, "machine");

struct cells {
    int64_t size;
    double thickness_um;
    double *cells;
    double *effective;
    double *weights;
    double *under;
};
_Static_assert(sizeof(struct cells) == 48, "cells");

/* Of each class in Python the size. */
#define PLANT_RECORDS "Unit 7600 PlantState 968 Scope 3592 Drive 96 Readings 2136 Machine 112 Cells 48"

#endif
