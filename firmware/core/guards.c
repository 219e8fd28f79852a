/* What is watched beside the motions: interlocks, a noisy line, the monitor of the amplifier (docs/protocol.md, Faults). */
#include "core.h"

#define NOISE_TICKS 1000
#define FLOW_MOST_LPM R(1000.0) /* beyond these a reading has failed */
#define COLDEST_C R(-100.0)

/* Interlocks bits of the inputs that forbid machining now; `inputs` is what was read. What is no number forbids it. */
uint16_t guards_interlocks(struct edm_controller *c, struct edm_inputs *inputs) {
    const struct edm_settings *s = &c->settings;
    hal_inputs(c->board, inputs);
    int bits = inputs->estop ? INTERLOCKS_ESTOP : 0;
    bits |= inputs->door_open ? INTERLOCKS_DOOR : 0;
    bits |= inputs->hv_supply_ok ? 0 : INTERLOCKS_HV_SUPPLY;
    if (s->dielectric_required) {
        bits |= inputs->level_ok ? 0 : INTERLOCKS_DIELECTRIC_LEVEL;
        bits |= inputs->flow_lpm >= s->flow_min_lpm && inputs->flow_lpm <= FLOW_MOST_LPM ? 0 : INTERLOCKS_DIELECTRIC_FLOW;
        bits |= inputs->temperature_c <= s->temperature_max_c && inputs->temperature_c >= COLDEST_C ? 0 : INTERLOCKS_DIELECTRIC_HOT;
    }
    return (uint16_t)bits;
}

/* The fault for open interlocks; the gravest where there are several. */
uint16_t guards_fault_of(uint16_t interlocks) {
    if ((interlocks & INTERLOCKS_ESTOP) != 0) {
        return FAULT_ESTOP;
    }
    if ((interlocks & INTERLOCKS_DOOR) != 0) {
        return FAULT_DOOR;
    }
    return (interlocks & INTERLOCKS_HV_SUPPLY) != 0 ? FAULT_HV_SUPPLY : FAULT_DIELECTRIC;
}

/* Whether, since the last look, bad frames have come and bad_frames of them within a second, while armed. */
bool guards_too_noisy(struct edm_controller *c) {
    struct edm_guards *g = &c->guards;
    uint32_t new = c->receiver.bad - g->bad_seen;
    g->bad_seen = c->receiver.bad;
    if (!c->armed) {
        g->bad_count = 0;
        return false;
    }
    for (uint32_t i = 0; i < new && i < BAD_FRAMES_MOST; i++) {
        g->bad_ticks[g->bad_at] = c->tick;
        g->bad_at = (uint16_t)((g->bad_at + 1) % BAD_FRAMES_MOST);
        g->bad_count = (uint16_t)(g->bad_count < BAD_FRAMES_MOST ? g->bad_count + 1 : BAD_FRAMES_MOST);
    }
    int64_t before = c->tick - host_ticks(c, NOISE_TICKS);
    while (g->bad_count > 0 &&
           g->bad_ticks[(g->bad_at + BAD_FRAMES_MOST - g->bad_count) % BAD_FRAMES_MOST] <= before) {
        g->bad_count--;
    }
    return new > 0 && g->bad_count >= c->settings.bad_frames;
}

/* Looks at the voltage monitor of the amplifier: in its range (fault 2003), and near the command (fault 2002)? */
int guards_monitor(struct edm_controller *c) {
    const struct edm_settings *s = &c->settings;
    struct edm_guards *g = &c->guards;
    real monitor_v = c->readings.monitor_v;
    if (!(monitor_v <= s->monitor_max_v && monitor_v >= s->monitor_min_v)) {
        return FAULT_PIEZO_OV;
    }
    if (magnitude(c->drive.actuator_v - monitor_v) > s->track_v) {
        g->track_ticks = g->track_at == c->tick - 1 ? g->track_ticks + 1 : 1;
        g->track_at = c->tick;
        if (g->track_ticks >= s->track_ticks_max) {
            return FAULT_PIEZO_TRACK;
        }
    }
    return NOTHING;
}
