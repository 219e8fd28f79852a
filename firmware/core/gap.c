/* The gap as the servo sees it: filtered mean voltage, shorts, lost sparks, and the faults 3001 to 3005 of it. */
#include "core.h"

#define GAP_MOST_V R(1000.0) /* beyond it no gap voltage is one */
#define CHARGE_MOST_UC R(1e6) /* beyond it, either way, none is the charge of a millisecond */
#define CURRENT_MOST_A R(1000.0) /* below minus this no current is one */
#define CHARGE_NOISE_UC R(2.0) /* 2 mA for the millisecond: below minus this it is no noise */
#define PAIR_NS 10000000     /* and ten periods: sparks no farther apart are no chance of an open gap */
#define PAIR_PERIODS 10
#define SPARK_STEP_UM R(5.0) /* no spark is farther beyond the last one, and where the tool slowly reads to be */
#define SILENCE_NS 100000000 /* beyond a period, in which pulses must come while they are on */

static bool charge_failed(const struct edm_readings *readings) {
    return !(magnitude(readings->charge_uc) <= CHARGE_MOST_UC);
}

/* Charge of the millisecond as it is told: 0 for a reading that has failed. */
real gap_charge(const struct edm_controller *c) {
    return charge_failed(&c->readings) ? 0 : c->readings.charge_uc;
}

/* Whether currents of a millisecond with pulses are none that a sound generator makes: too great, going on into the off-time,
 * or of a sensor that is turned round and sees neither. */
static bool is_generator_wrong(const struct edm_controller *c) {
    const struct edm_readings *r = &c->readings;
    /* Current over voltage drop in a discharge is the conductance that the generator really has. */
    bool over = !(magnitude(r->generator_siemens) <= c->settings.over_current * c->settings.nominal_siemens);
    bool goes_on = !(r->off_time_a <= 0 && r->off_time_a >= -CURRENT_MOST_A);
    return over || goes_on || charge_failed(r) || r->charge_uc < -CHARGE_NOISE_UC;
}

/* A millisecond with sparks: with others shortly before it they are no chance, and the count of open ones begins anew where
 * they are. The slow reading lags behind a tool that comes back from a jump; a single fast one may be anything. */
static void note_sparks(struct edm_controller *c) {
    struct edm_gap *gap = &c->gap;
    int64_t shortly_ns = PAIR_NS + PAIR_PERIODS * (int64_t)c->settings.pulse_period_ns;
    bool again = (int64_t)gap->sparkless_ticks * TICK_NS <= shortly_ns;
    gap->sparkless_ticks = 0;
    if (!again) {
        return;
    }
    gap->open_ticks = 0;
    if (gap->displacement_um < DISPLACEMENT_FAILED_UM) {
        real farthest_um = most(gap->slow_displacement_um, gap->last_spark_um) + SPARK_STEP_UM;
        gap->last_spark_um = least(gap->displacement_um, farthest_um);
    }
}

/* Feeds the low-pass with this tick's mean gap voltage and keeps the counters of the discharge faults. Between slow pulses
 * ticks pass without one; the next pulse then speaks for all of them. */
int gap_measure(struct edm_controller *c, int shorts) {
    const struct edm_settings *s = &c->settings;
    const struct edm_readings *readings = &c->readings;
    struct edm_gap *gap = &c->gap;
    uint32_t elapsed = gap->silent_ticks + 1;
    gap->silent_ticks = 0;
    real mean_v = readings->gap_v;
    if (!(magnitude(mean_v) <= GAP_MOST_V)) {
        return FAULT_GAP_SENSOR;
    }
    gap->tick_gap_v = mean_v;
    gap->gap_v = mean_v + (gap->gap_v - mean_v) * power_of(R(1.0) - s->filter_alpha, elapsed);
    gap->shorted = shorts == readings->pulses;
    gap->short_ticks = gap->shorted ? gap->short_ticks + elapsed : 0;
    gap->sparkless_ticks += elapsed;
    if (gap->tick.of[PULSE_CLASS_OPEN] == readings->pulses) {
        /* Open pulses on the way back from a retraction are no loss: only those at the last spark count. */
        if (gap->slow_displacement_um >= gap->last_spark_um - R(1.0)) {
            gap->open_ticks += elapsed;
        }
    } else {
        note_sparks(c);
    }
    if (gap->misreads >= s->misreads_max) {
        return FAULT_GAP_SENSOR;
    }
    if (is_generator_wrong(c)) {
        return FAULT_GEN_FAULT;
    }
    if (gap->short_ticks > s->short_ticks_max) {
        return FAULT_SHORT_STUCK;
    }
    return gap->arc_run >= s->arc_run_max ? FAULT_ARC_BURN : NOTHING;
}

/* Where a way begins that must not get too long: with a sensor that has failed, as far back as can be. */
real gap_place(const struct edm_controller *c) {
    real place_um = c->gap.slow_displacement_um;
    return place_um < DISPLACEMENT_FAILED_UM ? place_um : -DISPLACEMENT_FAILED_UM;
}

/* Pulses that come although the gate is shut; those that reach a touch are the mode switch's (touch.c). */
static bool is_stray(const struct edm_controller *c) {
    bool touches = c->motion.mode >= TOUCH_FAST && c->motion.mode <= TOUCH_BACK;
    return c->readings.pulses > 0 || (c->readings.stray_pulses > 0 && !touches);
}

/* A millisecond without pulses, in which the gap sensor should read nothing. Pulses that come all the same are those of a
 * generator that does not switch off; in the first such millisecond the gate may have been shut. */
int gap_rest(struct edm_controller *c) {
    struct edm_gap *gap = &c->gap;
    memset(&gap->tick, 0, sizeof gap->tick);
    gap->tick_gap_v = 0;
    if (c->readings.gap_v >= 0) {
        gap->tick_gap_v = gap->gap_v = least(c->readings.gap_v, GAP_MOST_V);
    }
    gap->stray_ticks = c->armed && is_stray(c) ? gap->stray_ticks + 1 : 0;
    return gap->stray_ticks > 1 ? FAULT_GEN_FAULT : NOTHING;
}

/* A millisecond with the generator on in which no pulse began: between slow pulses one like others, else it is dead. */
int gap_wait(struct edm_controller *c) {
    struct edm_gap *gap = &c->gap;
    memset(&gap->tick, 0, sizeof gap->tick);
    gap->silent_ticks++;
    bool dead = (int64_t)gap->silent_ticks * TICK_NS > SILENCE_NS + (int64_t)c->settings.pulse_period_ns;
    return dead ? FAULT_NO_SPARK : NOTHING;
}
