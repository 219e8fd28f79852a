/* The actuator's converter: 16 bits over SPI4 (RM0090 28.3), 2.5 mV each. It keeps its voltage through a reset. */
#include "board.h"

NO_INIT volatile uint32_t kept_codes[2]; /* what it was put to last, in the upper half inverted; one bit spoils but one */

#define WAIT_MOST 400u /* looks at a flag; 16 bits take 1.5 us */

void actuator_start(void) {
    clocks_on(&RCC->APB2ENR, RCC_APB2_SPI4);
    SPI4->CR1 = SPI_CR1_MSTR | SPI_CR1_BR_8 | SPI_CR1_SSM | SPI_CR1_SSI | SPI_CR1_DFF;
    SPI4->CR1 |= SPI_CR1_SPE;
}

/* Puts out a voltage, V. A converter that does not take it shows at the monitor: fault 2002. */
void actuator_put(real volts) {
    int64_t counts = nearest(volts * STEPS_PER_V);
    counts = counts < 0 ? 0 : counts > UINT16_MAX ? UINT16_MAX : counts;
    kept_codes[0] = kept_codes[1] = (uint32_t)counts | ~(uint32_t)counts << 16;
    pins_put(PIN_DAC_SELECT, false);
    SPI4->DR = (uint32_t)counts;
    for (uint32_t i = 0; i < WAIT_MOST && (SPI4->SR & SPI_SR_TXE) == 0; i++) {
    }
    for (uint32_t i = 0; i < WAIT_MOST && (SPI4->SR & SPI_SR_BSY) != 0; i++) {
    }
    pins_put(PIN_DAC_SELECT, true);
}

/* Where a reset that was not of the supply has left the converter, V. 0 where that is not known: towards the work nothing
 * is ever put out by guess. */
real actuator_left(void) {
    for (uint32_t i = 0; i < 2u; i++) {
        uint32_t code = kept_codes[i];
        if (((code >> 16 ^ code) & UINT16_MAX) == UINT16_MAX) {
            return (real)(code & UINT16_MAX) / STEPS_PER_V;
        }
    }
    return 0;
}
