/* The actuator's converter: 16 bits over SPI4 (RM0090 28.3), 2.5 mV each. It keeps its voltage through a reset. */
#include "board.h"

/* What it was put to last, twice: a bit that flips spoils but one. The check is of this image: what another one has left
 * there, or a program that flashes, which works in this memory, is no place. */
NO_INIT volatile struct {
    uint32_t code, check;
} kept_codes[2];

#define WAIT_MOST 400u /* looks at a flag; 16 bits take 1.5 us */

void actuator_start(void) {
    clocks_on(&RCC->APB2ENR, RCC_APB2_SPI4);
    SPI4->CR1 = SPI_CR1_MSTR | SPI_CR1_BR_8 | SPI_CR1_SSM | SPI_CR1_SSI | SPI_CR1_DFF;
    SPI4->CR1 |= SPI_CR1_SPE;
}

static uint32_t check_of(uint32_t code) {
    return ~(code * 0x9E3779B1u) ^ image_check();
}

/* Puts out a voltage, V. A converter that does not take it shows at the monitor: fault 2002. */
void actuator_put(real volts) {
    int64_t counts = nearest(volts * STEPS_PER_V);
    counts = counts < 0 ? 0 : counts > UINT16_MAX ? UINT16_MAX : counts;
    for (uint32_t i = 0; i < 2u; i++) {
        kept_codes[i].code = (uint32_t)counts;
        kept_codes[i].check = check_of((uint32_t)counts);
    }
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
        uint32_t code = kept_codes[i].code;
        if (code <= UINT16_MAX && kept_codes[i].check == check_of(code)) {
            return (real)code / STEPS_PER_V;
        }
    }
    return 0;
}
