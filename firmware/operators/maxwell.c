/* Elasto-slip elements in parallel with a plain spring (Goldfarb & Celanovic 1997). */
#include "operators.h"

/* One stop that would be at `stretched` if it did not slip. */
static inline double slipped(double limit, double stretched) {
    return stretched > limit ? limit : stretched < -limit ? -limit : stretched;
}

void edm_move(const struct elements *e, double change) {
    for (int64_t i = 0; i < e->n; i++) {
        e->stops[i] = slipped(e->limits[i], e->stops[i] + change);
    }
}

/* On the way more and more stops slip and none sticks again, so the load is concave in the change upwards and convex
 * downwards: Newton's method from the present state approaches from one side and ends exactly, after as many steps as
 * there are sets of slipping stops in between. */
double edm_change_for(const struct elements *e, double base, double added) {
    double change = 0.0;
    for (int64_t turn = 0; turn < e->n + 2; turn++) {
        double load = base * change, slope = base;
        for (int64_t i = 0; i < e->n; i++) {
            double stretched = e->stops[i] + change;
            load += e->stiffness[i] * (slipped(e->limits[i], stretched) - e->stops[i]);
            if (added > 0.0 ? stretched < e->limits[i] : stretched > -e->limits[i]) {
                slope += e->stiffness[i];
            }
        }
        double further = (added - load) / slope;
        if (change + further == change) {
            break;
        }
        change += further;
    }
    return change;
}

static double load_at(const struct elements *e, double base, double position) {
    double total = base * position;
    for (int64_t i = 0; i < e->n; i++) {
        total += e->stiffness[i] * e->stops[i];
    }
    return total;
}

void edm_maxwell_loads(const struct elements *e, double base, double since, int64_t count, const double *positions,
                       double *loads) {
    double position = since;
    for (int64_t k = 0; k < count; k++) {
        edm_move(e, positions[k] - position);
        position = positions[k];
        loads[k] = load_at(e, base, position);
    }
}

void edm_maxwell_positions(const struct elements *e, double base, double since, int64_t count, const double *loads,
                           double *positions) {
    double position = since;
    for (int64_t k = 0; k < count; k++) {
        double change = edm_change_for(e, base, loads[k] - load_at(e, base, position));
        edm_move(e, change);
        position += change;
        positions[k] = position;
    }
}
