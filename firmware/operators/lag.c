/* The amplifier's lag, u_f' = (u - u_f) / tau, exact for a voltage that goes straight to u. */
#include "operators.h"

#include "../math/elementary.h"

/* Voltage behind the lag at the end of the way. */
double edm_lagged(double lag_s, const struct way *way, double u) {
    if (lag_s == 0.0) {
        return u;
    }
    double share = way->elapsed_s / lag_s;
    if (share == 0.0) {
        return way->lagged_v;
    }
    double stays = edm_exp(-share), mean = -edm_expm1(-share) / share;
    return stays * way->lagged_v + (mean - stays) * way->from_v + (1.0 - mean) * u;
}

/* When on the way the voltage behind the lag turns, where it crosses the one before the lag; 0 where it does not. */
double edm_turn_s(double lag_s, const struct way *way, double u) {
    double behind = way->lagged_v - way->from_v, rise = u - way->from_v;
    if (lag_s == 0.0 || way->elapsed_s <= 0.0 || behind * rise <= 0.0) {
        return 0.0;
    }
    double at_s = lag_s * edm_log1p(behind * way->elapsed_s / (rise * lag_s));
    return at_s < way->elapsed_s ? at_s : 0.0;
}

/* Voltage at that time, the same before and behind the lag. */
double edm_turn_v(const struct way *way, double at_s, double u) {
    return way->from_v + (u - way->from_v) * (at_s / way->elapsed_s);
}

/* Where the voltage behind the lag turns on the way to a sample, if it does, and where it ends; returns the index of
 * the end. */
int edm_points(const struct bank *b, const struct memory *s, double t_s, double u, struct point points[2]) {
    struct way way = {t_s - s->t_s, s->u_v, s->lagged_v};
    double at_s = edm_turn_s(b->lag_s, &way, u);
    int last = 0;
    if (at_s > 0.0) {
        points[last++] = (struct point){s->t_s + at_s, edm_turn_v(&way, at_s, u)};
    }
    points[last] = (struct point){t_s, edm_lagged(b->lag_s, &way, u)};
    return last;
}
