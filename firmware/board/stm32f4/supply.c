/* The voltage detector of the supply (PWR, RM0090 5.2.3; EXTI, 12.3): a supply that drops ends the run at once, before
 * anything that works on a lower one says what is not so. The brown-out reset stays as the option bytes have it. */
#include "board.h"

/* Waits until the supply is there, then watches it: the handler is due as soon as interrupts are on. The watchdog of the
 * start ends a wait that lasts. */
void supply_start(void) {
    clocks_on(&RCC->APB1ENR, RCC_APB1_PWR);
    PWR->CR |= PWR_CR_PLS_6 | PWR_CR_PVDE;
    EXTI->RTSR |= EXTI_PVD;
    do {
        EXTI->PR = EXTI_PVD; /* what comes after this is kept */
    } while ((PWR->CSR & PWR_CSR_PVDO) != 0);
    EXTI->IMR |= EXTI_PVD;
    NVIC_IPR[IRQ_TIM7] = 1u << 4; /* below the supply, whose handler comes into the tick too */
    NVIC_ISER[IRQ_PVD / 32] = 1u << IRQ_PVD % 32;
}
