/* Sets the ports by the table of pins (RM0090 8.3, 8.4). */
#include "board.h"

enum { MODE_INPUT, MODE_OUTPUT, MODE_ALTERNATE, MODE_ANALOG };
enum { PULL_NONE, PULL_UP, PULL_DOWN };
#define SPEED_HIGH 2u

static const struct row {
    uint8_t port, number, mode, af, pull, level;
} rows[PIN_COUNT] = {
#define PIN_ROW(net, port_, number_, mode_, af_, pull_, level_, note) \
    [PIN_##net] = {PORT_##port_, number_, MODE_##mode_, af_, PULL_##pull_, level_},
    PINS(PIN_ROW)
#undef PIN_ROW
};

static void put_bits(reg32 *where, uint32_t width, uint32_t number, uint32_t value) {
    uint32_t mask = (1u << width) - 1u;
    *where = (*where & ~(mask << (width * number))) | value << (width * number);
}

/* Gives every pin its function. The gate is left out: gate.c hands it over once its timer holds it low. */
void pins_start(void) {
    for (uint32_t i = 0; i < PIN_COUNT; i++) {
        if (i != PIN_GATE) {
            pins_set((enum pin)i);
        }
    }
}

/* Gives one pin its function: level and alternate function first, then the mode. */
void pins_set(enum pin pin) {
    const struct row *row = &rows[pin];
    struct gpio *port = GPIO_PORT(row->port);
    uint32_t number = row->number;
    port->BSRR = row->level ? 1u << number : 1u << (number + 16u);
    put_bits(&port->AFR[number >> 3], 4, number & 7u, row->af);
    put_bits(&port->PUPDR, 2, number, row->pull);
    put_bits(&port->OSPEEDR, 2, number, row->mode == MODE_OUTPUT || row->mode == MODE_ALTERNATE ? SPEED_HIGH : 0);
    put_bits(&port->MODER, 2, number, row->mode);
}

bool pins_high(enum pin pin) {
    return (GPIO_PORT(rows[pin].port)->IDR >> rows[pin].number & 1u) != 0;
}

void pins_put(enum pin pin, bool high) {
    GPIO_PORT(rows[pin].port)->BSRR = 1u << (rows[pin].number + (high ? 0u : 16u));
}
