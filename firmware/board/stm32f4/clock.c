/* 168 MHz from the 8 MHz that the ST-LINK gives (RM0090 6.2, 3.5.1, 5.1.4). Without that clock the chip's own watchdog
 * resets the board again and again, gate off. */
#include "board.h"

#define PLL_M 4u   /* 2 MHz into the PLL */
#define PLL_N 168u /* 336 MHz */
#define PLL_P 0u   /* divided by 2 */
#define PLL_Q 7u

void clock_start(void) {
    clocks_on(&RCC->APB1ENR, RCC_APB1_PWR);
    PWR->CR |= PWR_CR_VOS_1;
    RCC->CR |= RCC_CR_HSEBYP;
    RCC->CR |= RCC_CR_HSEON;
    while ((RCC->CR & RCC_CR_HSERDY) == 0) {
    }
    RCC->PLLCFGR = PLL_M | PLL_N << 6 | PLL_P << 16 | PLL_Q << 24 | RCC_PLLCFGR_SRC_HSE;
    RCC->CR |= RCC_CR_PLLON;
    while ((RCC->CR & RCC_CR_PLLRDY) == 0) {
    }
    FLASH->ACR = FLASH_ACR_LATENCY(5u) | FLASH_ACR_PRFTEN | FLASH_ACR_ICEN | FLASH_ACR_DCEN;
    RCC->CFGR = RCC_CFGR_PPRE1_4 | RCC_CFGR_PPRE2_2;
    RCC->CFGR |= RCC_CFGR_SW_PLL;
    while ((RCC->CFGR & RCC_CFGR_SWS_MASK) != RCC_CFGR_SWS_PLL) {
    }
    RCC->CR |= RCC_CR_CSSON; /* a clock that fails is a NMI */
}
