/* The electromechanical model of Muralidhara et al. 2009, §2.1: charge drives an oscillator behind the block H. */
#include "operators.h"

/* The oscillator is solved exactly for a force that goes straight. Its displacement at the next sample is a straight
 * line over the charge there, so one equation gives charge, displacement and hysteresis, stable for any time step. */
void edm_transducer_advance(const struct transducer *part, const struct elements *h, struct motion *motion,
                            int64_t count, const double *u_v, const double *pushes_n, double *positions,
                            double *charges, double *transducer_v) {
    const double *to_position = part->propagator, *to_speed = part->propagator + 4;
    double transformer = part->transformer, capacitance = part->capacitance, drive = transformer / capacitance;
    double base = (1.0 - transformer * to_position[3] * drive) / capacitance + part->remainder;
    struct motion now = *motion;
    for (int64_t k = 0; k < count; k++) {
        double coasting = to_position[0] * now.position + to_position[1] * now.speed + to_position[2] * now.force;
        double reached = coasting + to_position[3] * (drive * now.charge - pushes_n[k]);
        double load = (now.charge - transformer * reached) / capacitance + part->remainder * now.charge;
        for (int64_t i = 0; i < h->n; i++) {
            load += h->stiffness[i] * h->stops[i];
        }
        double change = edm_change_for(h, base, u_v[k] - load);
        edm_move(h, change);
        now.charge += change;
        double force = drive * now.charge - pushes_n[k];
        now.speed = to_speed[0] * now.position + to_speed[1] * now.speed + to_speed[2] * now.force +
                    to_speed[3] * force;
        now.position = coasting + to_position[3] * force;
        now.force = force;
        positions[k] = now.position;
        charges[k] = now.charge;
        transducer_v[k] = (now.charge - transformer * now.position) / capacitance;
    }
    *motion = now;
}
