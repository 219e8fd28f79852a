/* What ends a program that hangs: two watchdogs (RM0090 21 and 22) and a guard below each stack (MPU, PM0214 4.2). */
#include "board.h"

#define PRESCALER_4 0u      /* of 32 kHz */
#define START_RELOAD 4095u  /* 512 ms for the start */
#define RUN_RELOAD 80u      /* 10 ms */
#define WINDOW_OFF 0x7Fu
#define WINDOW_COUNT 0x4Fu  /* 16 counts of 4096 / 42 MHz to 0x3F: 1.56 ms */
#define WAIT_MOST 1000000u

extern uint8_t guard_begin[];

static void close_kilobyte(uint32_t region, uint32_t at) {
    *MPU_RNR = region;
    *MPU_RBAR = at;
    *MPU_RASR = MPU_RASR_CLOSED_1K;
}

/* Closes the kilobyte below each stack; that of the interrupts is the first thing in the SRAM, so what is below it is no
 * memory, and costs none. */
void watch_guard_stacks(void) {
    close_kilobyte(0, (uint32_t)(uintptr_t)guard_begin);
    close_kilobyte(1, SRAM_AT - 1024u);
    *MPU_CTRL = MPU_CTRL_ON;
    barrier();
}

static void set_reload(uint32_t reload) {
    IWDG->KR = IWDG_KR_OPEN;
    IWDG->PR = PRESCALER_4;
    IWDG->RLR = reload;
    for (uint32_t i = 0; i < WAIT_MOST && IWDG->SR != 0; i++) {
    }
    IWDG->KR = IWDG_KR_FEED;
}

/* For the start: the clock that does not come, too. */
void watch_start(void) {
    IWDG->KR = IWDG_KR_START;
    set_reload(START_RELOAD);
}

/* For the main loop, from now on. */
void watch_run(void) {
    set_reload(RUN_RELOAD);
    clocks_on(&RCC->APB1ENR, RCC_APB1_WWDG);
    WWDG->CFR = WINDOW_OFF;
    WWDG->CR = WWDG_CR_WDGA | WINDOW_COUNT;
}

/* In the tick. A debugger that stops the watchdogs with the core would leave the gate to its timer: that is taken back. */
void watch_feed(void) {
    *DBGMCU_APB1_FZ &= ~(DBGMCU_APB1_FZ_WWDG | DBGMCU_APB1_FZ_IWDG);
    IWDG->KR = IWDG_KR_FEED;
    WWDG->CR = WWDG_CR_WDGA | WINDOW_COUNT;
}
