/* The piezo actuator and its displacement sensor.
 *
 * Modified Prandtl-Ishlinskii operator with linear creep (class of Kuhnen 2003), a tanh envelope, the amplifier's
 * lag and an output-side mode: richer than any estimator of the project. Constants: edmctl/simulator/unit.py. */
#include "plant.h"

#include "../math/elementary.h"

#define BEND_PER_UM 0.004 /* where over the stroke the bend of the sensor lies [assumed] */
#define BEND_AT 0.8
#define STEPS_PER_V 400.0 /* of the converter: 2.5 mV, about 7 nm of tool travel */
#define DAC_V 0.0025

/* Play operators. Thresholds ascend, so that those that a move drags along are the first ones. */
static double plays(const struct unit *unit, struct plant *p, double u) {
    double sum = p->play_sum_um;
    for (int i = 0; i < PLAYS; i++) {
        double z = p->play_v[i], r = unit->play_threshold_v[i];
        if (z < u - r) {
            p->play_v[i] = u - r;
        } else if (z > u + r) {
            p->play_v[i] = u + r;
        } else {
            break;
        }
        sum += unit->play_um_per_v[i] * (p->play_v[i] - z);
    }
    p->play_sum_um = sum;
    return sum;
}

/* Creep operators: first-order lags behind y, weighted. Two sums at once, because additions wait for each other. */
static double creep(const struct unit *unit, struct plant *p, double y) {
    for (int j = 0; j < CREEP_TERMS; j++) {
        p->creep_um[j] = y + unit->creep_decay[j] * (p->creep_um[j] - y);
    }
    double even = 0.0, odd = 0.0;
    for (int j = 0; j < CREEP_TERMS; j += 2) {
        even += unit->creep_share[j] * p->creep_um[j];
        odd += unit->creep_share[j + 1] * p->creep_um[j + 1];
    }
    return even + odd;
}

/* One millisecond: amplifier lag, plays, envelope (tanh by exp), creep, output-side mode. */
void edm_actuator_tick(const struct unit *unit, struct plant *p, double applied_v) {
    double driven_v = unit->dac_open == 1 ? 0.0 : applied_v * unit->amplifier_gain;
    double u = driven_v + unit->amplifier_decay * (p->amplifier_v - driven_v);
    p->amplifier_v = u;
    double y = plays(unit, p, u);
    y += unit->envelope_um * (1.0 - 2.0 / (edm_exp((y - unit->envelope_centre_um) * unit->envelope_steepness) + 1.0));
    double still = (y + creep(unit, p, y) - unit->actuator_zero_um) * unit->stroke_share;
    double deviation = p->free_z_um - still, velocity = p->mode_velocity_um_s;
    p->free_z_um = still + unit->mode_a11 * deviation + unit->mode_a12 * velocity;
    p->mode_velocity_um_s = unit->mode_a21 * deviation + unit->mode_a22 * velocity;
}

/* Inductive sensor: gain error, bend, drift, random walk, noise. */
double edm_sensor(const struct unit *unit, struct plant *p, int64_t tick, const double *noise) {
    int64_t at = p->noise_at;
    if ((tick & 1023) == 0) {
        p->walk_um += unit->sensor_walk_um * noise[at++];
    }
    p->noise_at = at + 1;
    double z = p->true_z_um, bend = BEND_PER_UM * z - BEND_AT;
    return unit->sensor_gain * z + unit->sensor_bend_um * bend * (1.0 - bend * bend) +
           unit->sensor_drift_um_s * (double)tick * PLANT_TICK_S + p->walk_um + unit->sensor_noise_um * noise[at];
}

/* The actuator alone, a tick per command, with nothing in the tool's way: voltage, free displacement and reading.
 * Commands pass a slew limit, the range and the converter. Returns the last command. `noise` has two numbers a tick. */
double edm_actuator_run(const struct machine *m, int64_t count, const double *command_v, double before_v,
                        double slew_v_s, double highest_v, double *applied_v, double *free_um, double *sensor_um) {
    double v = before_v, step_v = slew_v_s * PLANT_TICK_S;
    for (int64_t i = 0; i < count; i++) {
        v = lesser(v + step_v, greater(v - step_v, command_v[i]));
        v = lesser(highest_v, greater(0.0, v));
        m->drive->actuator_v = (double)(int64_t)(v * STEPS_PER_V + 0.5) * DAC_V; /* v is not negative */
        edm_actuator_tick(m->unit, m->plant, m->drive->actuator_v);
        m->plant->true_z_um = m->plant->free_z_um;
        sensor_um[i] = edm_sensor(m->unit, m->plant, m->readings->tick, m->noise);
        m->readings->tick++;
        applied_v[i] = m->drive->actuator_v;
        free_um[i] = m->plant->free_z_um;
    }
    return v;
}
