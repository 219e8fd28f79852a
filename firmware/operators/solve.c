/* The inverse of a bank: the voltage that gives a displacement.
 *
 * The displacement rises strictly with the voltage from any state, so a bracket always contains the one root. */
#include "operators.h"

#include "../math/elementary.h"
#include <string.h>

/* A displacement is met within this share of the range times the steepest slope of play 0. It is beyond the range by
 * more than this share times the steepest slope of the whole bank, which is more than rounding. */
#define ENOUGH 1e-14
#define ITERATIONS 200 /* bound of the root search; regula falsi needs about six, bisection alone fifty */

/* Displacement after a monotone move from `before` to u, both behind the lag; the state stays. */
static double answer_um(const struct bank *b, const struct memory *s, double before, const double *follow, double u) {
    double total = 0.0;
    for (int64_t i = 0; i < b->n; i++) {
        total += edm_bent_um(b, i, play(b->thresholds[i], u, s->plays[i]));
    }
    for (int64_t i = 0; i < b->k; i++) {
        double stop = edm_stop(b->rounded + ROUNDED * i, u - before, s->stops[i]);
        total += b->roundness[i] * edm_rounded_v(b, i, u, stop);
    }
    for (int64_t g = 0; g < b->g; g++) {
        double start = edm_standing(b, s, before, b->creeping[g]), end = edm_moved(b, s, before, u, b->creeping[g]);
        const double *lag = s->lags + g * b->j, *weight = b->weights + g * b->j;
        for (int64_t i = 0; i < b->j; i++) {
            total += weight[i] * (follow[i] * lag[i] + follow[b->j + i] * start + follow[2 * b->j + i] * end);
        }
    }
    return total;
}

/* One sample: the state before it, shares of the lags for its time, and a second state to try turns with. */
struct sample {
    const struct bank *b;
    const struct memory *s;
    struct way way;
    const double *follow;
    struct memory *trial;
    double *trial_follow;
    double y_um, enough_um, beyond_um;
};

/* How much the displacement is above the wanted one when the voltage before the lag goes straight to u. */
static double error_um(const struct sample *p, double u) {
    const struct bank *b = p->b;
    const struct memory *s = p->s;
    double end_v = edm_lagged(b->lag_s, &p->way, u), at_s = edm_turn_s(b->lag_s, &p->way, u);
    if (!(at_s > 0.0)) {
        return answer_um(b, s, p->way.lagged_v, p->follow, end_v) - p->y_um;
    }
    memcpy(p->trial->plays, s->plays, sizeof(double) * (size_t)b->n);
    memcpy(p->trial->stops, s->stops, sizeof(double) * (size_t)b->k);
    memcpy(p->trial->lags, s->lags, sizeof(double) * (size_t)(b->g * b->j));
    double turn_v = edm_turn_v(&p->way, at_s, u);
    edm_following(b, at_s, p->trial_follow);
    edm_step(b, p->trial, p->way.lagged_v, p->trial_follow, turn_v);
    edm_following(b, p->way.elapsed_s - at_s, p->trial_follow);
    return answer_um(b, p->trial, turn_v, p->trial_follow, end_v) - p->y_um;
}

/* Regula falsi, Illinois variant, until the bracket is as narrow as numbers are. */
static double root_v(const struct sample *p, double low, double high, bool *beyond) {
    double below = error_um(p, low);
    *beyond = below > p->beyond_um;
    if (below >= 0.0) {
        return low;
    }
    double above = error_um(p, high);
    *beyond = above < -p->beyond_um;
    if (above <= 0.0) {
        return high;
    }
    double u = high;
    int side = 0;
    for (int turn = 0; turn < ITERATIONS; turn++) {
        u = high - above * (high - low) / (above - below);
        if (!(low < u && u < high)) {
            u = 0.5 * (low + high);
        }
        if (!(low < u && u < high)) {
            break;
        }
        double error = error_um(p, u);
        if (__builtin_fabs(error) <= p->enough_um) {
            break;
        }
        if (error < 0.0) {
            low = u;
            below = error;
            above *= side < 0 ? 0.5 : 1.0;
            side = -1;
        } else {
            high = u;
            above = error;
            below *= side > 0 ? 0.5 : 1.0;
            side = 1;
        }
    }
    return u;
}

/* Advance the state to the end of a way; `follow` is for its whole time, and is again afterwards. */
static void settle(const struct bank *b, struct memory *s, const struct way *way, double known_s, double *follow,
                   double u) {
    double end_v = edm_lagged(b->lag_s, way, u), at_s = edm_turn_s(b->lag_s, way, u);
    if (at_s > 0.0) {
        double turn_v = edm_turn_v(way, at_s, u);
        edm_following(b, at_s, follow);
        edm_step(b, s, way->lagged_v, follow, turn_v);
        edm_following(b, way->elapsed_s - at_s, follow);
        edm_step(b, s, turn_v, follow, end_v);
        edm_following(b, known_s, follow);
    } else {
        edm_step(b, s, way->lagged_v, follow, end_v);
    }
    s->u_v = u;
    s->lagged_v = end_v;
}

static double steepest(const struct bank *b, int64_t i) {
    double slope = b->slopes[i * b->m];
    for (int64_t piece = 1; piece < b->m; piece++) {
        slope = b->slopes[i * b->m + piece] > slope ? b->slopes[i * b->m + piece] : slope;
    }
    return slope;
}

/* The steepest that the displacement can rise. */
static double steepest_um_per_v(const struct bank *b) {
    double total = 0.0;
    for (int64_t i = 0; i < b->n; i++) {
        total += steepest(b, i);
    }
    for (int64_t i = 0; i < b->k; i++) {
        total += b->roundness[i] * edm_rounded_v(b, i, 1.0, 0.0);
    }
    for (int64_t g = 0; g < b->g; g++) {
        double slope = b->creeping[g] < b->n ? 1.0 : edm_rounded_v(b, b->creeping[g] - b->n, 1.0, 0.0);
        for (int64_t i = 0; i < b->j; i++) {
            total += b->weights[g * b->j + i] * slope;
        }
    }
    return total;
}

void edm_bank_solve(const struct bank *b, struct memory *s, int64_t count, const double *t_s, const double *y_um,
                    double low_v, double high_v, double *u_v, bool *beyond) {
    double *follow = s->room, *trial_follow = follow + FOLLOW * b->j, *rest = trial_follow + FOLLOW * b->j;
    struct memory trial = {.plays = rest, .stops = rest + b->n, .lags = rest + b->n + b->k};
    double share_v = ENOUGH * (high_v - low_v), known_s = 0.0;
    double enough_um = share_v * steepest(b, 0), beyond_um = share_v * steepest_um_per_v(b);
    edm_following(b, known_s, follow);
    for (int64_t k = 0; k < count; k++) {
        struct way way = {t_s[k] - s->t_s, s->u_v, s->lagged_v};
        known_s = edm_followed(b, way.elapsed_s, known_s, follow);
        struct sample sample = {b, s, way, follow, &trial, trial_follow, y_um[k], enough_um, beyond_um};
        bool is_still = b->lag_s > 0.0 && way.elapsed_s <= 0.0; /* in no time nothing comes through a lag */
        double low = is_still ? s->u_v : low_v, high = is_still ? s->u_v : high_v;
        u_v[k] = root_v(&sample, low, high, &beyond[k]);
        settle(b, s, &way, known_s, follow, u_v[k]);
        s->t_s = t_s[k];
    }
}
