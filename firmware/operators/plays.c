/* One play, bent or rounded. Krasnosel'skii & Pokrovskii 1989; Bouc 1967, Wen 1976. */
#include "operators.h"

#include "../math/elementary.h"

#define STRAIGHT 1e-7 /* a stop unloads along a straight line below this root of its equation's discriminant */

/* How far z has come along one piece of play i; the first piece is open below, the last above. */
double edm_hinge(const struct bank *b, int64_t i, int64_t piece, double z) {
    const double *knots = b->knots + i * (b->m + 1);
    if (piece > 0 && z < knots[piece]) {
        return 0.0;
    }
    if (piece < b->m - 1 && z > knots[piece + 1]) {
        return knots[piece + 1] - knots[piece];
    }
    return z - knots[piece];
}

/* Play i at z, bent: the sum of slope times hinge over its pieces. */
double edm_bent_um(const struct bank *b, int64_t i, double z) {
    const double *knots = b->knots + i * (b->m + 1), *slopes = b->slopes + i * b->m;
    double total = 0.0;
    int64_t last = b->m - 1;
    for (int64_t piece = 0; piece < last; piece++) {
        if (z <= knots[piece + 1]) {
            return total + slopes[piece] * (z - knots[piece]);
        }
        total += slopes[piece] * (knots[piece + 1] - knots[piece]);
    }
    return total + slopes[last] * (z - knots[last]);
}

/* A stop that unloads, at < 0, by `way`: a Riccati equation with constant coefficients, 1 + b s + a s^2, whose moves
 * are fractions of `both` and `slope`. `end` receives the way on which the stop comes to 0; returns 0 beyond it. */
static double unloaded(double limit, double a, double half_b, double way, double at, double *end) {
    double bend = half_b * half_b - a, root = edm_sqrt(__builtin_fabs(bend));
    *end = -at / (1.0 + half_b * at);
    if (root > STRAIGHT) {
        *end = bend > 0.0 ? edm_atanh(root * *end) / root : edm_atan(root * *end) / root;
    }
    if (way >= *end) {
        return 0.0;
    }
    double both = 1.0, slope = way;
    if (root > STRAIGHT) {
        both = bend > 0.0 ? edm_cosh(root * way) : edm_cos(root * way);
        slope = bend > 0.0 ? edm_sinh(root * way) / root : edm_sin(root * way) / root;
    }
    return limit * (at * (both + half_b * slope) + slope) / (both - (half_b + a * at) * slope);
}

/* The stop of a rounded play after the voltage has moved monotonically by `move`. */
double edm_stop(const double *rounded, double move, double stop) {
    if (move == 0.0) {
        return stop;
    }
    double limit = move > 0.0 ? rounded[0] : -rounded[1];
    double c = rounded[2], rho = rounded[3], way = move / limit, at = stop / limit;
    if (at < 0.0) {
        double end, reached = unloaded(limit, rho * c, -0.5 * rho * (1.0 - c), way, at, &end);
        if (way < end) {
            return reached;
        }
        at = 0.0;
        way -= end;
    }
    double left = (1.0 - at) / (1.0 + c * at) * edm_exp(-(1.0 + c) * way);
    return limit * (1.0 - left) / (1.0 + c * left);
}

void edm_turned_stops(int64_t k, const double *rounded, int64_t count, const double *turns_v, double *stops) {
    for (int64_t turn = 1; turn < count; turn++) {
        for (int64_t i = 0; i < k; i++) {
            stops[i] = edm_stop(rounded + ROUNDED * i, turns_v[turn] - turns_v[turn - 1], stops[i]);
        }
    }
}
