/* What a board supplies. `board` is its own; the core hands back what edm_create was given.
 *
 * Once a millisecond a board fills `edm_readings`, calls edm_tick_end, edm_conclude, edm_watch, edm_receive,
 * edm_line_read and edm_tick_begin (edm.h; docs/firmware.md says how), and puts out what then stands in `edm_drive`.
 * Everything else goes through these functions. None may block, and none may call the core.
 */
#ifndef EDM_HAL_H
#define EDM_HAL_H

#include <stddef.h>

#include "core/limits.h"
#include "core/real.h"

/* What the controller tells the machine for the millisecond that comes. */
struct edm_drive {
    real actuator_v;         /* V, on the converter's grid */
    uint8_t pulses_on;       /* the gate of the generator */
    uint8_t stage_moves;     /* 1: a scan moves the stages in this millisecond */
    uint8_t stage_line;      /* row of the queue on whose line they began it */
    uint8_t stage_lines_done; /* lines that they came to the end of */
    uint32_t pulse_starts;   /* so often the gate was opened: with another one the period begins anew */
    uint32_t contact_tests;  /* so often the contact circuit was set for another touch after the first one */
    real stage_um[2];        /* X and Y of the path, where the stages are to be */
    real stage_share;        /* share that they went of what was left of the last line */
    real stage_way_um;       /* way that they went */
};

/* What the machine shows of the millisecond that ended. A reading that has failed is NaN, never an old or a likely value:
 * the core then takes what is safe. A pulse is told once and whole, however long it is: in the millisecond in which its
 * on-time ends, or in that in which it begins; until then its discharge is in no count. Charge may be told as it flows. */
struct edm_readings {
    real sensor_um;          /* displacement sensor */
    real monitor_v;          /* voltage monitor of the actuator's amplifier */
    real gap_v;              /* mean gap voltage over the periods of the pulses, off-times included; without pulses that of
                              * the gap, NaN where none is measured */
    real charge_uc;          /* that went through the gap; less than nothing by 2 µC or more is a sensor turned round */
    real generator_siemens;  /* in a discharge, current over (open voltage - gap voltage); 0 without one */
    real off_time_a;         /* current that goes on into the off-time; 0 for noise */
    uint8_t contact;         /* 1: the contact circuit is closed; counts in ARMED, MOVING and TOUCH */
    uint8_t stray_pulses;    /* that the gate lets through although it is shut: 3004, in a touch 3006 */
    uint8_t pulses;          /* entries of the series below; with the gate shut none, unless some come all the same */
    int64_t first_pulse_ns;  /* begin of the first one; the millisecond began at (tick of the controller) x 1 000 000 */
    real delay_us[EDM_MOST_PULSES];     /* ignition delay; the on-time when open */
    real discharge_us[EDM_MOST_PULSES]; /* time of current; 0: none */
    real plateau_v[EDM_MOST_PULSES];    /* gap voltage of the discharge, or of the open gap */
    real energy_uj[EDM_MOST_PULSES];    /* of the discharge */
};

/* Inputs and slow readings, as they are now. A reading that has failed is NaN: what it guards is then forbidden. */
struct edm_inputs {
    bool estop;              /* pressed */
    bool door_open;
    bool hv_supply_ok;
    bool level_ok;           /* of the dielectric */
    bool limit_switch;       /* of a stage, closed */
    bool stage_moves;        /* one is still on its way: the limit switch counts, nothing is armed; false where nothing tells it */
    real flow_lpm;           /* of the dielectric */
    real temperature_c;      /* of the dielectric */
    real monitor_v;          /* of the actuator's amplifier */
};

/* Setting of the pulse generator, as PULSE_CONFIG tells it. */
struct edm_generator {
    real on_time_us;
    real off_time_us;
    real open_v;
    real peak_a;
    real discharge_us;       /* isopulse; 0: isofrequency */
};

/* Words that outlast a reset, with a check: nonces need not outlast the supply, all others shall (battery-backed registers,
 * or a memory that takes a write for every event). */
struct edm_persistent {
    uint32_t boot_count;
    uint16_t fault;          /* latched */
    uint16_t event_no;       /* last one given */
    uint32_t nonces[EDM_NONCES]; /* of HELLOs of former sessions, oldest first */
    uint32_t present_nonce;  /* of the present session */
    uint8_t nonce_count;
    uint8_t has_session;
};

/* Sends whole frames; a line that cannot take them loses them whole. */
void hal_send(void *board, const uint8_t *frame, size_t size);
/* Reads inputs and slow readings. */
void hal_inputs(void *board, struct edm_inputs *inputs);
/* Puts the gate of the generator; off within 10 µs, from any function of edm.h. On comes from edm_tick_begin alone: between
 * that and what asked for it, in which edm_drive says so already, inputs, watchdog, readings or the line may forbid it. */
void hal_gate(void *board, bool on);
/* Sets the generator; returns the conductance of what limits its current, S: peak current over (open voltage - gap voltage)
 * in a normal discharge. */
real hal_set_generator(void *board, const struct edm_generator *setting);
/* The greatest speed of an axis, µm/s or degrees/s: commands above it are refused. Infinite where there is none. */
real hal_stage_speed_max(void *board, uint8_t axis);
/* Where an axis stands, µm or degrees, once the steps that cannot be taken back are made. `at` is where the core has it: a
 * board returns that very number where the axis stands as near to it as its steps allow, or where nothing tells it. */
real hal_stage_place(void *board, uint8_t axis, real at);
/* Lets an axis travel to a target (µm; degrees for THETA) at a speed (µm/s, degrees/s). */
void hal_stage_start(void *board, uint8_t axis, real target, real speed);
/* The axis has arrived, or shall stop at once: by its speed it is at `at`. Where it stands hal_stage_place then tells. */
void hal_stage_stop(void *board, uint8_t axis, real at);
/* The stages are about to follow a path, from where they stand. */
void hal_path_begin(void *board);
/* A line was put into a row of the queue. */
void hal_path_line(void *board, uint8_t row);
/* The stages stop following at once, wherever edm_drive says: it may be a fault. */
void hal_path_end(void *board);
/* Samples of the gap, 1 µs apart, that there is a ring for; 0: none are taken. */
uint32_t hal_wave_memory(void *board);
/* Keeps the samples of the gap from the begin of a pulse to an end after now, ns on the clock of `tick`. Called as well
 * where there is nothing to keep: begin is now then, and they are not read. */
void hal_wave_keep(void *board, int64_t begin_ns, int64_t end_ns);
/* Reads kept samples: gap voltage and current as counts of the wire, by turns. A board without any keeps no record. */
void hal_wave_read(void *board, uint32_t offset, uint8_t samples, int16_t *counts);
/* Forgets what was kept, or else what the ring holds: samples before now are of another setting. */
void hal_wave_forget(void *board, bool kept);
/* Words that outlast a reset have changed. With every event, fault and session; in a fault before anything is sent. */
void hal_persist(void *board, const struct edm_persistent *words);

#endif
