/* What a board may do to the core, or find: readings that have failed, a dead generator, words that did not last, aborts at
 * any byte, hosts one after the other. `hostile` tries the cases below; `hostile SEED STEPS ODDS` does random work in which
 * now and then one kind of reading fails for a while, one reading of ODDS. What has to hold is looked at after every byte and every millisecond. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core.h"

#define HOLDS(what) holds((what) != 0, #what, __LINE__)

static struct edm_controller c;
static struct edm_inputs inputs;
static struct edm_persistent kept;
static uint64_t state, beat;
static bool gate, may_open;
static uint8_t seq, session;
static uint32_t nonce;
static int broken;
static enum { SENSOR, MONITOR, GAP, DELAY, DISCHARGE, PLATEAU, ENERGY, CHARGE, CONDUCTANCE, OFF_TIME, FLOW, HEAT, KINDS } fails = KINDS;
static uint32_t odds; /* of that kind one reading of so many has failed; 0: none, and no frame meets an abort */

static uint32_t draw(uint32_t below) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)((state >> 33) % below);
}

static void holds(bool what, const char *words, int line) {
    if (!what && broken++ < 5) {
        printf("line %d, %lld ms, state %d, fault %d, %g V, gate %d: not %s\n", line, (long long)c.tick, c.state,
               c.keeps.fault, (double)c.motion.command_v, gate, words);
    }
}

static uint64_t heard = 0xCBF29CE484222325u; /* digest of all frames, FNV-1a */
void hal_send(void *board, const uint8_t *frame, size_t size) {
    (void)board;
    for (size_t i = 0; i < size; i++) heard = (heard ^ frame[i]) * 0x100000001B3u;
    if (frame[2] == MSG_FAULT && c.tick < c.events.repeat_tick) { /* for the first time */
        HOLDS(!gate && kept.fault == c.keeps.fault && kept.fault != 0);
    }
}
void hal_inputs(void *board, struct edm_inputs *now) { (void)board; *now = inputs; }
void hal_gate(void *board, bool on) {
    (void)board;
    HOLDS(!on || (may_open && c.keeps.fault == 0));
    gate = on;
}
real hal_set_generator(void *board, const struct edm_generator *setting) { (void)board; return setting->peak_a / 20; }
real hal_stage_speed_max(void *board, uint8_t axis) { (void)board; (void)axis; return R(1e30); }
real hal_stage_place(void *board, uint8_t axis, real at) { (void)board; (void)axis; return at; }
void hal_stage_start(void *board, uint8_t axis, real at, real speed) { (void)board; (void)axis; (void)at; (void)speed; }
void hal_stage_stop(void *board, uint8_t axis, real at) { (void)board; (void)axis; (void)at; }
void hal_path_begin(void *board) { (void)board; }
void hal_path_line(void *board, uint8_t row) { (void)board; (void)row; }
void hal_path_end(void *board) { (void)board; }
uint32_t hal_wave_memory(void *board) { (void)board; return 40000; }
void hal_wave_keep(void *board, int64_t begin_ns, int64_t end_ns) { (void)board; HOLDS(begin_ns <= end_ns); }
void hal_wave_read(void *board, uint32_t offset, uint8_t samples, int16_t *counts) {
    (void)board; (void)offset;
    memset(counts, 0, (size_t)samples * 4);
}
void hal_wave_forget(void *board, bool what) { (void)board; (void)what; }
void hal_persist(void *board, const struct edm_persistent *words) { (void)board; kept = *words; }

static void look(void) {
    HOLDS(!gate || c.drive.pulses_on);
    if (gate) {
        HOLDS(c.armed && c.pulses_allowed && c.link.session != 0 && c.keeps.fault == 0);
        HOLDS(c.state == STATE_APPROACH || c.state == STATE_MACHINING || c.state == STATE_JUMP);
        HOLDS(c.motion.mode != HOLD && c.motion.mode != RAMP);
    }
    HOLDS((c.keeps.fault != 0) == (c.state == STATE_FAULT || c.state == STATE_ESTOP));
    HOLDS(isfinite(c.gap.slow_displacement_um) && isfinite(c.gap.gap_v));
}

static real any(int kind, real usual) {
    static const real odd[] = {0, -1, R(1e-9), R(1e6), R(-1e6), R(1e30), R(-1e30), NAN, INFINITY, -INFINITY};
    return kind != (int)fails || draw(odds) ? usual : odd[draw(10)];
}

/* Readings of a machine that goes well, but for what `any` does to them. */
static void readings(int pulses) {
    struct edm_readings *r = &c.readings;
    memset(r, 0, sizeof *r);
    r->sensor_um = any(SENSOR, 3 * c.drive.actuator_v);
    r->monitor_v = any(MONITOR, c.drive.actuator_v);
    r->gap_v = c.drive.pulses_on ? any(GAP, 10) : R(NAN);
    r->pulses = c.drive.pulses_on ? (uint8_t)pulses : 0;
    r->first_pulse_ns = c.tick * TICK_NS;
    for (int i = 0; i < r->pulses && i < EDM_MOST_PULSES; i++) {
        bool open = i % 3 == 0;
        r->delay_us[i] = any(DELAY, 50);
        r->discharge_us[i] = any(DISCHARGE, open ? 0 : 80);
        r->plateau_v[i] = any(PLATEAU, open ? 40 : 25);
        r->energy_uj[i] = any(ENERGY, 240);
    }
    r->charge_uc = any(CHARGE, r->pulses ? 1 : 0);
    r->generator_siemens = any(CONDUCTANCE, c.settings.nominal_siemens);
    r->off_time_a = any(OFF_TIME, 0);
}

static void begin(void) {
    real before = c.motion.command_v;
    may_open = true;
    edm_tick_begin(&c);
    may_open = false;
    HOLDS(gate == (c.drive.pulses_on != 0));
    HOLDS(magnitude(c.motion.command_v - before) <= c.settings.slew_limit_v_s * TICK_S + R(1e-4));
    HOLDS(c.motion.command_v >= 0 && c.motion.command_v <= most(before, c.settings.piezo_max_v));
    HOLDS(c.drive.actuator_v >= 0 && c.drive.actuator_v <= 150);
    HOLDS(c.keeps.fault == 0 || c.motion.command_v <= before);
}

static int end(void) {
    int happened = edm_tick_end(&c);
    edm_conclude(&c, happened);
    HOLDS(happened < 1000 || !gate);
    edm_watch(&c);
    look();
    return happened;
}

static void send(uint8_t type, const uint8_t *payload, size_t size) {
    uint8_t frame[FRAME_MOST], zero = 0;
    size_t total = frame_encode(frame, type, ++seq, session, 0, payload, size);
    size_t abort_at = odds == 0 || draw(400) ? total : draw((uint32_t)total);
    for (size_t i = 0; i < total; i++) {
        for (int k = 0; k < 8 && i == abort_at; k++) {
            edm_receive(&c, &zero, 1);
        }
        HOLDS(i != abort_at || !gate);
        edm_receive(&c, frame + i, 1);
        look();
    }
    edm_line_read(&c);
}

static void greet(void) {
    uint8_t p[HELLO_SIZE] = {PROTO_MAJOR, PROTO_MINOR};
    put_u32(p + 2, ++nonce);
    put_u32(p + 6, SCHEMA_HASH);
    session = (uint8_t)(1 + nonce % 255);
    send(MSG_HELLO, p, sizeof p);
    HOLDS(!gate);
}

static void live(void) {
    uint8_t p[HEARTBEAT_SIZE];
    put_u64(p, ++beat);
    put_u16(p + 8, c.keeps.event_no);
    send(MSG_HEARTBEAT, p, sizeof p);
}

static void run(int ms, int pulses) {
    while (ms-- > 0) {
        begin();
        readings(pulses);
        end();
        if (ms % 50 == 0) live();
    }
}

static void start(uint8_t cause) {
    edm_start(&c, cause);
    HOLDS(!gate);
    greet();
}

static const struct edm_identity identity = {.serial = "HOSTILE", .host_time_scale = 1};

static void set_up_after(uint8_t cause, const struct edm_persistent *words, real monitor_v) {
    gate = true; /* as a reset may have left it */
    inputs = (struct edm_inputs){.hv_supply_ok = true, .level_ok = true, .flow_lpm = 1, .temperature_c = 20,
                                 .monitor_v = monitor_v};
    edm_create(&c, NULL, &identity, words);
    HOLDS(!gate);
    start(cause);
}

static void set_up(const struct edm_persistent *words, real monitor_v) {
    set_up_after(RESET_CAUSE_POWER_ON, words, monitor_v);
}

static void stage_parameter(int row, int32_t value) {
    uint8_t p[6];
    uint32_t crc = 0;
    put_u16(p, edm_params[row].id);
    put_i32(p + 2, value);
    send(MSG_SET_PARAM, p, 6);
    for (int k = 0; k < PARAMS; k++) {
        put_u16(p, edm_params[k].id);
        put_i32(p + 2, c.parameters.staged[k]);
        crc = frame_crc(crc, p, 6);
    }
    put_u32(p, crc);
    send(MSG_COMMIT_PROFILE, p, 4);
}

static void arm(void) {
    uint8_t p[4];
    put_u32(p, c.parameters.crc);
    send(MSG_ARM, p, 4);
    p[0] = 1;
    send(MSG_PULSE_ENABLE, p, 1);
}

/* Makes all pulses of the millisecond open ones, told by a sensor of that gain. */
static void all_open(real gain) {
    for (int i = 0; i < c.readings.pulses; i++) {
        c.readings.discharge_us[i] = 0;
        c.readings.plateau_v[i] = gain * c.settings.open_v;
    }
    c.readings.charge_uc = 0;
    c.readings.gap_v = gain * c.settings.duty_v;
}

/* A cut (or scan) to 200 µm with the reference at 8 V. */
static void cut_as(uint8_t type) {
    uint8_t p[10];
    put_u16(p, 1600);
    put_i32(p + 2, 200000);
    put_u32(p + 6, 1000000);
    send(type, p, 10);
}

static void cut(void) {
    cut_as(MSG_SERVO_START);
}

static void cut_with(real *reading, real value, int ms, int fault) {
    set_up(NULL, 0);
    arm();
    cut();
    run(100, 3);
    HOLDS(gate && c.keeps.fault == 0);
    for (int i = 0; i < ms && gate; i++) {
        begin();
        readings(3);
        *reading = value;
        for (int k = 0; k < 3 && reading == c.readings.plateau_v; k++) reading[k] = value;
        end();
    }
    HOLDS(!gate && c.keeps.fault == fault);
    run(700, 3);
    HOLDS(c.motion.command_v <= 0 || fault == 0);
    HOLDS(magnitude(c.gap.slow_displacement_um) < 400);
}

/* A sensor that fails while the tool is out, in a scan, with the last spark, and before an approach: no stage moves, the scan
 * ends, and the way without sparks stays as short. */
static void sensor_fails_about(real value) {
    uint8_t p[10] = {0};
    set_up(NULL, 0);
    arm();
    c.motion.command_v = 100;
    run(400, 0);
    begin();
    readings(0);
    c.readings.sensor_um = value;
    end();
    put_u32(p + 5, 1000000);
    send(MSG_STAGE_MOVE, p, 9);
    HOLDS(!c.stages.travels && c.gap.slow_displacement_um > 1000);
    run(1, 0);
    HOLDS(magnitude(c.gap.slow_displacement_um - 300) < 1);
    set_up(NULL, 0);
    arm();
    cut_as(MSG_SCAN_START);
    run(100, 3);
    HOLDS(gate);
    begin();
    readings(3);
    c.readings.sensor_um = value;
    end();
    HOLDS(!gate && c.keeps.fault == FAULT_TRAVEL_LIMIT);
    for (int with_approach = 0; with_approach < 2; with_approach++) {
        set_up(NULL, 0);
        arm();
        if (with_approach) {
            run(400, 0);
        } else {
            put_u16(p, 1600);
            put_i32(p + 2, 440000);
            put_u32(p + 6, 1000000);
            send(MSG_SCAN_START, p, 10);
            run(400, 3);
        }
        if (with_approach) {
            begin();
            readings(0);
            c.readings.sensor_um = value;
            end();
            run(1, 0);
            put_u32(p, 5000);
            put_u32(p + 4, 20000);
            put_u16(p + 8, 1600);
            send(MSG_APPROACH, p, 10);
        } else { /* as in the return of a jump, which goes on */
            c.gap.displacement_um = DISPLACEMENT_FAILED_UM;
            run(1, 3);
        }
        real from_v = c.motion.command_v;
        for (int ms = 0; ms < 60000 && c.keeps.fault == 0; ms++) {
            begin();
            readings(3);
            if (c.drive.pulses_on) all_open(1);
            end();
            HOLDS(c.motion.command_v < from_v + 8);
            if (ms % 50 == 0) live();
        }
        HOLDS(c.keeps.fault == FAULT_NO_SPARK && !gate);
    }
}

/* A jump's pulses are due in the millisecond in which something forbids them: hal_gate is looked at. */
static void gate_stays_shut(void) {
    uint8_t p[14] = {0};
    put_u32(p, 30000);
    put_u32(p + 4, 500000);
    put_u32(p + 10, 5000);
    for (int what = 0; what < 4; what++) {
        set_up(NULL, 0);
        arm();
        c.motion.command_v = 50;
        cut();
        run(50, 3);
        send(MSG_JUMP, p, 14);
        for (int ms = 0; ms < 1000 && c.keeps.fault == 0; ms++) {
            begin();
            readings(3);
            bool due = c.motion.mode == JUMP_DOWN && c.motion.phase + 1 >= c.motion.phase_ticks;
            if (due && what == 0) c.readings.monitor_v = NAN;
            inputs.estop = due && what == 1;
            inputs.door_open = due && what == 2;
            end();
            if (due && what == 3) edm_abort(&c);
            if (due) begin();
            HOLDS(!due || (!gate && c.keeps.fault != 0));
            if (ms % 50 == 0) live();
        }
        HOLDS(c.keeps.fault != 0);
    }
}

static void cases(void) {
    const real values[] = {NAN, INFINITY, R(1e30), -INFINITY, R(-1e30), R(-2.1e6)};
    for (int i = 0; i < 6; i++) { /* what has failed ends a cut, and is over when it is */
        cut_with(&c.readings.sensor_um, values[i], 1, FAULT_TRAVEL_LIMIT);
        cut_with(&c.readings.monitor_v, values[i], 1, FAULT_PIEZO_OV);
        cut_with(&c.readings.gap_v, values[i], 1, FAULT_GAP_SENSOR);
        cut_with(&c.readings.generator_siemens, values[i], 1, FAULT_GEN_FAULT);
        cut_with(&c.readings.off_time_a, values[i], 1, FAULT_GEN_FAULT);
        cut_with(&c.readings.charge_uc, values[i], 1, FAULT_GEN_FAULT);
        if (!(values[i] < 0)) cut_with(c.readings.plateau_v, values[i], 60, FAULT_GAP_SENSOR); /* below 0 V: shorts */
        cut_with(&inputs.flow_lpm, values[i], 1, FAULT_DIELECTRIC);
        cut_with(&inputs.temperature_c, values[i], 1, FAULT_DIELECTRIC);
        sensor_fails_about(values[i]);
    }
    cut_with(&c.readings.charge_uc, R(-2.1), 1, FAULT_GEN_FAULT); /* a current sensor turned round; noise */
    cut_with(&c.readings.off_time_a, R(0.03), 1, FAULT_GEN_FAULT);
    const real open_with[][4] = {{0, 0, 0, 0}, {R(-1.9), 0, 0, 0}, {-3, 0, 0, 1}, {0, 5, 0, 1}, {0, R(NAN), 0, 1}, {0, 0, 5, 1}};
    for (int i = 0; i < 6; i++) { /* currents in an open gap */
        set_up(NULL, 0);
        arm();
        cut();
        run(100, 3);
        begin();
        readings(3);
        all_open(1);
        c.readings.charge_uc = open_with[i][0];
        c.readings.off_time_a = open_with[i][1];
        c.readings.generator_siemens = open_with[i][2];
        end();
        HOLDS(c.keeps.fault == (open_with[i][3] > 0 ? FAULT_GEN_FAULT : 0));
    }
    gate_stays_shut();

    set_up(NULL, 0); /* a generator that gives no pulses: the tool does not feed on */
    arm();
    cut();
    run(120, 0);
    HOLDS(c.keeps.fault == FAULT_NO_SPARK && !gate && c.motion.command_v < R(0.5));

    for (int way = 0; way < 4; way++) { /* a generator that does not switch off: at rest and in a touch, by either count */
        bool touches = way % 2, by_gate = way > 1;
        uint8_t t[23] = {0};
        set_up(NULL, 0);
        arm();
        put_u32(t, 1000000);
        put_i32(t + 4, 50000);
        put_u32(t + 8, 5000);
        put_i32(t + 12, 100000);
        t[22] = 1;
        if (touches) send(MSG_TOUCH_OFF, t, 23);
        const uint8_t strays[] = {1, 0, 3, 3}; /* the gate may have been shut in the first of those that come */
        for (int ms = 0; ms < 4; ms++) {
            HOLDS(c.keeps.fault == 0);
            begin();
            readings(0);
            *(by_gate ? &c.readings.stray_pulses : &c.readings.pulses) = strays[ms];
            end();
            if (touches && by_gate) break;
        }
        HOLDS(c.keeps.fault == (touches && by_gate ? FAULT_MODE_SWITCH : FAULT_GEN_FAULT) && c.state == STATE_FAULT);
    }

    const real gains[] = {R(0.96), 1, R(1.04)};
    for (int i = 0; i < 3; i++) { /* no sparks any more, by a gap sensor that the self-test lets pass */
        set_up(NULL, 0);
        arm();
        cut();
        run(100, 3);
        HOLDS(gate);
        real last_um = c.gap.displacement_um;
        for (int ms = 0; ms < 5000 && gate; ms++) {
            begin();
            readings(3);
            all_open(gains[i]);
            end();
            if (ms % 50 == 0) live();
        }
        HOLDS(!gate && c.keeps.fault == FAULT_NO_SPARK && c.gap.displacement_um < last_um + 17);
    }

    for (int spike = 0; spike < 2; spike++) { /* an open gap in which now and then a pulse ignites, with a spike of the sensor */
        set_up(NULL, 0);
        arm();
        cut();
        run(100, 3);
        HOLDS(gate);
        real last_um = c.gap.displacement_um;
        for (int ms = 0; ms < 5000 && gate; ms++) {
            begin();
            readings(3);
            bool sparks = ms % 90 == 89, before = ms % 90 == 88;
            all_open(1);
            if (sparks) c.readings.discharge_us[0] = 80;
            if (before && spike) c.readings.sensor_um += 100;
            end();
            if (ms % 50 == 0) live();
        }
        HOLDS(!gate && c.keeps.fault == FAULT_NO_SPARK && 3 * c.motion.command_v < last_um + 17);
    }
    set_up(NULL, 0); /* a spark in each millisecond, and a spike of the sensor in the last one */
    arm();
    cut();
    run(100, 3);
    real place_um = c.gap.displacement_um;
    begin();
    readings(3);
    c.readings.sensor_um += 100;
    end();
    run(1, 3);
    HOLDS(c.gap.last_spark_um <= place_um + 8);

    set_up(NULL, 0); /* contact for a millisecond of a sample of ten */
    uint8_t tlm[TLM_START_SIZE] = {0};
    put_u16(tlm, 10000);
    tlm[2] = 14;
    send(MSG_TLM_START, tlm, TLM_START_SIZE);
    HOLDS(c.telemetry.next > 0);
    for (int ms = 1; ms <= 30; ms++) {
        begin();
        readings(0);
        c.readings.contact = ms == 13;
        end();
    }
    HOLDS(c.telemetry.pending == 3);
    for (int i = 0; i < 3; i++) {
        HOLDS((c.telemetry.samples[i][TLM_RECORD_SIZE - 1] & TLM_FLAGS_CONTACT) == (i == 1 ? TLM_FLAGS_CONTACT : 0));
    }

    set_up(NULL, 0); /* charge of a pulse that lasts for milliseconds: black box and telemetry tell the same of each */
    put_u16(tlm, 1000);
    send(MSG_TLM_START, tlm, TLM_START_SIZE);
    arm();
    cut();
    run(1, 3);
    for (int ms = 0; ms < 4; ms++) {
        const real charge_uc[] = {7, 11, 13, NAN};
        struct edm_reply reply;
        begin();
        readings(ms == 2);
        c.readings.charge_uc = charge_uc[ms];
        end();
        blackbox_read(&c, (uint16_t)(c.tick - c.boot_tick - 1), &reply);
        const uint8_t *kept_sample = reply.payload + BLACKBOX_READ_REPLY_SIZE;
        HOLDS(memcmp(kept_sample, c.telemetry.samples[c.telemetry.pending - 1], TLM_RECORD_SIZE) == 0);
        HOLDS(get_u16(kept_sample + 8) == (ms < 3 ? (uint16_t)charge_uc[ms] : 0));
    }

    set_up(NULL, 0); /* more pulses than there is room for */
    arm();
    cut();
    run(5, 255);
    HOLDS(c.gap.pulse_no == 5 * EDM_MOST_PULSES);

    set_up(NULL, 0); /* a reset beyond the default range: `begin` finds a jump */
    stage_parameter(PARAM_PIEZO_MAX_V, 150000);
    arm();
    uint8_t p[9] = {0};
    put_u16(p, 60000);
    put_u32(p + 2, 1000000);
    send(MSG_PIEZO_SET, p, 6);
    run(200, 0);
    HOLDS(c.motion.command_v >= 149);
    start(RESET_CAUSE_WATCHDOG);
    run(500, 0);
    HOLDS(c.state == STATE_FAULT && c.motion.command_v <= 0);

    const real monitors[] = {100, R(150.4), 200, NAN, R(1e30), -3}, commands[] = {100, 150, 0, 0, 0, 0};
    for (int i = 0; i < 6; i++) { /* where a reset has left the tool, by a monitor that is right or cannot be */
        set_up_after(RESET_CAUSE_EXTERNAL, NULL, monitors[i]);
        HOLDS(!(magnitude(c.motion.command_v - commands[i]) > R(0.001)));
        HOLDS(!(magnitude(c.drive.actuator_v - commands[i]) > DAC_V));
        HOLDS(c.state == (commands[i] > 0 ? STATE_BOOT : STATE_IDLE));
        set_up(NULL, monitors[i]); /* without supply the converter did not keep its voltage: no monitor is believed */
        HOLDS(c.motion.command_v <= 0 && c.drive.actuator_v <= 0 && c.state == STATE_IDLE);
        run(1, 0);
        HOLDS(c.drive.actuator_v <= 0);
    }

    struct edm_persistent words; /* words that did not last */
    memset(&words, 0xFF, sizeof words);
    words.fault = 0;
    set_up(&words, 0);
    for (int i = 0; i < 20; i++) greet();
    HOLDS(c.keeps.nonce_count == EDM_NONCES && c.link.session == session);

    set_up(NULL, 0); /* a stage that takes longer than its speed says */
    arm();
    put_i32(p + 1, 1000);
    put_u32(p + 5, 1000000);
    p[0] = AXIS_X;
    send(MSG_STAGE_MOVE, p, 9);
    inputs.stage_moves = true;
    run(400, 0);
    HOLDS(c.state == STATE_MOVING);
    inputs.stage_moves = false;
    run(1, 0);
    HOLDS(c.state == STATE_ARMED);

    for (int closes = 0; closes < 2; closes++) { /* one that goes on in IDLE: nothing is armed, its limit switch counts */
        set_up(NULL, 0);
        inputs.stage_moves = true;
        inputs.limit_switch = closes;
        run(1, 0);
        arm();
        HOLDS(c.keeps.fault == (closes ? FAULT_STAGE_LIMIT : 0) && !c.armed);
        inputs.stage_moves = inputs.limit_switch = false;
        arm();
        HOLDS(c.armed == !closes);
    }
}

/* What BLACKBOX_READ and WAVEFORM_READ tell: their totals, and a check of all samples of the black box. */
static void records(uint16_t *box, uint32_t *waves, uint32_t *check) {
    struct edm_reply reply;
    blackbox_read(&c, 0, &reply);
    *box = get_u16(reply.payload);
    *check = 0;
    for (uint16_t at = 0; at < *box; at = (uint16_t)(at + reply.payload[6])) {
        blackbox_read(&c, at, &reply);
        *check = frame_crc(*check, reply.payload, reply.size);
    }
    *waves = waveforms_read(&c, 0, &reply) == STATUS_OK ? get_u32(reply.payload) : 0;
}

static void again(uint8_t cause, bool waves) {
    const struct edm_persistent words = kept;
    edm_create_again(&c, NULL, &identity, &words, waves);
    start(cause);
}

/* Resets that memory outlasts: the records of a fault are as they were, up to what is damaged of them. */
static void resets(void) {
    uint16_t box, box_before;
    uint32_t waves, waves_before, check, check_before;
    cut_with(&c.readings.off_time_a, R(1.0), 1, FAULT_GEN_FAULT);
    records(&box_before, &waves_before, &check_before);
    HOLDS(box_before > 50 && waves_before > 1000);
    for (int i = 0; i < 3; i++) {
        again(i == 0 ? RESET_CAUSE_WATCHDOG : RESET_CAUSE_COMMANDED, i < 2);
        records(&box, &waves, &check);
        HOLDS(c.keeps.fault == FAULT_GEN_FAULT && c.state == STATE_FAULT);
        HOLDS(box == box_before && check == check_before && waves == (i < 2 ? waves_before : 0));
    }
    run(600, 0);
    records(&box, &waves, &check);
    HOLDS(box == box_before && check == check_before);
    c.box.ring[(size_t)(c.box.frozen_tick - 1 - 20) % EDM_BOX_SAMPLES].actuator_v += R(1.0);
    again(RESET_CAUSE_EXTERNAL, true);
    records(&box, &waves, &check);
    HOLDS(box == 20);
    uint8_t p[2];
    put_u16(p, FAULT_GEN_FAULT);
    send(MSG_CLEAR_FAULT, p, 2);
    run(30, 0);
    records(&box, &waves, &check);
    HOLDS(c.state == STATE_IDLE && box == 30 && waves == 0);

    struct edm_persistent latched; /* a fault whose samples went with the supply, or are damaged, has none that come later */
    memset(&latched, 0, sizeof latched);
    latched.fault = FAULT_ABORT_RUN;
    for (int i = 0; i < 3; i++) {
        if (i == 0) {
            set_up(&latched, 0);
        } else {
            again(RESET_CAUSE_EXTERNAL, false);
        }
        run(50, 0);
        records(&box, &waves, &check);
        HOLDS(c.state == STATE_FAULT && box == 0 && waves == 0);
    }
    put_u16(p, FAULT_ABORT_RUN);
    send(MSG_CLEAR_FAULT, p, 2);
    run(30, 0);
    records(&box, &waves, &check);
    HOLDS(c.state == STATE_IDLE && box == 30);
    edm_abort(&c);
    run(600, 0);
    c.box.ring[(size_t)(c.box.frozen_tick - 1) % EDM_BOX_SAMPLES].actuator_v += R(1.0);
    again(RESET_CAUSE_WATCHDOG, false);
    run(50, 0);
    records(&box, &waves, &check);
    HOLDS(c.keeps.fault == FAULT_ABORT_RUN && box == 0);

    set_up(NULL, 0); /* a program that hangs: what was before it is frozen when it starts again */
    arm();
    cut();
    run(300, 3);
    int64_t tick = c.tick;
    again(RESET_CAUSE_WATCHDOG, true);
    records(&box, &waves, &check);
    HOLDS(c.keeps.fault == FAULT_RESET && box == 300 && waves == 0 && c.tick == tick && time_us(&c) == 0);
    HOLDS(c.box.ring[(size_t)(tick - 1) % EDM_BOX_SAMPLES].state == STATE_MACHINING);

    set_up(NULL, 0); /* one that was asked for */
    run(300, 0);
    again(RESET_CAUSE_COMMANDED, true);
    records(&box, &waves, &check);
    HOLDS(box == 0 && waves == 0 && c.state == STATE_IDLE);

    for (int i = 0; i < 200; i++) { /* words that never were a controller's */
        for (size_t k = 0; k < sizeof c; k++) {
            ((uint8_t *)&c)[k] = (uint8_t)draw(256);
        }
        memset(&kept, 0, sizeof kept);
        c.box.frozen = draw(2) != 0;
        c.waveforms.frozen = draw(2) != 0;
        kept.fault = draw(2) ? FAULT_ABORT_RUN : 0;
        again(RESET_CAUSE_WATCHDOG, draw(2) != 0);
        records(&box, &waves, &check);
        HOLDS(box <= 1 && c.tick >= 0);
        uint16_t held = box;
        run(5, 0);
        records(&box, &waves, &check);
        HOLDS(box == held);
    }
}

/* A slow path far from the stages' zero, where a step is less than float can add. */
static void slow_path(void) {
    const struct edm_line line = {.x_um = 101000, .y_um = 0, .speed_um_s = 1, .z_um = 60, .last = true};
    set_up(NULL, 0);
    c.motion.mode = SERVO;
    c.stages.at[AXIS_X] = 100000;
    c.servo.z_limit_um = 50;
    scan_begin(&c);
    scan_append(&c, &line);
    for (int ms = 0; ms < 20000; ms++) scan_tick(&c);
    HOLDS(magnitude(c.drive.stage_um[AXIS_X] - R(100020.0)) < R(0.05));
    HOLDS(magnitude(c.servo.z_limit_um - R(50.2)) < R(0.005));
}

/* Steps below what float can add: a ramp at 100 V, the mean of a long touch, the nanoseconds of a long period. */
static void small_steps(void) {
    uint8_t p[17] = {0};
    set_up(NULL, 0);
    arm();
    c.motion.command_v = 100;
    put_u16(p, 44000);
    put_u32(p + 2, 3);
    send(MSG_PIEZO_SET, p, 6);
    for (int ms = 0; ms < 100000; ms++) motion_command(&c);
    HOLDS(magnitude(c.motion.command_v - R(100.3)) < R(0.001));

    motion_enter(&c, TOUCH_HUNT);
    c.motion.dwell_ticks = 65000;
    c.motion.z_max_um = 1000;
    c.gap.displacement_um = c.gap.slow_displacement_um = R(100.123);
    c.touch.sum = c.touch.rest = 0;
    c.touch.count = 0;
    for (int ms = 0; ms < 60000; ms++) touch_tick(&c);
    HOLDS(magnitude(c.touch.sum / (real)c.touch.count - R(100.123)) < R(0.0001));

    set_up(NULL, 0);
    arm();
    put_u32(p, 123456789);
    put_u32(p + 4, 87654322);
    put_u16(p + 8, 8000);
    put_u16(p + 10, 120);
    send(MSG_PULSE_CONFIG, p, 17);
    HOLDS(c.settings.pulse_period_ns == 211111111);
    memset(p, 0, sizeof p);
    put_u32(p + 6, 39999999);
    send(MSG_SERVO_START, p, 10);
    HOLDS(c.servo.time_ticks == 39999999);
}

/* A short whose tool is far beyond the limit of a scan, or whose sensor says so: it goes back as fast as any. */
static void short_beyond_the_limit(void) {
    const real beyond_um[] = {0, 10, 100, DISPLACEMENT_FAILED_UM};
    for (int i = 0; i < 4; i++) {
        set_up(NULL, 0);
        c.scan.scanning = c.gap.shorted = true;
        c.servo.time_ticks = 100;
        c.gap.slow_displacement_um = c.servo.z_limit_um + beyond_um[i];
        servo_tick(&c);
        HOLDS(!(c.servo.rate_v_s > -c.settings.short_back_um_s * c.settings.v_per_um));
    }
}

/* A millisecond of a cut with two pulses, of which so many ignite, at a place that both readings tell. */
static int measured(int sparks, real displacement_um, real slow_um) {
    const int pulses = 2;
    c.readings.pulses = (uint8_t)pulses;
    c.readings.gap_v = 10;
    c.gap.displacement_um = displacement_um;
    c.gap.slow_displacement_um = slow_um;
    c.gap.tick.of[PULSE_CLASS_OPEN] = (uint16_t)(pulses - sparks);
    c.gap.tick.of[PULSE_CLASS_NORMAL] = (uint16_t)sparks;
    return gap_measure(&c, 0);
}

/* What counts as a spark, and as its place. */
static void places_of_sparks(void) {
    const real at_um[][3] = {{7, R(6.5), 7}, {DISPLACEMENT_FAILED_UM, R(6.5), 7}, {8, R(6.5), 8}, {108, R(6.5), 13},
                             {R(8.5), R(6.5), R(8.5)}, {13, -40, 13}}; /* a spike; back from a jump the slow one lags */
    set_up(NULL, 0);
    c.gap.last_spark_um = 0;
    for (int i = 0; i < 6; i++) {
        HOLDS(measured(2, at_um[i][0], at_um[i][1]) == NOTHING && c.gap.open_ticks == 0);
        HOLDS(!(magnitude(c.gap.last_spark_um - at_um[i][2]) > R(0.001)));
    }
    for (int ms = 1; ms < 4; ms++) {
        HOLDS(measured(0, 13, 13) == NOTHING && c.gap.open_ticks == ms);
    }
    HOLDS(measured(1, 13, 13) == NOTHING && c.gap.open_ticks == 0);
}

/* A tool feeds at 50 µm/s through a gap without work, in which now and then a pulse ignites: sparks that are apart are
 * chance, with a spike of the sensor or without. */
static void sparks_by_themselves(void) {
    for (int way = 0; way < 6; way++) {
        const int apart_ms[] = {90, 15, 14};
        int apart = apart_ms[way % 3], found = NOTHING, ms = 0;
        set_up(NULL, 0);
        c.gap.last_spark_um = 0;
        c.settings.pulse_period_ns = 434783;
        c.settings.open_lost_um = 15;
        c.servo.time_ticks = 60000;
        c.servo.z_limit_um = 10000;
        for (; ms < 4000 && found == NOTHING; ms++) {
            real z_um = R(0.05) * (real)ms;
            bool sparks = ms % apart == apart - 1;
            HOLDS(measured(sparks, z_um + (sparks && way > 2 ? R(100.0) : 0), z_um - R(2.5)) == NOTHING);
            found = servo_watch(&c);
        }
        HOLDS(apart == 14 ? found == NOTHING : found == FAULT_NO_SPARK && R(0.05) * (real)(ms - 1) < R(17.6));
    }
}

/* Of slow pulses some ignite, by chance, while the tool feeds at 1 µm/s: they are sparks. */
static void sparse_sparks(void) {
    const uint32_t period_ms[] = {1, 10, 100, 1000}, percent[] = {5, 20, 20, 70};
    for (int i = 0; i < 4; i++) {
        set_up(NULL, 0);
        c.gap.last_spark_um = 0;
        c.settings.pulse_period_ns = (int64_t)period_ms[i] * TICK_NS;
        c.servo.time_ticks = c.settings.open_ticks_max * 1000000;
        c.servo.z_limit_um = R(1e9);
        for (uint32_t pulse = 0; pulse < 2000; pulse++) {
            real z_um = R(0.001) * (real)(pulse * period_ms[i]);
            c.gap.silent_ticks = period_ms[i] - 1;
            HOLDS(measured(draw(100) < percent[i] ? 2 : 0, z_um, z_um) == NOTHING && servo_watch(&c) == NOTHING);
        }
    }
}

/* The hardware has ended the pulses: whatever needs them stands still until a fault is latched, a jump in each of its phases. */
static void pulses_broken(void) {
    for (int ms = 0; ms < 260; ms += 7) {
        for (int what = 0; what < 3; what++) {
            uint8_t p[14] = {0};
            set_up(NULL, 0);
            arm();
            if (what == 0) {
                send(MSG_SELF_TEST, p, 0);
            } else {
                c.motion.command_v = 50;
                cut();
                run(50, 3);
            }
            put_u32(p, 30000);
            put_u32(p + 4, 500000);
            put_u16(p + 8, 20);
            put_u32(p + 10, 5000);
            if (what == 1) send(MSG_JUMP, p, 14);
            run(ms, 3);
            uint8_t before = c.state;
            real from_v = c.motion.command_v;
            for (int k = 0; k < 10; k++) {
                edm_pulses_broken(&c);
                HOLDS(!gate && c.waveforms.frozen && c.keeps.fault == 0);
                begin();
                readings(0);
                end();
                HOLDS(c.state == before && !(c.motion.command_v > from_v || c.motion.command_v < from_v));
            }
            edm_fault(&c, FAULT_GEN_FAULT, 0);
            edm_pulses_broken(&c);
            run(300, 0);
            HOLDS(c.keeps.fault == FAULT_GEN_FAULT && c.motion.command_v <= 0);
        }
    }
}

static void act(void) {
    uint8_t p[MAX_PAYLOAD] = {0};
    switch (draw(32)) {
    case 0: if (!draw(40)) greet(); break;
    case 1: arm(); break;
    case 2: if (!draw(20)) send(MSG_DISARM, p, 0); break;
    case 3: put_u16(p, c.keeps.fault); send(MSG_CLEAR_FAULT, p, 2); break;
    case 4: {
        int row = (int)draw(PARAMS);
        uint32_t which = draw(4);
        stage_parameter(row, which == 0 ? edm_params[row].least : which == 1 ? edm_params[row].most
                                                                             : edm_params[row].default_wire);
        break;
    }
    case 5: put_u16(p, (uint16_t)draw(60001)); put_u32(p + 2, draw(5) ? draw(2000000) : 1); send(MSG_PIEZO_SET, p, 6); break;
    case 6: p[0] = (uint8_t)draw(3); put_i32(p + 1, (int32_t)draw(20000)); put_u32(p + 5, 1000000); send(MSG_STAGE_MOVE, p, 9); break;
    case 7: send(MSG_STAGE_STOP, p, 0); break;
    case 8: put_u32(p, draw(20000)); put_u32(p + 4, draw(200000)); put_u16(p + 8, (uint16_t)draw(3000)); send(MSG_APPROACH, p, 10); break;
    case 9: case 10: put_u16(p, (uint16_t)draw(3000)); put_i32(p + 2, (int32_t)draw(400000)); put_u32(p + 6, draw(10000)); send(draw(2) ? MSG_SERVO_START : MSG_SCAN_START, p, 10); break;
    case 11: if (!draw(10)) send(MSG_SERVO_STOP, p, 0); break;
    case 12: put_u32(p, draw(100000)); put_u32(p + 4, draw(3000000)); put_u16(p + 8, (uint16_t)draw(100)); put_u32(p + 10, draw(20000)); send(MSG_JUMP, p, 14); break;
    case 13: put_u32(p, draw(3000000)); put_i32(p + 4, (int32_t)draw(50000)); put_u32(p + 8, draw(20000)); put_i32(p + 12, (int32_t)draw(300000)); put_u32(p + 16, draw(30000)); p[20] = (uint8_t)draw(100); p[22] = (uint8_t)draw(4); send(MSG_TOUCH_OFF, p, 23); break;
    case 14: send(MSG_SELF_TEST, p, 0); break;
    case 15: put_i32(p, (int32_t)draw(10000)); put_i32(p + 4, (int32_t)draw(10000)); put_u32(p + 8, draw(1000000)); put_i32(p + 12, (int32_t)draw(300000)); p[16] = draw(6) == 0; send(MSG_PATH_MOVE, p, 17); break;
    case 16: put_u32(p, draw(20) ? 130435 : draw(1000000000)); put_u32(p + 4, draw(20) ? 304348 : draw(1000000000)); put_u16(p + 8, 8000); put_u16(p + 10, 120); send(MSG_PULSE_CONFIG, p, 17); break;
    case 17: p[0] = draw(20) != 0; send(MSG_PULSE_ENABLE, p, 1); break;
    case 18: put_u16(p, 1000); p[2] = (uint8_t)(1 + draw(14)); p[3] = (uint8_t)draw(3); send(MSG_TLM_START, p, 4); break;
    case 19: if (!draw(200)) start((uint8_t)draw(5)); break;
    case 20: send(MSG_WAVEFORM_READ, p, 4); send(MSG_BLACKBOX_READ, p, 2); break;
    default: if (draw(8)) live(); else send(MSG_GET_STATUS, p, 0); break;
    }
}

int main(int argc, char **argv) {
    unsigned long sparks = 0, steps = argc > 2 ? strtoul(argv[2], NULL, 10) : 0;
    unsigned states = 0;
    if (steps == 0) {
        cases();
        resets();
        slow_path();
        small_steps();
        short_beyond_the_limit();
        pulses_broken();
        places_of_sparks();
        sparks_by_themselves();
        sparse_sparks();
        printf("%d broken\n", broken);
        return broken != 0;
    }
    set_up(NULL, 0);
    state = strtoull(argv[1], NULL, 10);
    odds = (uint32_t)strtoul(argv[3], NULL, 10);
    for (unsigned long i = 0; i < steps; i++) {
        fails = draw(3) ? KINDS : draw(KINDS);
        act();
        for (int ms = (int)draw(12) + (draw(30) ? 0 : 150); ms > 0; ms--) {
            inputs.estop = draw(20000) == 0;
            inputs.door_open = draw(20000) == 0;
            inputs.limit_switch = draw(5000) == 0;
            inputs.flow_lpm = any(FLOW, 1);
            inputs.temperature_c = any(HEAT, 20);
            inputs.monitor_v = any(MONITOR, c.drive.actuator_v);
            begin();
            readings((int)draw(5));
            c.readings.contact = draw(100) == 0;
            c.readings.stray_pulses = draw(30000) == 0;
            end();
            sparks += gate;
            if (ms % 50 == 0) live();
        }
        states |= 1u << c.state;
    }
    printf("%lld ms, %lu with pulses, states %#x, %d broken\n", (long long)c.tick, sparks, states, broken);
    printf("frames %016llx\n", (unsigned long long)heard);
    return broken != 0 || sparks < steps / 100; /* without sparks nothing is tried */
}
