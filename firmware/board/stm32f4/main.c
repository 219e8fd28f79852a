/* The millisecond: its tick, and what the main loop does in it (docs/firmware.md, Porting to a board). */
#include "board.h"

#define REBOOT_TICKS_MOST 100 /* for the reply to go out */
#define BREAK_TICKS 10u       /* for e-stop and door to follow their break: filter of the inputs, contacts of one switch */

IN_CCM struct edm_controller controller;

static struct measure measure;
static volatile uint32_t begun;    /* milliseconds that the tick has begun */
static volatile uint32_t finished; /* and that the main loop has done with */

/* TIM7, every millisecond. A main loop that is late gets no other chance: gate off, stages stopped, and the watchdogs are
 * not fed. */
void main_tick(void) {
    TIM7->SR = ~TIM_SR_UIF;
    static bool late;
    late = late || finished != begun;
    if (late) {
        gate_lock();
        stages_halt();
        return;
    }
    stages_put();
    sampling_latch();
    watch_feed();
    begun = begun + 1u;
}

static void wait_for_tick(void) {
    interrupts_off(); /* a tick between look and sleep would be slept over; a masked one wakes as well */
    while (begun == finished) {
        wait_for_interrupt();
        interrupts_on();
        interrupts_off();
    }
    interrupts_on();
}

/* Twelve digits of the chip's number. */
static void tell_serial(char serial[12]) {
    static const char digits[] = "0123456789ABCDEF";
    uint64_t number = ((uint64_t)CHIP_ID[2] << 16 ^ CHIP_ID[1]) * 0x9E3779B97F4A7C15u ^ CHIP_ID[0];
    number ^= number >> 32;
    for (int i = 0; i < 12; i++) {
        serial[i] = digits[number >> 4 * i & 15u];
    }
}

/* The fault of a break of the pulses: that of e-stop or door, which the core's guard tells once their inputs have followed,
 * or else the over-current. Until then no pulses, and the tool is held. */
static void tell_break(struct edm_controller *c) {
    static uint32_t ticks;
    if (!gate_broken()) {
        return;
    }
    edm_pulses_broken(c);
    if (c->keeps.fault == 0) {
        if (!pins_high(PIN_DOOR)) { /* disarmed in the meantime */
            edm_fault(c, FAULT_DOOR, INTERLOCKS_DOOR);
        } else if (ticks++ < BREAK_TICKS) {
            return;
        } else {
            edm_fault(c, FAULT_GEN_FAULT, 0);
        }
    }
    ticks = 0;
    gate_release();
}

/* What the core says for the millisecond that begins. */
static void put_out(const struct edm_controller *c) {
    actuator_put(c->drive.actuator_v);
    stages_plan(c);
    inputs_put_mode(edm_generator_at_gap(c));
}

static void do_millisecond(struct edm_controller *c) {
    struct records records;
    sampling_look(&records, (c->tick + 1) * TICK_NS);
    measure_millisecond(&measure, &records, gate_state(), &c->readings);
    c->readings.contact = inputs_contact();
    sampling_tend(c);
    edm_conclude(c, edm_tick_end(c));
    edm_watch(c);
    tell_break(c);
    if (line_is_held_low()) {
        edm_abort(c);
    }
    line_read(c);
    edm_line_read(c);
    edm_tick_begin(c);
    put_out(c);
    if (!clock_is_own()) {
        inputs_toggle_alive();
    }
    line_send();
}

/* Restarts once the reply is out; a line that does not take it does not hold it up. */
static void reboot_when_told(const struct edm_controller *c) {
    static uint32_t ticks;
    if (c->link.reboot_asked && (line_is_sent() || ticks++ == REBOOT_TICKS_MOST)) {
        startup_restart();
    }
}

/* The tool begins where its converter was put last, whatever the monitor says: no step. A brown-out may have taken the supply
 * of the converter too, which is at 0 V then: the lower of both. */
static void begin_where_left(struct edm_controller *c, uint8_t cause) {
    real left_v = actuator_left();
    edm_stands_at(c, cause == RESET_CAUSE_BROWN_OUT ? least(left_v, c->drive.actuator_v) : left_v);
}

static void start_core(struct edm_controller *c) {
    struct edm_identity identity = {.board = BOARD_NUMBER, .baud = EDM_BAUD, .host_time_scale = 1};
    uint8_t cause = keep_cause();
    tell_serial(identity.serial);
    stages_begin(cause != RESET_CAUSE_POWER_ON);
    bool waves = cause != RESET_CAUSE_POWER_ON && sampling_kept(c);
    sampling_start();
    if (cause == RESET_CAUSE_POWER_ON) {
        edm_create(c, NULL, &identity, keep_words(cause));
    } else {
        edm_create_again(c, NULL, &identity, keep_words(cause), waves);
        begin_where_left(c, cause);
    }
    stages_tell(c);
    edm_start(c, cause);
    edm_tick_begin(c);
}

_Noreturn void main_run(void) {
    watch_start();
    supply_start();
    clock_start();
    clocks_on(&RCC->AHB1ENR, RCC_AHB1_CCM | 0x7Fu); /* ports A to G */
    barrier();
    gate_start();
    if (clock_is_own()) {
        gate_lock();
    }
    pins_start();
    actuator_start();
    line_start();
    start_core(&controller);
    put_out(&controller);
    line_send();
    watch_run();
    sampling_run();
    for (;;) {
        wait_for_tick();
        do_millisecond(&controller);
        reboot_when_told(&controller);
        if (clock_is_back()) {
            startup_restart();
        }
        finished = begun;
    }
}
