/* Every pin of the board: one row each, from which pins.c sets the ports and a script makes the table of the guide.
 * PIN(net, port, pin, mode, alternate function, pull, first level, note)
 * mode: INPUT, OUTPUT, ALTERNATE, ANALOG; pull: NONE, UP, DOWN; first level: what an output drives from the start.
 * "external pull-down" and "external pull-up" in a note: a resistor outside the chip holds the level while the pin floats,
 * in a reset and until pins_start. Alternate functions: data sheet of the STM32F427/429, table 12. */
#ifndef PINS_H
#define PINS_H

/* clang-format off */
#define PINS(PIN) \
    PIN(GATE,           E,  9, ALTERNATE, 1, NONE, 0, "TIM1_CH1; gate of the generator: high = on; external pull-down") \
    PIN(BREAK_CHAIN,    E, 15, ALTERNATE, 1, DOWN, 0, "TIM1_BKIN; over-current comparator, emergency stop and door in series: high = healthy") \
    PIN(DISCHARGE_END,  E,  7, ALTERNATE, 1, DOWN, 0, "TIM1_ETR; high ends an isopulse; wired to DISCHARGE_TIMER") \
    PIN(IGNITION,       A,  0, ALTERNATE, 1, DOWN, 0, "TIM2_CH1; comparator: high while current flows") \
    PIN(IGNITION_TIMER, C,  6, ALTERNATE, 2, DOWN, 0, "TIM3_CH1; the same net as IGNITION") \
    PIN(DISCHARGE_TIMER, C, 7, ALTERNATE, 2, NONE, 0, "TIM3_CH2; high after the discharge time of an isopulse") \
    PIN(GATE_SENSE,     A,  3, ALTERNATE, 2, DOWN, 0, "TIM5_CH4; output of the gate driver, read back: high = on") \
    PIN(GAP_VOLTAGE,    C,  0, ANALOG,    0, NONE, 0, "ADC1_IN10; 0 to 3.3 V = 0 to 330 V") \
    PIN(GAP_CURRENT,    C,  3, ANALOG,    0, NONE, 0, "ADC2_IN13; 0 to 3.3 V = 0 to 12 A") \
    PIN(MONITOR,        F,  3, ANALOG,    0, NONE, 0, "ADC3_IN9; actuator voltage: 0 to 3.3 V = -5 to 165 V") \
    PIN(FLOW,           F,  4, ANALOG,    0, NONE, 0, "ADC3_IN14; dielectric: 0 to 3.3 V = 0 to 5 l/min") \
    PIN(DISPLACEMENT,   F,  5, ANALOG,    0, NONE, 0, "ADC3_IN15; 0 to 3.3 V = -50 to 450 um") \
    PIN(TEMPERATURE,    F, 10, ANALOG,    0, NONE, 0, "ADC3_IN8; dielectric: 0 to 3.3 V = 0 to 100 C") \
    PIN(OPEN_VOLTAGE,   A,  4, ANALOG,    0, NONE, 0, "DAC_OUT1; open voltage: 0 to 3.3 V = 0 to 330 V; external pull-down") \
    PIN(PEAK_CURRENT,   A,  5, ANALOG,    0, NONE, 0, "DAC_OUT2; peak current: 0 to 3.3 V = 0 to 12 A; external pull-down") \
    PIN(DAC_CLOCK,      E,  2, ALTERNATE, 5, NONE, 0, "SPI4_SCK; converter of the actuator") \
    PIN(DAC_DATA,       E,  6, ALTERNATE, 5, NONE, 0, "SPI4_MOSI; 16 bits, most significant first, 2.5 mV each") \
    PIN(DAC_SELECT,     E,  4, OUTPUT,    0, NONE, 1, "low = selected; external pull-up") \
    PIN(CONTACT,        F, 13, INPUT,     0, DOWN, 0, "contact circuit: high = closed") \
    PIN(MODE,           F, 14, OUTPUT,    0, NONE, 0, "high = generator at the gap, low = contact circuit; external pull-down") \
    PIN(ALIVE,          F, 15, OUTPUT,    0, NONE, 0, "toggles every millisecond; a charge pump makes the high-voltage enable of it; external pull-down") \
    PIN(ESTOP,          G,  0, INPUT,     0, DOWN, 0, "emergency stop: high = released") \
    PIN(DOOR,           G,  1, INPUT,     0, DOWN, 0, "door: high = closed") \
    PIN(HV_SUPPLY,      G,  2, INPUT,     0, DOWN, 0, "high-voltage supply: high = good") \
    PIN(LEVEL,          G,  3, INPUT,     0, DOWN, 0, "dielectric level: high = good") \
    PIN(LIMITS,         G,  4, INPUT,     0, DOWN, 0, "limit switches of the stages in series: high = none closed") \
    PIN(STEP_X,         F,  6, ALTERNATE, 3, NONE, 0, "TIM10_CH1; a step at each rising edge; external pull-down") \
    PIN(STEP_Y,         F,  7, ALTERNATE, 3, NONE, 0, "TIM11_CH1; a step at each rising edge; external pull-down") \
    PIN(STEP_THETA,     F,  8, ALTERNATE, 9, NONE, 0, "TIM13_CH1; a step at each rising edge; external pull-down") \
    PIN(DIRECTION_X,    F,  0, OUTPUT,    0, NONE, 0, "high = towards plus; external pull-down") \
    PIN(DIRECTION_Y,    F,  1, OUTPUT,    0, NONE, 0, "high = towards plus; external pull-down") \
    PIN(DIRECTION_THETA, F, 2, OUTPUT,    0, NONE, 0, "high = towards plus; external pull-down") \
    PIN(LINE_OUT,       D,  8, ALTERNATE, 7, NONE, 0, "USART3_TX; serial port of the ST-LINK") \
    PIN(LINE_IN,        D,  9, ALTERNATE, 7, UP,   0, "USART3_RX; serial port of the ST-LINK")
/* clang-format on */

enum pin {
#define PIN_NAME(net, port, number, mode, af, pull, level, note) PIN_##net,
    PINS(PIN_NAME)
#undef PIN_NAME
    PIN_COUNT,
};

#endif
