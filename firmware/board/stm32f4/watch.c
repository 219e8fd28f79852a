/* What ends a program that hangs: two watchdogs (RM0090 21 and 22) and a guard below the stack (MPU, PM0214 4.2). */
#include "board.h"

#define PRESCALER_4 0u      /* of 32 kHz */
#define START_RELOAD 4095u  /* 512 ms for the start */
#define RUN_RELOAD 80u      /* 10 ms */
#define WINDOW_OFF 0x7Fu
#define WINDOW_COUNT 0x4Fu  /* 16 counts of 4096 / 42 MHz to 0x3F: 1.56 ms */
#define WAIT_MOST 1000000u

extern uint8_t guard_begin[];

/* Closes the kilobyte below the stack of the main loop. */
void watch_guard_stack(void) {
    *MPU_RNR = 0;
    *MPU_RBAR = (uint32_t)(uintptr_t)guard_begin;
    *MPU_RASR = MPU_RASR_CLOSED_1K;
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

void watch_feed(void) {
    IWDG->KR = IWDG_KR_FEED;
    WWDG->CR = WWDG_CR_WDGA | WINDOW_COUNT;
}
