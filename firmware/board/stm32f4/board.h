/* What the files of this board offer each other; the names begin with the file. */
#ifndef BOARD_H
#define BOARD_H

#include "../../edm.h"
#include "../measure.h"
#include "../scale.h"
#include "pins.h"
#include "registers.h"

#define BOARD_NUMBER 0x0429u
#define CPU_HZ 168000000u
#define APB1_HZ 42000000u
#ifndef EDM_BAUD
#define EDM_BAUD 921600
#endif

/* Not cleared by the start. No static variables: of those a compiler knows that they begin with 0. */
#define NO_INIT __attribute__((section(".noinit")))
#define IN_CCM __attribute__((section(".ccm")))

/* startup.c: why a fault handler, or the supply, ended the run before. */
enum crash { CRASH_NONE, CRASH_NMI, CRASH_HARD, CRASH_MEMORY, CRASH_BUS, CRASH_USAGE, CRASH_IRQ, CRASH_SUPPLY };
_Noreturn void startup_restart(void);

/* clock.c */
void clock_start(void);
bool clock_is_own(void);
bool clock_is_back(void);

/* supply.c */
void supply_start(void);

/* pins.c */
void pins_start(void);
void pins_set(enum pin pin);
bool pins_high(enum pin pin);
void pins_put(enum pin pin, bool high);

/* gate.c */
void gate_start(void);
void gate_off(void);
void gate_lock(void);
bool gate_broken(void);
void gate_release(void);
const struct gate *gate_state(void);

/* sampling.c */
void sampling_start(void);
void sampling_run(void);
void sampling_latch(void);
void sampling_look(struct records *records, int64_t now_ns);
void sampling_tend(const struct edm_controller *c);
real sampling_slow(enum slow channel);
bool sampling_kept(const struct edm_controller *c);

/* line.c */
void line_start(void);
void line_read(struct edm_controller *c);
void line_send(void);
bool line_is_sent(void);
bool line_is_held_low(void);

/* actuator.c */
void actuator_start(void);
void actuator_put(real volts);
real actuator_left(void);

/* image.c */
uint32_t image_check(void);

/* inputs.c */
bool inputs_contact(void);
void inputs_put_mode(bool generator);
void inputs_toggle_alive(void);

/* stages.c */
void stages_begin(bool kept);
void stages_tell(struct edm_controller *c);
void stages_put(void);
void stages_halt(void);
void stages_plan(const struct edm_controller *c);
bool stages_move(void);

/* keep.c */
const struct edm_persistent *keep_words(uint8_t cause);
uint8_t keep_cause(void);

/* watch.c */
void watch_guard_stacks(void);
void watch_start(void);
void watch_run(void);
void watch_feed(void);

/* main.c */
void main_tick(void);
_Noreturn void main_run(void);

#endif
