/* Made from edmlink1.toml and faults.toml by `python -m tools.generate`; edit those files. */
/* EDM Link 1.5: every payload that a controller reads or writes. Scaled fields are `real`, in the
 * unit of their name; the comment says what one count of the wire is. */
#ifndef EDM_GEN_EDMLINK_H
#define EDM_GEN_EDMLINK_H

#include "../core/wire.h"

#define PROTO_MAJOR 1
#define PROTO_MINOR 5
#define SCHEMA_HASH 0x55BBB4D4u
#define MAX_PAYLOAD 246
#define REPLY_BIT 0x40

/* State of the controller. */
enum {
    STATE_BOOT = 0,
    STATE_IDLE = 1,
    STATE_ARMED = 2,
    STATE_APPROACH = 3,
    STATE_MACHINING = 4,
    STATE_JUMP = 5,
    STATE_TOUCH = 6,
    STATE_MOVING = 7,
    STATE_FAULT = 8,
    STATE_ESTOP = 9,
};

/* Status byte of a reply. */
enum {
    STATUS_OK = 0,
    STATUS_BUSY = 1,
    STATUS_BAD_STATE = 2,
    STATUS_UNKNOWN_TYPE = 3,
    STATUS_BAD_LENGTH = 4,
    STATUS_OUT_OF_RANGE = 5,
    STATUS_NOT_CALIBRATED = 6,
    STATUS_INTERLOCK = 7,
    STATUS_PROFILE_MISMATCH = 8,
    STATUS_RATE_TOO_HIGH = 9,
    STATUS_BAD_SESSION = 10,
    STATUS_VERSION = 11,
    STATUS_NO_CONTACT = 12,
    STATUS_INTERNAL = 255,
};

/* Class of one pulse, judged by the controller from ignition delay and plateau voltage. */
enum {
    PULSE_CLASS_OPEN = 0,
    PULSE_CLASS_NORMAL = 1,
    PULSE_CLASS_ARC = 2,
    PULSE_CLASS_SHORT = 3,
};

/* Stage axis; linear targets are nm, the rotary target is millidegrees. */
enum {
    AXIS_X = 0,
    AXIS_Y = 1,
    AXIS_THETA = 2,
};

/* Law of the gap servo. */
enum {
    SERVO_LAW_RELAY = 0,
    SERVO_LAW_PI = 1,
};

/* Isofrequency: fixed on-time. Isopulse: fixed discharge time after ignition. */
enum {
    PULSE_MODE_ISOFREQUENCY = 0,
    PULSE_MODE_ISOPULSE = 1,
};

/* What TLM_START sends of the pulses. */
enum {
    PULSE_LOG_OFF = 0,
    PULSE_LOG_BLOCKS = 1,
    PULSE_LOG_FULL = 2,
};

/* Code of an EVENT. */
enum {
    EVENT_CODE_MOVE_DONE = 1,
    EVENT_CODE_STAGE_DONE = 2,
    EVENT_CODE_APPROACH_DONE = 3,
    EVENT_CODE_CUT_DONE = 4,
    EVENT_CODE_JUMP_DONE = 5,
    EVENT_CODE_TOUCH = 6,
    EVENT_CODE_TOUCH_DONE = 7,
    EVENT_CODE_TIME_UP = 8,
    EVENT_CODE_STOPPED = 9,
    EVENT_CODE_TEST_DONE = 10,
    EVENT_CODE_PATH_DONE = 11,
};

/* Why the controller started. */
enum {
    RESET_CAUSE_POWER_ON = 0,
    RESET_CAUSE_COMMANDED = 1,
    RESET_CAUSE_WATCHDOG = 2,
    RESET_CAUSE_BROWN_OUT = 3,
    RESET_CAUSE_EXTERNAL = 4,
};

/* What the controller's time follows: a clock as on every board, or the host's ADVANCE (simulated ones only). */
enum {
    CLOCK_RUNNING = 0,
    CLOCK_DRIVEN = 1,
};

/* Flags of a TLM sample. */
enum {
    TLM_FLAGS_PULSES_ON = 1,
    TLM_FLAGS_CONTACT = 2,
    TLM_FLAGS_ADVANCING = 4,
    TLM_FLAGS_SHORTED = 8,
    TLM_FLAGS_AT_LIMIT = 16,
    TLM_FLAGS_SLEW_LIMITED = 32,
};

/* Interlock inputs; a set bit stops the machine. */
enum {
    INTERLOCKS_ESTOP = 1,
    INTERLOCKS_DOOR = 2,
    INTERLOCKS_DIELECTRIC_LEVEL = 4,
    INTERLOCKS_DIELECTRIC_FLOW = 8,
    INTERLOCKS_DIELECTRIC_HOT = 16,
    INTERLOCKS_HV_SUPPLY = 32,
};

/* Faults that a controller detects. */
enum {
    FAULT_HOST_SILENT = 1001,  /* no new frame of the session for watchdog_s while armed; a new session while armed; an event that finds 30 others unacknowledged */
    FAULT_ABORT_RUN = 1002,  /* eight or more zero bytes in a row */
    FAULT_LINE_NOISE = 1003,  /* bad_frames frames with a bad check within 1 s while armed */
    FAULT_TRAVEL_LIMIT = 2001,  /* servo or approach wants more than piezo_max_v for 0.5 s; machining: the displacement sensor reads what no displacement is */
    FAULT_PIEZO_TRACK = 2002,  /* voltage monitor off the command by more than track_error of 150 V for track_s */
    FAULT_PIEZO_OV = 2003,  /* voltage monitor below monitor_min_v or above monitor_max_v */
    FAULT_STAGE_LIMIT = 2004,  /* limit switch closes while a stage moves */
    FAULT_NO_CONTACT = 2005,  /* touch: displacement beyond z_max_um without contact */
    FAULT_STUCK_CONTACT = 2006,  /* touch: contact reads closed before the feed, or is not open for 50 ms in a row after the back-off */
    FAULT_COLLISION = 2007,  /* contact while PIEZO_SET moves the tool towards the work */
    FAULT_SHORT_STUCK = 3001,  /* continuous short for short_stuck_s although the tool retracts */
    FAULT_ARC_BURN = 3002,  /* arc_run consecutive arcs */
    FAULT_GAP_SENSOR = 3003,  /* SELF_TEST; misread_pulses pulses in a row with a discharge at the open voltage, or with neither current nor voltage; contact closed in measure mode at a gap voltage above short_v */
    FAULT_GEN_FAULT = 3004,  /* current in the off-time or backwards, pulses although the gate is shut, or more than over_current times what the generator's resistor lets through (the peak current in a normal discharge) */
    FAULT_NO_SPARK = 3005,  /* approach: max_travel_um without a spark; machining: open_lost_um or open_lost_s of open pulses; no pulses although the generator is on */
    FAULT_MODE_SWITCH = 3006,  /* pulses seen in measure mode */
    FAULT_ESTOP = 4001,  /* emergency-stop input, in every state */
    FAULT_DOOR = 4002,  /* door input open while armed */
    FAULT_DIELECTRIC = 4003,  /* level, flow_min_lpm or temperature_max_c violated while armed */
    FAULT_HV_SUPPLY = 4004,  /* supply-good input of the high voltage open while armed */
    FAULT_RESET = 5001,  /* controller: started by its watchdog or after a brown-out; host: BOOT in mid-session */
};

/* Types of frames; that of a reply is its command's with REPLY_BIT. */
enum {
    MSG_HELLO = 0x01,
    MSG_HEARTBEAT = 0x02,
    MSG_GET_SCHEMA = 0x03,
    MSG_ADVANCE = 0x05,
    MSG_GET_STATUS = 0x04,
    MSG_ARM = 0x08,
    MSG_DISARM = 0x09,
    MSG_CLEAR_FAULT = 0x0A,
    MSG_SET_PARAM = 0x0B,
    MSG_GET_PARAM = 0x0C,
    MSG_COMMIT_PROFILE = 0x0D,
    MSG_PIEZO_SET = 0x10,
    MSG_STAGE_MOVE = 0x11,
    MSG_STAGE_STOP = 0x12,
    MSG_SET_ZERO = 0x13,
    MSG_APPROACH = 0x18,
    MSG_SERVO_START = 0x19,
    MSG_SERVO_STOP = 0x1A,
    MSG_JUMP = 0x1B,
    MSG_TOUCH_OFF = 0x1C,
    MSG_SELF_TEST = 0x1D,
    MSG_SCAN_START = 0x1E,
    MSG_PATH_MOVE = 0x1F,
    MSG_PULSE_CONFIG = 0x20,
    MSG_PULSE_ENABLE = 0x21,
    MSG_TLM_START = 0x28,
    MSG_TLM_STOP = 0x29,
    MSG_BLACKBOX_READ = 0x30,
    MSG_WAVEFORM_READ = 0x31,
    MSG_REBOOT = 0x3F,
    MSG_TLM = 0x80,
    MSG_EVENT = 0x81,
    MSG_FAULT = 0x82,
    MSG_LOG = 0x83,
    MSG_BOOT = 0x84,
    MSG_PULSE_BLOCKS = 0x85,
    MSG_PULSES = 0x86,
};

/* Opens a session. Allowed in every state; the session byte of the frame becomes the session. */
#define HELLO_SIZE 10
struct hello {
    uint8_t proto_major;  /* u8 */
    uint8_t proto_minor;  /* u8 */
    uint32_t host_nonce;  /* u32: echoed */
    uint32_t schema_hash;  /* u32: CRC-32 of the canonical schema */
};
static inline void hello_read(struct hello *m, const uint8_t *p) {
    m->proto_major = get_u8(p + 0);
    m->proto_minor = get_u8(p + 1);
    m->host_nonce = get_u32(p + 2);
    m->schema_hash = get_u32(p + 6);
}
_Static_assert(HELLO_SIZE == 10 && 10 <= MAX_PAYLOAD, "HELLO");

/* Reply to HELLO. */
#define HELLO_REPLY_SIZE 49
struct hello_reply {
    uint8_t proto_major;  /* u8 */
    uint8_t proto_minor;  /* u8 */
    uint32_t host_nonce;  /* u32 */
    uint32_t schema_hash;  /* u32 */
    uint8_t fw_major;  /* u8 */
    uint8_t fw_minor;  /* u8 */
    uint8_t fw_patch;  /* u8 */
    uint32_t git;  /* u32: first eight digits of the commit, 0 where unknown */
    char serial[12];  /* s12: ASCII, zero padded */
    uint16_t board;  /* u16: 0 = virtual controller */
    uint16_t servo_hz;  /* u16 Hz: ticks of the servo a second */
    uint16_t tlm_max_hz;  /* u16 Hz */
    uint8_t rx_window;  /* u8: commands that may be outstanding */
    uint32_t boot_count;  /* u32 */
    uint8_t reset_cause;  /* u8: ResetCause */
    uint16_t fault;  /* u16: latched fault, 0 = none */
    uint8_t state;  /* u8: State */
    uint8_t clock;  /* u8: Clock */
    uint32_t baud;  /* u32 Bd: of the line, 0 = the line has none */
};
static inline void hello_reply_write(uint8_t *p, const struct hello_reply *m) {
    put_u8(p + 0, m->proto_major);
    put_u8(p + 1, m->proto_minor);
    put_u32(p + 2, m->host_nonce);
    put_u32(p + 6, m->schema_hash);
    put_u8(p + 10, m->fw_major);
    put_u8(p + 11, m->fw_minor);
    put_u8(p + 12, m->fw_patch);
    put_u32(p + 13, m->git);
    put_s12(p + 17, m->serial);
    put_u16(p + 29, m->board);
    put_u16(p + 31, m->servo_hz);
    put_u16(p + 33, m->tlm_max_hz);
    put_u8(p + 35, m->rx_window);
    put_u32(p + 36, m->boot_count);
    put_u8(p + 40, m->reset_cause);
    put_u16(p + 41, m->fault);
    put_u8(p + 43, m->state);
    put_u8(p + 44, m->clock);
    put_u32(p + 45, m->baud);
}
_Static_assert(HELLO_REPLY_SIZE == 49 && 49 <= MAX_PAYLOAD, "HELLO_REPLY");

/* Feeds the watchdog if t_host_us is later than in every one before, and acknowledges events up to last_event.
 * Never retried. */
#define HEARTBEAT_SIZE 10
struct heartbeat {
    uint64_t t_host_us;  /* u64 us */
    uint16_t last_event;  /* u16 */
};
static inline void heartbeat_read(struct heartbeat *m, const uint8_t *p) {
    m->t_host_us = get_u64(p + 0);
    m->last_event = get_u16(p + 8);
}
_Static_assert(HEARTBEAT_SIZE == 10 && 10 <= MAX_PAYLOAD, "HEARTBEAT");

/* Reply to HEARTBEAT. */
#define HEARTBEAT_REPLY_SIZE 23
struct heartbeat_reply {
    uint64_t t_host_us;  /* u64 us: echoed */
    uint64_t t_dev_us;  /* u64 us: controller time */
    uint8_t state;  /* u8: State */
    uint16_t fault;  /* u16 */
    uint16_t rx_bad;  /* u16: frames dropped for a bad check, modulo 65536 */
    uint16_t rx_drop;  /* u16: frames dropped for another session or as no command, modulo 65536 */
};
static inline void heartbeat_reply_write(uint8_t *p, const struct heartbeat_reply *m) {
    put_u64(p + 0, m->t_host_us);
    put_u64(p + 8, m->t_dev_us);
    put_u8(p + 16, m->state);
    put_u16(p + 17, m->fault);
    put_u16(p + 19, m->rx_bad);
    put_u16(p + 21, m->rx_drop);
}
_Static_assert(HEARTBEAT_REPLY_SIZE == 23 && 23 <= MAX_PAYLOAD, "HEARTBEAT_REPLY");

/* Part of the canonical schema from `offset` on: JSON compressed with zlib. This layout never changes, so that
 * hosts of any version can tell what differs. */
#define GET_SCHEMA_SIZE 2
struct get_schema {
    uint16_t offset;  /* u16: bytes */
};
static inline void get_schema_read(struct get_schema *m, const uint8_t *p) {
    m->offset = get_u16(p + 0);
}
_Static_assert(GET_SCHEMA_SIZE == 2 && 2 <= MAX_PAYLOAD, "GET_SCHEMA");

/* Reply to GET_SCHEMA. */
#define GET_SCHEMA_REPLY_SIZE 3
#define GET_SCHEMA_REPLY_RECORD_SIZE 1
#define GET_SCHEMA_REPLY_MOST 243
struct get_schema_reply {
    uint16_t total;  /* u16: bytes of the whole */
    uint8_t n;  /* u8: bytes in this reply, 0 behind the end */
};
static inline void get_schema_reply_write(uint8_t *p, const struct get_schema_reply *m) {
    put_u16(p + 0, m->total);
    put_u8(p + 2, m->n);
}
_Static_assert(GET_SCHEMA_REPLY_SIZE == 3 && 3 <= MAX_PAYLOAD, "GET_SCHEMA_REPLY");

/* Lets time pass on a controller whose Clock is DRIVEN, until it has something to send that cannot wait, at
 * most timeout_us. What it has to send goes before the reply. Other controllers answer UNKNOWN_TYPE. Never
 * retried. */
#define ADVANCE_SIZE 4
struct advance {
    uint32_t timeout_us;  /* u32 us */
};
static inline void advance_read(struct advance *m, const uint8_t *p) {
    m->timeout_us = get_u32(p + 0);
}
_Static_assert(ADVANCE_SIZE == 4 && 4 <= MAX_PAYLOAD, "ADVANCE");

/* Reply to ADVANCE. */
#define ADVANCE_REPLY_SIZE 8
struct advance_reply {
    uint64_t t_dev_us;  /* u64 us: controller time */
};
static inline void advance_reply_write(uint8_t *p, const struct advance_reply *m) {
    put_u64(p + 0, m->t_dev_us);
}
_Static_assert(ADVANCE_REPLY_SIZE == 8 && 8 <= MAX_PAYLOAD, "ADVANCE_REPLY");

/* Reply to GET_STATUS. */
#define GET_STATUS_REPLY_SIZE 32
struct get_status_reply {
    uint8_t state;  /* u8: State */
    uint16_t fault;  /* u16 */
    uint16_t interlocks;  /* u16: Interlocks bits */
    real displacement_um;  /* i32 x 0.001 um: inductive sensor, + towards the work */
    real x_um;  /* i32 x 0.001 um */
    real y_um;  /* i32 x 0.001 um */
    real theta_deg;  /* i32 x 0.001 deg */
    real actuator_v;  /* u16 x 0.0025 V */
    real gap_v;  /* u16 x 0.005 V: filtered mean gap voltage */
    real temperature_c;  /* i16 x 0.1 degC: dielectric */
    real flow_lpm;  /* u16 x 0.01 L/min: dielectric */
    real monitor_v;  /* i16 x 0.01 V: voltage monitor of the actuator's amplifier */
    uint8_t flags;  /* u8: TlmFlags */
};
static inline void get_status_reply_write(uint8_t *p, const struct get_status_reply *m) {
    put_u8(p + 0, m->state);
    put_u16(p + 1, m->fault);
    put_u16(p + 3, m->interlocks);
    put_i32(p + 5, counts_i32(m->displacement_um * 1000));
    put_i32(p + 9, counts_i32(m->x_um * 1000));
    put_i32(p + 13, counts_i32(m->y_um * 1000));
    put_i32(p + 17, counts_i32(m->theta_deg * 1000));
    put_u16(p + 21, counts_u16(m->actuator_v * 400));
    put_u16(p + 23, counts_u16(m->gap_v * 200));
    put_i16(p + 25, counts_i16(m->temperature_c * 10));
    put_u16(p + 27, counts_u16(m->flow_lpm * 100));
    put_i16(p + 29, counts_i16(m->monitor_v * 100));
    put_u8(p + 31, m->flags);
}
_Static_assert(GET_STATUS_REPLY_SIZE == 32 && 32 <= MAX_PAYLOAD, "GET_STATUS_REPLY");

/* IDLE to ARMED: starts the watchdog. Refused unless param_crc equals that of the committed parameters and
 * every interlock is closed. */
#define ARM_SIZE 4
struct arm {
    uint32_t param_crc;  /* u32 */
};
static inline void arm_read(struct arm *m, const uint8_t *p) {
    m->param_crc = get_u32(p + 0);
}
_Static_assert(ARM_SIZE == 4 && 4 <= MAX_PAYLOAD, "ARM");

/* Leaves FAULT for IDLE; must name the latched code. BUSY until the retreat has ended, and while more than 30
 * events wait. */
#define CLEAR_FAULT_SIZE 2
struct clear_fault {
    uint16_t fault;  /* u16 */
};
static inline void clear_fault_read(struct clear_fault *m, const uint8_t *p) {
    m->fault = get_u16(p + 0);
}
_Static_assert(CLEAR_FAULT_SIZE == 2 && 2 <= MAX_PAYLOAD, "CLEAR_FAULT");

/* Stages one parameter. IDLE only. */
#define SET_PARAM_SIZE 6
struct set_param {
    uint16_t param;  /* u16 */
    int32_t value;  /* i32: in the parameter's own unit */
};
static inline void set_param_read(struct set_param *m, const uint8_t *p) {
    m->param = get_u16(p + 0);
    m->value = get_i32(p + 2);
}
_Static_assert(SET_PARAM_SIZE == 6 && 6 <= MAX_PAYLOAD, "SET_PARAM");

/* Reads one parameter. */
#define GET_PARAM_SIZE 2
struct get_param {
    uint16_t param;  /* u16 */
};
static inline void get_param_read(struct get_param *m, const uint8_t *p) {
    m->param = get_u16(p + 0);
}
_Static_assert(GET_PARAM_SIZE == 2 && 2 <= MAX_PAYLOAD, "GET_PARAM");

/* Reply to GET_PARAM. */
#define GET_PARAM_REPLY_SIZE 4
struct get_param_reply {
    int32_t value;  /* i32 */
};
static inline void get_param_reply_write(uint8_t *p, const struct get_param_reply *m) {
    put_i32(p + 0, m->value);
}
_Static_assert(GET_PARAM_REPLY_SIZE == 4 && 4 <= MAX_PAYLOAD, "GET_PARAM_REPLY");

/* Makes the staged parameters current if the CRC-32 over all parameters (id u16, value i32, ascending id)
 * agrees. */
#define COMMIT_PROFILE_SIZE 4
struct commit_profile {
    uint32_t crc;  /* u32 */
};
static inline void commit_profile_read(struct commit_profile *m, const uint8_t *p) {
    m->crc = get_u32(p + 0);
}
_Static_assert(COMMIT_PROFILE_SIZE == 4 && 4 <= MAX_PAYLOAD, "COMMIT_PROFILE");

/* Ramps the actuator. ARMED only; ends with MOVE_DONE. */
#define PIEZO_SET_SIZE 6
struct piezo_set {
    real actuator_v;  /* u16 x 0.0025 V */
    real slew_v_s;  /* u32 x 0.001 V/s */
};
static inline void piezo_set_read(struct piezo_set *m, const uint8_t *p) {
    m->actuator_v = (real)get_u16(p + 0) / 400;
    m->slew_v_s = (real)get_u32(p + 2) / 1000;
}
_Static_assert(PIEZO_SET_SIZE == 6 && 6 <= MAX_PAYLOAD, "PIEZO_SET");

/* Absolute stage move. ARMED only, tool retracted below safe_z_um; ends with STAGE_DONE. */
#define STAGE_MOVE_SIZE 9
struct stage_move {
    uint8_t axis;  /* u8: Axis */
    int32_t target;  /* i32: nm, or millidegrees for THETA */
    uint32_t speed;  /* u32: nm/s, or millidegrees/s */
};
static inline void stage_move_read(struct stage_move *m, const uint8_t *p) {
    m->axis = get_u8(p + 0);
    m->target = get_i32(p + 1);
    m->speed = get_u32(p + 5);
}
_Static_assert(STAGE_MOVE_SIZE == 9 && 9 <= MAX_PAYLOAD, "STAGE_MOVE");

/* From now until the next ARM safe_z_um counts from this displacement, which is where the host takes the tool's
 * home at 0 V to be. ARMED with the actuator at rest at 0 V; OUT_OF_RANGE where the controller's own reading is
 * more than 5 um below or 25 um above. */
#define SET_ZERO_SIZE 4
struct set_zero {
    real zero_um;  /* i32 x 0.001 um */
};
static inline void set_zero_read(struct set_zero *m, const uint8_t *p) {
    m->zero_um = (real)get_i32(p + 0) / 1000;
}
_Static_assert(SET_ZERO_SIZE == 4 && 4 <= MAX_PAYLOAD, "SET_ZERO");

/* Pulses on, actuator advances until the filtered mean gap voltage falls to gap_ref_v. Ends with APPROACH_DONE,
 * pulses off, tool held. */
#define APPROACH_SIZE 10
struct approach {
    real speed_um_s;  /* u32 x 0.001 um/s */
    real max_travel_um;  /* u32 x 0.001 um: further without a spark: fault 3005 */
    real gap_ref_v;  /* u16 x 0.005 V */
};
static inline void approach_read(struct approach *m, const uint8_t *p) {
    m->speed_um_s = (real)get_u32(p + 0) / 1000;
    m->max_travel_um = (real)get_u32(p + 4) / 1000;
    m->gap_ref_v = (real)get_u16(p + 8) / 200;
}
_Static_assert(APPROACH_SIZE == 10 && 10 <= MAX_PAYLOAD, "APPROACH");

/* Gap servo until the filtered displacement reaches z_limit_um (CUT_DONE) or max_time_s passes (TIME_UP); then
 * pulses off, tool held. */
#define SERVO_START_SIZE 10
struct servo_start {
    real gap_ref_v;  /* u16 x 0.005 V */
    real z_limit_um;  /* i32 x 0.001 um */
    real max_time_s;  /* u32 x 0.001 s */
};
static inline void servo_start_read(struct servo_start *m, const uint8_t *p) {
    m->gap_ref_v = (real)get_u16(p + 0) / 200;
    m->z_limit_um = (real)get_i32(p + 2) / 1000;
    m->max_time_s = (real)get_u32(p + 6) / 1000;
}
_Static_assert(SERVO_START_SIZE == 10 && 10 <= MAX_PAYLOAD, "SERVO_START");

/* Pulses off, retract by height, dwell, return to clearance above the start point, then the servo goes on.
 * MACHINING (or ARMED, without a servo). Ends with JUMP_DONE. Lengths and speed are volts by gain_um_per_v: a
 * host with an actuator model sends the volts of the jump it wants times that gain. */
#define JUMP_SIZE 14
struct jump {
    real height_um;  /* u32 x 0.001 um */
    real speed_um_s;  /* u32 x 0.001 um/s */
    real dwell_s;  /* u16 x 0.001 s */
    real clearance_um;  /* u32 x 0.001 um */
};
static inline void jump_read(struct jump *m, const uint8_t *p) {
    m->height_um = (real)get_u32(p + 0) / 1000;
    m->speed_um_s = (real)get_u32(p + 4) / 1000;
    m->dwell_s = (real)get_u16(p + 8) / 1000;
    m->clearance_um = (real)get_u32(p + 10) / 1000;
}
_Static_assert(JUMP_SIZE == 14 && 14 <= MAX_PAYLOAD, "JUMP");

/* Measure mode. Fast to fast_to_um, then slow until contact; on contact the slope flips and the tool hunts for
 * dwell_s; n touches with a back-off between. One TOUCH event each, then TOUCH_DONE and a retract by back-off. */
#define TOUCH_OFF_SIZE 23
struct touch_off {
    real fast_um_s;  /* u32 x 0.001 um/s */
    real fast_to_um;  /* i32 x 0.001 um: displacement where the fast leg ends */
    real speed_um_s;  /* u32 x 0.001 um/s */
    real z_max_um;  /* i32 x 0.001 um: no contact up to here: fault 2005 */
    real back_off_um;  /* u32 x 0.001 um */
    real dwell_s;  /* u16 x 0.001 s */
    uint8_t touches;  /* u8 */
};
static inline void touch_off_read(struct touch_off *m, const uint8_t *p) {
    m->fast_um_s = (real)get_u32(p + 0) / 1000;
    m->fast_to_um = (real)get_i32(p + 4) / 1000;
    m->speed_um_s = (real)get_u32(p + 8) / 1000;
    m->z_max_um = (real)get_i32(p + 12) / 1000;
    m->back_off_um = (real)get_u32(p + 16) / 1000;
    m->dwell_s = (real)get_u16(p + 20) / 1000;
    m->touches = get_u8(p + 22);
}
_Static_assert(TOUCH_OFF_SIZE == 23 && 23 <= MAX_PAYLOAD, "TOUCH_OFF");

/* Gap servo as in SERVO_START, but a tool that reaches z_limit_um is held there and the cut goes on, while the
 * stages follow the lines of PATH_MOVE. Ends after the line marked last (PATH_DONE) or when max_time_s passes
 * (TIME_UP); then pulses off, tool held. */
#define SCAN_START_SIZE 10
struct scan_start {
    real gap_ref_v;  /* u16 x 0.005 V */
    real z_limit_um;  /* i32 x 0.001 um */
    real max_time_s;  /* u32 x 0.001 s */
};
static inline void scan_start_read(struct scan_start *m, const uint8_t *p) {
    m->gap_ref_v = (real)get_u16(p + 0) / 200;
    m->z_limit_um = (real)get_i32(p + 2) / 1000;
    m->max_time_s = (real)get_u32(p + 6) / 1000;
}
_Static_assert(SCAN_START_SIZE == 10 && 10 <= MAX_PAYLOAD, "SCAN_START");

/* Appends a straight line of the X and Y stages together, from where the line before it ends, to a queue of 16;
 * BUSY when the queue is full. MACHINING after SCAN_START only, and not after the line marked last. On the way
 * the limit of the scan goes linearly to z_limit_um. The stages stand still while the gap is shorted or a JUMP
 * runs. */
#define PATH_MOVE_SIZE 17
struct path_move {
    real x_um;  /* i32 x 0.001 um: end of the line */
    real y_um;  /* i32 x 0.001 um */
    real speed_um_s;  /* u32 x 0.001 um/s: along the line */
    real z_limit_um;  /* i32 x 0.001 um: limit of the displacement at its end */
    uint8_t last;  /* u8: 1: the scan ends with this line */
};
static inline void path_move_read(struct path_move *m, const uint8_t *p) {
    m->x_um = (real)get_i32(p + 0) / 1000;
    m->y_um = (real)get_i32(p + 4) / 1000;
    m->speed_um_s = (real)get_u32(p + 8) / 1000;
    m->z_limit_um = (real)get_i32(p + 12) / 1000;
    m->last = get_u8(p + 16);
}
_Static_assert(PATH_MOVE_SIZE == 17 && 17 <= MAX_PAYLOAD, "PATH_MOVE");

/* Sets the generator. Pulses must be off. OUT_OF_RANGE for a period below 20 us or above 1 s, and for what the
 * generator cannot do. */
#define PULSE_CONFIG_SIZE 17
struct pulse_config {
    real on_time_us;  /* u32 x 0.001 us */
    real off_time_us;  /* u32 x 0.001 us */
    real open_voltage_v;  /* u16 x 0.005 V */
    real peak_current_a;  /* u16 x 0.001 A */
    uint8_t mode;  /* u8: PulseMode */
    real discharge_us;  /* u32 x 0.001 us: ISOPULSE only, and not 0 there */
};
static inline void pulse_config_read(struct pulse_config *m, const uint8_t *p) {
    m->on_time_us = (real)get_u32(p + 0) / 1000;
    m->off_time_us = (real)get_u32(p + 4) / 1000;
    m->open_voltage_v = (real)get_u16(p + 8) / 200;
    m->peak_current_a = (real)get_u16(p + 10) / 1000;
    m->mode = get_u8(p + 12);
    m->discharge_us = (real)get_u32(p + 13) / 1000;
}
_Static_assert(PULSE_CONFIG_SIZE == 17 && 17 <= MAX_PAYLOAD, "PULSE_CONFIG");

/* Permits pulses. They flow in APPROACH and MACHINING only. DISARM, faults and resets end the permission, the
 * end of a cut does not. */
#define PULSE_ENABLE_SIZE 1
struct pulse_enable {
    uint8_t on;  /* u8 */
};
static inline void pulse_enable_read(struct pulse_enable *m, const uint8_t *p) {
    m->on = get_u8(p + 0);
}
_Static_assert(PULSE_ENABLE_SIZE == 1 && 1 <= MAX_PAYLOAD, "PULSE_ENABLE");

/* Starts telemetry; refused with RATE_TOO_HIGH where the line cannot carry it, OUT_OF_RANGE where a period
 * holds more than 255 pulses. */
#define TLM_START_SIZE 4
struct tlm_start {
    uint16_t period_us;  /* u16 us */
    uint8_t batch;  /* u8: samples per frame, 1..14 */
    uint8_t pulse_log;  /* u8: PulseLog */
};
static inline void tlm_start_read(struct tlm_start *m, const uint8_t *p) {
    m->period_us = get_u16(p + 0);
    m->batch = get_u8(p + 2);
    m->pulse_log = get_u8(p + 3);
}
_Static_assert(TLM_START_SIZE == 4 && 4 <= MAX_PAYLOAD, "TLM_START");

/* Servo samples of every millisecond up to the latched fault, frozen by it, oldest first. Without a fault: up
 * to now. Samples are those of TLM. CLEAR_FAULT begins anew. */
#define BLACKBOX_READ_SIZE 2
struct blackbox_read {
    uint16_t offset;  /* u16: samples */
};
static inline void blackbox_read_read(struct blackbox_read *m, const uint8_t *p) {
    m->offset = get_u16(p + 0);
}
_Static_assert(BLACKBOX_READ_SIZE == 2 && 2 <= MAX_PAYLOAD, "BLACKBOX_READ");

/* Reply to BLACKBOX_READ. */
#define BLACKBOX_READ_REPLY_SIZE 7
#define BLACKBOX_READ_REPLY_RECORD_SIZE 16
#define BLACKBOX_READ_REPLY_MOST 14
struct blackbox_read_reply {
    uint16_t total;  /* u16: samples held, at most 2048; 500 at least after 0.5 s */
    uint32_t t0_us;  /* u32 us: time of the first sample of this reply, modulo 2^32 */
    uint8_t n;  /* u8: samples in this reply, 0 behind the end */
};
static inline void blackbox_read_reply_write(uint8_t *p, const struct blackbox_read_reply *m) {
    put_u16(p + 0, m->total);
    put_u32(p + 2, m->t0_us);
    put_u8(p + 6, m->n);
}
_Static_assert(BLACKBOX_READ_REPLY_SIZE == 7 && 7 <= MAX_PAYLOAD, "BLACKBOX_READ_REPLY");

/* One record of BLACKBOX_READ_REPLY. */
#define BLACKBOX_READ_REPLY_RECORD_SIZE 16
struct blackbox_read_reply_record {
    int32_t displacement_um;  /* i32 x 0.001 um: inductive sensor */
    uint16_t actuator_v;  /* u16 x 0.0025 V: voltage applied */
    uint16_t gap_v;  /* u16 x 0.005 V: filtered mean gap voltage */
    uint16_t current_a;  /* u16 x 0.001 A: mean gap current over the millisecond */
    uint8_t n_normal;  /* u8 */
    uint8_t n_arc;  /* u8 */
    uint8_t n_short;  /* u8 */
    uint8_t n_open;  /* u8 */
    uint8_t state;  /* u8: State */
    uint8_t flags;  /* u8: TlmFlags */
};
static inline void blackbox_read_reply_record_write(uint8_t *p, const struct blackbox_read_reply_record *m) {
    put_i32(p + 0, m->displacement_um);
    put_u16(p + 4, m->actuator_v);
    put_u16(p + 6, m->gap_v);
    put_u16(p + 8, m->current_a);
    put_u8(p + 10, m->n_normal);
    put_u8(p + 11, m->n_arc);
    put_u8(p + 12, m->n_short);
    put_u8(p + 13, m->n_open);
    put_u8(p + 14, m->state);
    put_u8(p + 15, m->flags);
}
_Static_assert(BLACKBOX_READ_REPLY_RECORD_SIZE == 16 && 16 <= MAX_PAYLOAD, "BLACKBOX_READ_REPLY_RECORD");

/* Gap voltage and gap current about the latched fault, sample by sample, oldest first: from up to 64 pulses
 * before it to 16 pulse periods after it. BUSY until those have passed. A memory that is shorter holds less, a
 * fifth of it after the fault. total is 0 without a fault, where no pulse came shortly before it, and from
 * controllers that keep no waveforms. */
#define WAVEFORM_READ_SIZE 4
struct waveform_read {
    uint32_t offset;  /* u32: samples */
};
static inline void waveform_read_read(struct waveform_read *m, const uint8_t *p) {
    m->offset = get_u32(p + 0);
}
_Static_assert(WAVEFORM_READ_SIZE == 4 && 4 <= MAX_PAYLOAD, "WAVEFORM_READ");

/* Reply to WAVEFORM_READ. */
#define WAVEFORM_READ_REPLY_SIZE 13
#define WAVEFORM_READ_REPLY_RECORD_SIZE 4
#define WAVEFORM_READ_REPLY_MOST 58
struct waveform_read_reply {
    uint32_t total;  /* u32: samples held */
    uint32_t t0_us;  /* u32 us: time of sample 0, modulo 2^32 */
    uint32_t period_ns;  /* u32 ns: from one sample to the next, at most 1000 */
    uint8_t n;  /* u8: samples in this reply, at most 58, 0 behind the end */
};
static inline void waveform_read_reply_write(uint8_t *p, const struct waveform_read_reply *m) {
    put_u32(p + 0, m->total);
    put_u32(p + 4, m->t0_us);
    put_u32(p + 8, m->period_ns);
    put_u8(p + 12, m->n);
}
_Static_assert(WAVEFORM_READ_REPLY_SIZE == 13 && 13 <= MAX_PAYLOAD, "WAVEFORM_READ_REPLY");

/* One record of WAVEFORM_READ_REPLY. */
#define WAVEFORM_READ_REPLY_RECORD_SIZE 4
struct waveform_read_reply_record {
    int16_t gap_v;  /* i16 x 0.01 V */
    int16_t current_a;  /* i16 x 0.001 A */
};
static inline void waveform_read_reply_record_write(uint8_t *p, const struct waveform_read_reply_record *m) {
    put_i16(p + 0, m->gap_v);
    put_i16(p + 2, m->current_a);
}
_Static_assert(WAVEFORM_READ_REPLY_RECORD_SIZE == 4 && 4 <= MAX_PAYLOAD, "WAVEFORM_READ_REPLY_RECORD");

/* Restarts the controller as a reset does, after the reply; BOOT follows. Refused while armed. */
#define REBOOT_SIZE 4
struct reboot {
    uint32_t magic;  /* u32: 0x0B007EDB */
};
static inline void reboot_read(struct reboot *m, const uint8_t *p) {
    m->magic = get_u32(p + 0);
}
_Static_assert(REBOOT_SIZE == 4 && 4 <= MAX_PAYLOAD, "REBOOT");

/* Servo samples. counter counts frames, so gaps are exact. */
#define TLM_SIZE 10
#define TLM_RECORD_SIZE 16
#define TLM_MOST 14
struct tlm {
    uint16_t counter;  /* u16 */
    uint32_t t0_us;  /* u32 us: time of the first sample, modulo 2^32 */
    uint16_t period_us;  /* u16 us */
    uint8_t n;  /* u8 */
    uint8_t dropped;  /* u8 */
};
static inline void tlm_write(uint8_t *p, const struct tlm *m) {
    put_u16(p + 0, m->counter);
    put_u32(p + 2, m->t0_us);
    put_u16(p + 6, m->period_us);
    put_u8(p + 8, m->n);
    put_u8(p + 9, m->dropped);
}
_Static_assert(TLM_SIZE == 10 && 10 <= MAX_PAYLOAD, "TLM");

/* One record of TLM. */
#define TLM_RECORD_SIZE 16
struct tlm_record {
    int32_t displacement_um;  /* i32 x 0.001 um: inductive sensor */
    uint16_t actuator_v;  /* u16 x 0.0025 V: voltage applied */
    uint16_t gap_v;  /* u16 x 0.005 V: filtered mean gap voltage */
    uint16_t current_a;  /* u16 x 0.001 A: mean gap current over the period */
    uint8_t n_normal;  /* u8 */
    uint8_t n_arc;  /* u8 */
    uint8_t n_short;  /* u8 */
    uint8_t n_open;  /* u8 */
    uint8_t state;  /* u8: State */
    uint8_t flags;  /* u8: TlmFlags */
};
static inline void tlm_record_write(uint8_t *p, const struct tlm_record *m) {
    put_i32(p + 0, m->displacement_um);
    put_u16(p + 4, m->actuator_v);
    put_u16(p + 6, m->gap_v);
    put_u16(p + 8, m->current_a);
    put_u8(p + 10, m->n_normal);
    put_u8(p + 11, m->n_arc);
    put_u8(p + 12, m->n_short);
    put_u8(p + 13, m->n_open);
    put_u8(p + 14, m->state);
    put_u8(p + 15, m->flags);
}
_Static_assert(TLM_RECORD_SIZE == 16 && 16 <= MAX_PAYLOAD, "TLM_RECORD");
static inline void tlm_read(struct tlm *m, const uint8_t *p) {
    m->counter = get_u16(p + 0);
    m->t0_us = get_u32(p + 2);
    m->period_us = get_u16(p + 6);
    m->n = get_u8(p + 8);
    m->dropped = get_u8(p + 9);
}
_Static_assert(TLM_SIZE == 10 && 10 <= MAX_PAYLOAD, "TLM");

/* Repeated until acknowledged by HEARTBEAT.last_event. */
#define EVENT_SIZE 18
struct event {
    uint16_t event_no;  /* u16 */
    uint32_t t_us;  /* u32 us: modulo 2^32 */
    uint16_t code;  /* u16: EventCode */
    int32_t arg;  /* i32: TOUCH: number of the touch; TEST_DONE: mean gap voltage with the generator on, mV; otherwise 0 */
    real displacement_um;  /* i32 x 0.001 um: TOUCH: mean of the sensor while hunting; otherwise the sensor now */
    real actuator_v;  /* u16 x 0.0025 V: TOUCH: peak command at first contact */
};
static inline void event_write(uint8_t *p, const struct event *m) {
    put_u16(p + 0, m->event_no);
    put_u32(p + 2, m->t_us);
    put_u16(p + 6, m->code);
    put_i32(p + 8, m->arg);
    put_i32(p + 12, counts_i32(m->displacement_um * 1000));
    put_u16(p + 16, counts_u16(m->actuator_v * 400));
}
_Static_assert(EVENT_SIZE == 18 && 18 <= MAX_PAYLOAD, "EVENT");

/* Repeated until acknowledged by HEARTBEAT.last_event. */
#define FAULT_SIZE 18
struct fault {
    uint16_t event_no;  /* u16 */
    uint32_t t_us;  /* u32 us */
    uint16_t code;  /* u16: of the table of faults */
    int32_t detail;  /* i32: as the page says */
    real displacement_um;  /* i32 x 0.001 um */
    real gap_v;  /* u16 x 0.005 V */
};
static inline void fault_write(uint8_t *p, const struct fault *m) {
    put_u16(p + 0, m->event_no);
    put_u32(p + 2, m->t_us);
    put_u16(p + 6, m->code);
    put_i32(p + 8, m->detail);
    put_i32(p + 12, counts_i32(m->displacement_um * 1000));
    put_u16(p + 16, counts_u16(m->gap_v * 200));
}
_Static_assert(FAULT_SIZE == 18 && 18 <= MAX_PAYLOAD, "FAULT");

/* Sent once after a reset; every session is gone. */
#define BOOT_SIZE 5
struct boot {
    uint8_t reset_cause;  /* u8: ResetCause */
    uint32_t boot_count;  /* u32 */
};
static inline void boot_write(uint8_t *p, const struct boot *m) {
    put_u8(p + 0, m->reset_cause);
    put_u32(p + 1, m->boot_count);
}
_Static_assert(BOOT_SIZE == 5 && 5 <= MAX_PAYLOAD, "BOOT");

/* Sums over blocks of block_pulses pulses. */
#define PULSE_BLOCKS_SIZE 16
#define PULSE_BLOCKS_RECORD_SIZE 12
#define PULSE_BLOCKS_MOST 19
struct pulse_blocks {
    uint16_t counter;  /* u16 */
    uint32_t pulse_no;  /* u32: number of the first pulse */
    uint32_t t0_us;  /* u32 us: time of the first pulse, modulo 2^32 */
    uint32_t period_ns;  /* u32 ns: pulse period */
    uint8_t block_pulses;  /* u8 */
    uint8_t n;  /* u8: blocks */
};
static inline void pulse_blocks_write(uint8_t *p, const struct pulse_blocks *m) {
    put_u16(p + 0, m->counter);
    put_u32(p + 2, m->pulse_no);
    put_u32(p + 6, m->t0_us);
    put_u32(p + 10, m->period_ns);
    put_u8(p + 14, m->block_pulses);
    put_u8(p + 15, m->n);
}
_Static_assert(PULSE_BLOCKS_SIZE == 16 && 16 <= MAX_PAYLOAD, "PULSE_BLOCKS");

/* One record of PULSE_BLOCKS. */
#define PULSE_BLOCKS_RECORD_SIZE 12
struct pulse_blocks_record {
    uint8_t n_open;  /* u8 */
    uint8_t n_normal;  /* u8 */
    uint8_t n_arc;  /* u8 */
    uint8_t n_short;  /* u8 */
    uint32_t delay_us;  /* u32 x 0.1 us: sum of the ignition delays */
    uint32_t energy_uj;  /* u32 x 0.1 uJ: sum of the discharge energies */
};
static inline void pulse_blocks_record_write(uint8_t *p, const struct pulse_blocks_record *m) {
    put_u8(p + 0, m->n_open);
    put_u8(p + 1, m->n_normal);
    put_u8(p + 2, m->n_arc);
    put_u8(p + 3, m->n_short);
    put_u32(p + 4, m->delay_us);
    put_u32(p + 8, m->energy_uj);
}
_Static_assert(PULSE_BLOCKS_RECORD_SIZE == 12 && 12 <= MAX_PAYLOAD, "PULSE_BLOCKS_RECORD");

/* Every pulse. */
#define PULSES_SIZE 15
#define PULSES_RECORD_SIZE 6
#define PULSES_MOST 38
struct pulses {
    uint16_t counter;  /* u16 */
    uint32_t pulse_no;  /* u32: number of the first pulse */
    uint32_t t0_us;  /* u32 us: time of the first pulse, modulo 2^32 */
    uint32_t period_ns;  /* u32 ns: pulse period */
    uint8_t n;  /* u8 */
};
static inline void pulses_write(uint8_t *p, const struct pulses *m) {
    put_u16(p + 0, m->counter);
    put_u32(p + 2, m->pulse_no);
    put_u32(p + 6, m->t0_us);
    put_u32(p + 10, m->period_ns);
    put_u8(p + 14, m->n);
}
_Static_assert(PULSES_SIZE == 15 && 15 <= MAX_PAYLOAD, "PULSES");

/* One record of PULSES. */
#define PULSES_RECORD_SIZE 6
struct pulses_record {
    uint8_t pulse_class;  /* u8: PulseClass */
    uint16_t delay_us;  /* u16 x 0.1 us: ignition delay; the on-time when open */
    uint16_t discharge_us;  /* u16 x 0.1 us: discharge time; 0 when open */
    uint8_t plateau_v;  /* u8 x 0.5 V: plateau voltage; the open voltage when open */
};
static inline void pulses_record_write(uint8_t *p, const struct pulses_record *m) {
    put_u8(p + 0, m->pulse_class);
    put_u16(p + 1, m->delay_us);
    put_u16(p + 3, m->discharge_us);
    put_u8(p + 5, m->plateau_v);
}
_Static_assert(PULSES_RECORD_SIZE == 6 && 6 <= MAX_PAYLOAD, "PULSES_RECORD");

/* One parameter of the table: value in its unit = wire integer / divisor. */
struct edm_param {
    uint16_t id;
    int32_t divisor;
    int32_t default_wire;
    int32_t least;
    int32_t most;
};

/* Rows of the table, in ascending order of id. */
enum {
    PARAM_PIEZO_MAX_V,  /* V, soft limit of the command */
    PARAM_SLEW_LIMIT_V_S,  /* V/s, limit of every ramp */
    PARAM_GAIN_UM_PER_V,  /* um/V, turns commanded um/s into V/s */
    PARAM_SAFE_Z_UM,  /* um, stages may move below this displacement, counted from the zero of SET_ZERO */
    PARAM_RETRACT_V_S,  /* V/s, ramp to 0 V on disarm and on any fault */
    PARAM_SENSOR_FITTED,  /* 0: no displacement sensor; every displacement is gain_um_per_v x volts applied */
    PARAM_SERVO_LAW,  /* ServoLaw */
    PARAM_FORWARD_UM_S,  /* um/s, + slope */
    PARAM_BACK_UM_S,  /* um/s, - slope */
    PARAM_SHORT_BACK_UM_S,  /* um/s, - slope while shorted */
    PARAM_FILTER_HZ,  /* Hz, low-pass of the mean gap voltage */
    PARAM_HYSTERESIS,  /* of duty x open voltage */
    PARAM_KP_UM_S,  /* um/s, PI: per unit of normalised voltage */
    PARAM_KI_UM_S2,  /* um/s2, PI */
    PARAM_SERVO_PERIOD_US,  /* us, period of the servo decision */
    PARAM_SERVO_LATENCY,  /* decisions of latency */
    PARAM_SHORT_V,  /* V, plateau below: SHORT */
    PARAM_ARC_V,  /* V, plateau below, with a delay under arc_delay_us: ARC */
    PARAM_ARC_DELAY_US,  /* us */
    PARAM_BLOCK_PULSES,  /* pulses per PULSE_BLOCKS record */
    PARAM_SHORT_STUCK_S,  /* s, continuous short: fault 3001 */
    PARAM_ARC_RUN,  /* consecutive arcs: fault 3002 */
    PARAM_OPEN_LOST_UM,  /* um, advance in all-open beyond the last spark: fault 3005 */
    PARAM_OPEN_LOST_S,  /* s, time in all-open beyond the last spark: fault 3005 */
    PARAM_WATCHDOG_S,  /* s, host silent while armed: fault 1001 */
    PARAM_DIELECTRIC_REQUIRED,  /* 0 or 1 */
    PARAM_FLOW_MIN_LPM,  /* L/min */
    PARAM_TEMPERATURE_MAX_C,  /* degC */
    PARAM_MONITOR_MIN_V,  /* V, voltage monitor below: fault 2003 */
    PARAM_MONITOR_MAX_V,  /* V, voltage monitor above: fault 2003 */
    PARAM_TRACK_ERROR,  /* of 150 V: voltage monitor off the command by more for track_s: fault 2002 */
    PARAM_TRACK_S,  /* s */
    PARAM_MISREAD_PULSES,  /* consecutive discharges at the open voltage: fault 3003 */
    PARAM_OVER_CURRENT,  /* of the peak current set, or any current in the off-time: fault 3004 */
    PARAM_BAD_FRAMES,  /* frames with a bad check within 1 s while armed: fault 1003 */
    PARAM_TEST_ERROR,  /* SELF_TEST: of duty x open voltage */
    PARAMS,
};

extern const struct edm_param edm_params[PARAMS];

/* The canonical schema, compressed by zlib, as GET_SCHEMA hands it out. */
#define SCHEMA_BYTES 2507
extern const uint8_t edm_schema[SCHEMA_BYTES];

/* Payload bytes of a command; -1 for a type that is none. */
int edm_request_size(uint8_t type);

#endif
