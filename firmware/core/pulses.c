/* Classes of pulses, by what is seen of them: ignition delay, plateau voltage, current (docs/protocol.md, Parameters). */
#include "core.h"

#define MISREAD_HIGH R(0.97) /* of the open voltage: more is none that a discharge has */
#define MISREAD_LOW R(0.5)   /* of the open voltage: less is none that an open gap has */

/* Gives a pulse its class, and keeps the runs of arcs and of voltages that cannot be, one that is no number among them. */
static uint8_t class_of(struct edm_controller *c, int i) {
    const struct edm_settings *s = &c->settings;
    struct edm_gap *gap = &c->gap;
    real seen_v = c->readings.plateau_v[i];
    if (c->readings.discharge_us[i] <= 0) {
        if (!(seen_v >= MISREAD_LOW * s->open_v)) {
            gap->misreads++;
        }
        gap->arc_run = 0;
        return PULSE_CLASS_OPEN;
    }
    if (seen_v < s->short_v) {
        gap->arc_run = 0;
        return PULSE_CLASS_SHORT;
    }
    if (seen_v < s->arc_v && !(c->readings.delay_us[i] >= s->arc_delay_us)) {
        gap->arc_run++;
        return PULSE_CLASS_ARC;
    }
    /* Arcs and shorts say neither that the sensor is right nor that it is wrong. */
    gap->misreads = seen_v <= MISREAD_HIGH * s->open_v ? 0 : gap->misreads + 1;
    gap->arc_run = 0;
    return PULSE_CLASS_NORMAL;
}

/* Counts and logs every pulse of the tick; returns how many were shorts. */
int pulses_judge(struct edm_controller *c) {
    struct edm_gap *gap = &c->gap;
    uint8_t classes[EDM_MOST_PULSES];
    memset(&gap->tick, 0, sizeof gap->tick);
    for (int i = 0; i < c->readings.pulses; i++) {
        classes[i] = class_of(c, i);
        gap->tick.of[classes[i]]++;
    }
    if (c->telemetry.log != PULSE_LOG_OFF) {
        telemetry_log_pulses(c, classes);
    }
    waveforms_note_pulses(c);
    for (int k = 0; k < 4; k++) {
        c->telemetry.counts.of[k] = (uint16_t)(c->telemetry.counts.of[k] + gap->tick.of[k]);
    }
    gap->pulse_no += c->readings.pulses;
    return gap->tick.of[PULSE_CLASS_SHORT];
}
