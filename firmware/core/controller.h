/* The state of one controller: all that the core knows stands in `struct edm_controller`. */
#ifndef EDM_CONTROLLER_H
#define EDM_CONTROLLER_H

#include "../gen/edmlink.h"
#include "../hal.h"

#define FRAME_MOST 257 /* bytes on the line: two zeros, COBS of 254 */
#define FRAME_ENCODED_MOST 255
#define EVENT_FRAME 29
#define NEVER INT64_MAX
#define HISTORY 64 /* servo decisions remembered, for latency */
#define SCOPE_PULSES 64 /* pulses before a fault that waveforms show */
#define BAD_FRAMES_MOST 1000 /* greatest value of the parameter bad_frames */

/* What moves. */
enum edm_mode {
    HOLD,
    RAMP,
    APPROACH,
    SERVO,
    JUMP_UP,
    JUMP_DWELL,
    JUMP_DOWN,
    JUMP_RETURN,
    TOUCH_FAST,
    TOUCH_SLOW,
    TOUCH_HUNT,
    TOUCH_BACK,
    TEST_OFF,
    TEST_ON,
};

/* What happened in a tick; a number from 1000 on is the fault of that code. */
enum edm_happened {
    NOTHING,
    RAMP_DONE,
    SPARK_FOUND,
    CUT_DONE,
    TIME_UP,
    JUMP_RESUMED,
    JUMP_IS_DONE,
    TOUCHED,
    TOUCHES_DONE,
    TESTED,
    PATH_IS_DONE,
};

/* Pulses by class. */
struct edm_counts {
    uint16_t of[4];
};

/* What the board says of itself in HELLO, and how it counts. */
struct edm_identity {
    char serial[12];     /* ASCII, filled up with zeros */
    uint16_t board;      /* kind of board; 0 is the virtual controller, and a host then takes the machine for simulated */
    uint32_t baud;       /* of the line, 0: it has none (USB) */
    bool driven;         /* its clock follows ADVANCE: simulated controllers only */
    real host_time_scale; /* controller seconds per second of the host: 1 but for simulated controllers */
};

/* frame.c: bytes of the line. */
struct edm_receiver {
    uint8_t buffer[FRAME_ENCODED_MOST];
    uint16_t filled;     /* one more than fits: too long */
    uint8_t zeros;       /* in a row, up to an abort run */
    uint32_t bad;        /* rx_bad */
};

struct edm_frame {
    uint8_t type, seq, session, flags, size;
    const uint8_t *payload;
};

/* delivery.c, session.c */
struct edm_reply {
    uint8_t status, size;
    uint8_t payload[MAX_PAYLOAD];
};

struct edm_kept_reply {
    uint8_t type, seq;
    uint16_t size;
    uint8_t frame[FRAME_MOST];
};

struct edm_link {
    uint8_t session;     /* 0: none */
    uint8_t hello[HELLO_SIZE]; /* that opened it */
    uint8_t welcome[HELLO_REPLY_SIZE]; /* what it was answered */
    bool has_newest;
    uint8_t newest;      /* seq of the newest command carried out */
    bool has_beat;
    uint64_t newest_beat_us;
    struct edm_kept_reply replies[EDM_REPLIES];
    uint8_t reply_count, reply_at; /* a ring: the oldest stands at reply_at when it is full */
    uint32_t drop;       /* rx_drop */
    uint32_t frames;     /* commands that came whole */
    bool urgent;         /* somebody waits for what is sent; answers to heartbeats may wait for company */
    bool due;            /* driven clock: to be sent now, without the next ADVANCE */
    bool advanced;       /* an ADVANCE of the session has come */
    bool advancing;      /* one waits for its answer */
    bool advance_came;   /* in this call of edm_receive */
    uint8_t advance_seq, advance_session, advance_status;
    uint32_t advance_us;
    bool reboot_asked;
    struct edm_reply reply; /* being made */
};

/* events.c */
struct edm_kept_event {
    uint16_t number;
    uint8_t frame[EVENT_FRAME];
};

struct edm_events {
    struct edm_kept_event kept[EDM_EVENTS]; /* oldest first */
    uint8_t count;
    int64_t repeat_tick;
};

/* parameters.c: wire integers, and what the tick makes of them (units as their names). */
struct edm_parameters {
    int32_t current[PARAMS];
    int32_t staged[PARAMS];
    uint32_t crc;
};

struct edm_settings {
    real piezo_max_v, slew_limit_v_s, v_per_um, safe_z_um, retract_v_s;
    bool sensor_missing; /* displacements are the mean gain times the voltage applied */
    real forward_um_s, back_um_s, short_back_um_s, hysteresis, kp_um_s, ki_um_s2;
    real filter_alpha;   /* low-pass of the gap voltage */
    real displacement_alpha; /* and of the displacement */
    int32_t law, servo_ticks, latency_decisions;
    real short_v, arc_v, arc_delay_us;
    int32_t block_size;
    real open_lost_um;
    int64_t short_ticks_max, open_ticks_max;
    int32_t arc_run_max, misreads_max;
    int32_t watchdog_ticks;
    bool dielectric_required;
    real flow_min_lpm, temperature_max_c;
    real monitor_min_v, monitor_max_v, track_v, over_current, test_error;
    int32_t track_ticks_max, bad_frames;
    /* of the generator */
    real open_v, duty_v, per_duty_v, nominal_siemens;
    int32_t pulse_period_ns;
};

/* motion.c: the command of the actuator and the phases of a motion. */
struct edm_motion {
    enum edm_mode mode;
    int64_t phase;       /* ticks since the mode began */
    int64_t phase_ticks, dwell_ticks;
    real command_v, target_v, ramp_v_s, fast_v_s, slow_v_s;
    real rest_v;         /* of the command */
    real start_z_um, z_max_um;
    int32_t limit_ticks; /* beyond piezo_max_v */
    bool slewed;
    bool feeds;          /* a ramp towards the work */
    bool gate_open;      /* as hal_gate was told; drive.pulses_on may be ahead of it until the millisecond begins */
};

/* stages.c: the way of a single axis. */
struct edm_stages {
    real at[3];          /* X and Y in µm, THETA in degrees, as they were last told to be */
    bool travels;
    uint8_t axis;
    real start, target;
    int64_t start_tick, travel_ticks;
};

/* gap.c, pulses.c: what was measured and judged. */
struct edm_gap {
    real displacement_um;
    real slow_displacement_um; /* low-passed */
    real gap_v;          /* low-passed mean gap voltage */
    real tick_gap_v;     /* of the last millisecond */
    struct edm_counts tick; /* pulses of the last millisecond */
    bool shorted;
    uint32_t silent_ticks; /* since the last pulse */
    uint32_t stray_ticks; /* in a row with pulses although the gate is shut */
    uint32_t sparkless_ticks; /* since the last millisecond with sparks, while pulses are on */
    int64_t short_ticks, open_ticks;
    int32_t arc_run, misreads;
    real last_spark_um;
    uint32_t pulse_no;
};

/* servo.c */
struct edm_servo {
    real gap_ref_v, rate_v_s, integral_um_s;
    int32_t direction;
    uint32_t count;      /* decisions */
    real history[HISTORY]; /* normalised gap voltages, a ring */
    real z_limit_um;
    int64_t time_ticks;  /* left */
};

/* jump.c */
struct edm_jump {
    real start_v, jump_v, clearance_v;
    bool resumes;
};

/* touch.c and self_test.c share the mean of a dwell. */
struct edm_touch {
    real fast_to_um, back_v, peak_v, sum;
    real rest;           /* of the sum: what float has rounded away so far, as everything that is called so */
    int64_t count;
    int32_t number, left;
    int32_t open_ticks;  /* at rest after a back-off, in a row without contact */
    real test_off_v;
};

/* scan.c: the queue of lines is a ring. */
struct edm_line {
    real x_um, y_um, speed_um_s, z_um;
    bool last;
};

struct edm_scan {
    bool scanning, path_ends;
    bool follows;        /* the stages were handed over to the path */
    uint8_t at, count;
    struct edm_line lines[EDM_PATH_LINES];
    real rest_um[3];     /* of X, Y and the limit: what float has rounded away so far */
};

/* guards.c */
struct edm_guards {
    int32_t track_ticks; /* in a row with the voltage off its command */
    int64_t track_at;
    uint32_t bad_seen;   /* of rx_bad */
    uint16_t bad_count, bad_at; /* a ring of when frames were bad, up to a second ago */
    int64_t bad_ticks[BAD_FRAMES_MOST];
};

/* telemetry.c */
struct edm_telemetry {
    int64_t next;        /* tick at whose end the next sample is due; -1: none */
    int32_t ticks;       /* period */
    uint8_t batch, log;  /* PulseLog */
    bool contact;        /* in a millisecond of the running sample */
    uint16_t counter, pulse_counter;
    uint32_t dropped;    /* samples, before the next frame */
    int32_t pending;     /* samples */
    uint8_t samples[EDM_PENDING_SAMPLES][TLM_RECORD_SIZE];
    real charge_uc;      /* of the running sample */
    struct edm_counts counts; /* of its pulses */
    int32_t log_pending; /* records of pulses or blocks */
    uint8_t records[EDM_PENDING_PULSES * PULSE_BLOCKS_RECORD_SIZE]; /* without gaps; blocks are the longer ones */
    uint32_t log_pulse_no; /* of the first record */
    int64_t log_t0_ns;
    int32_t block_pulses; /* in the block begun */
    struct edm_counts block_counts;
    real block_delay_us, block_energy_uj;
};

/* telemetry.c: what a sample is written from. */
struct edm_sample {
    real displacement_um, actuator_v, gap_v, charge_uc;
    uint8_t counts[4];   /* pulses by class, 255 at most */
    uint8_t state, flags;
    uint16_t check;      /* blackbox.c; it takes no room that was not there */
};

/* blackbox.c: a ring that a fault freezes; the samples are written when they are read. */
struct edm_black_box {
    struct edm_sample ring[EDM_BOX_SAMPLES];
    int64_t since_tick;  /* what lies before it is not of this record */
    bool frozen;
    int64_t frozen_tick, frozen_boot_tick;
    uint8_t newest_flags; /* TlmFlags */
};

/* waveforms.c */
struct edm_waveforms {
    int64_t start_ns[SCOPE_PULSES]; /* of the newest pulses, a ring */
    uint8_t at, count;
    bool frozen;
    bool empty;          /* no pulse came shortly before the fault */
    int64_t begin_ns, end_ns, boot_ns;
};

struct edm_controller {
    void *board;
    struct edm_identity identity;
    struct edm_drive drive;
    struct edm_readings readings;
    struct edm_persistent keeps;
    int64_t tick;        /* milliseconds on the clock of edm_start */
    int64_t boot_tick;   /* when the controller started */
    int64_t heard_tick;  /* when the host was last heard */
    uint8_t state;       /* State */
    uint8_t reset_cause; /* ResetCause */
    bool armed, disarming, pulses_allowed;
    real zero_um;        /* safe_z_um counts from it (SET_ZERO) */
    uint32_t arms, touch_offs; /* begun so far */
    struct edm_receiver receiver;
    struct edm_link link;
    struct edm_events events;
    struct edm_parameters parameters;
    struct edm_settings settings;
    struct edm_motion motion;
    struct edm_stages stages;
    struct edm_gap gap;
    struct edm_servo servo;
    struct edm_jump jump;
    struct edm_touch touch;
    struct edm_scan scan;
    struct edm_guards guards;
    struct edm_telemetry telemetry;
    struct edm_black_box box;
    struct edm_waveforms waveforms;
};

#endif
