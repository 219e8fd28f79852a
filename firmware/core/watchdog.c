/* The watchdog of the host, and everything else that is due by the clock (docs/protocol.md, Safe state and watchdog). */
#include "core.h"

/* Called with what only a living host sends. */
void watchdog_feed(struct edm_controller *c) {
    c->heard_tick = c->tick;
}

/* The tick at which it trips; NEVER while it does not run. */
int64_t watchdog_tick(const struct edm_controller *c) {
    return c->armed ? c->heard_tick + host_ticks(c, c->settings.watchdog_ticks) : NEVER;
}

/* A limit switch on the way, or the end of a travel: by its speed, and by what the board says of it. */
static void watch_stages(struct edm_controller *c, const struct edm_inputs *inputs) {
    bool travels = c->stages.travels;
    if (inputs->limit_switch && (travels || c->scan.count > 0 || inputs->stage_moves)) {
        states_raise(c, FAULT_STAGE_LIMIT, travels ? c->stages.axis : AXIS_X);
    } else if (stages_arrived(c) && !inputs->stage_moves) {
        stages_stop(c);
        states_enter(c, STATE_ARMED);
        events_emit(c, EVENT_CODE_STAGE_DONE);
    }
}

void edm_watch(struct edm_controller *c) {
    struct edm_inputs inputs;
    uint16_t open = guards_interlocks(c, &inputs);
    watch_stages(c, &inputs);
    if ((open & INTERLOCKS_ESTOP) != 0 && c->state != STATE_ESTOP) {
        states_raise(c, FAULT_ESTOP, open);
    } else if (open != 0 && c->armed) {
        states_raise(c, guards_fault_of(open), open);
    } else if (c->tick >= watchdog_tick(c)) {
        states_raise(c, FAULT_HOST_SILENT, 0);
    }
    events_repeat(c);
}
