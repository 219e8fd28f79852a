/* 168 MHz from the 8 MHz that the ST-LINK gives (RM0090 6.2, 3.5.1, 5.1.4). Where that clock does not come, or has gone with
 * the plug, the chip's own oscillator takes the tool back: it is good for nothing else, so gate and high voltage stay off. */
#include "board.h"

#define PLL_M_HSE 4u /* 2 MHz into the PLL, of 8 */
#define PLL_M_HSI 8u /* and of 16 */
#define PLL_N 168u /* 336 MHz */
#define PLL_P 0u   /* divided by 2 */
#define PLL_Q 7u
#define LOOKS_MOST 200000u /* at the clock that does not come; about 0.1 s of the 16 MHz of a start */

static bool is_own;

void clock_start(void) {
    clocks_on(&RCC->APB1ENR, RCC_APB1_PWR);
    PWR->CR |= PWR_CR_VOS_1;
    RCC->CR |= RCC_CR_HSEBYP;
    RCC->CR |= RCC_CR_HSEON;
    is_own = true;
    for (uint32_t i = 0; i < LOOKS_MOST && is_own; i++) {
        is_own = (RCC->CR & RCC_CR_HSERDY) == 0;
    }
    RCC->PLLCFGR = (is_own ? PLL_M_HSI : PLL_M_HSE | RCC_PLLCFGR_SRC_HSE) | PLL_N << 6 | PLL_P << 16 | PLL_Q << 24;
    RCC->CR |= RCC_CR_PLLON;
    while ((RCC->CR & RCC_CR_PLLRDY) == 0) {
    }
    FLASH->ACR = FLASH_ACR_LATENCY(5u) | FLASH_ACR_PRFTEN | FLASH_ACR_ICEN | FLASH_ACR_DCEN;
    RCC->CFGR = RCC_CFGR_PPRE1_4 | RCC_CFGR_PPRE2_2;
    RCC->CFGR |= RCC_CFGR_SW_PLL;
    while ((RCC->CFGR & RCC_CFGR_SWS_MASK) != RCC_CFGR_SWS_PLL) {
    }
    if (!is_own) {
        RCC->CR |= RCC_CR_CSSON; /* a clock that fails is a NMI */
    }
}

/* Whether the chip runs by its own oscillator. */
bool clock_is_own(void) {
    return is_own;
}

/* Whether it does, and the better clock is there by now. */
bool clock_is_back(void) {
    return is_own && (RCC->CR & RCC_CR_HSERDY) != 0;
}
