/* Contact, interlocks, slow readings, the mode switch, and the pin that says that the program lives. */
#include "board.h"

bool inputs_contact(void) {
    return pins_high(PIN_CONTACT);
}

void hal_inputs(void *board, struct edm_inputs *inputs) {
    (void)board;
    inputs->estop = !pins_high(PIN_ESTOP);
    inputs->door_open = !pins_high(PIN_DOOR);
    inputs->hv_supply_ok = pins_high(PIN_HV_SUPPLY);
    inputs->level_ok = pins_high(PIN_LEVEL);
    inputs->limit_switch = !pins_high(PIN_LIMITS);
    inputs->stage_moves = stages_move();
    inputs->flow_lpm = sampling_slow(SLOW_FLOW);
    inputs->temperature_c = sampling_slow(SLOW_TEMPERATURE);
    inputs->monitor_v = sampling_slow(SLOW_MONITOR);
}

/* The generator at the gap, or the contact circuit. */
void inputs_put_mode(bool generator) {
    pins_put(PIN_MODE, generator);
}

void inputs_toggle_alive(void) {
    static bool high;
    high = !high;
    pins_put(PIN_ALIVE, high);
}
