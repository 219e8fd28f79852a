/* A bank of plays with creep behind some of them, sample by sample. Prandtl-Ishlinskii operator with bent and rounded
 * plays; creep is linear (class of Kuhnen 2003). */
#include "operators.h"

#include "../math/elementary.h"

#define SAME_STEP 1e-9 /* steps of a clock differ by its rounding, which is no reason to calculate every lag anew */

/* How each lag follows a straight move of `elapsed_s`; the shares sum to 1. In no time a lag stays where it is. */
void edm_following(const struct bank *b, double elapsed_s, double *follow) {
    for (int64_t i = 0; i < b->j; i++) {
        double share = elapsed_s / b->taus[i], stays = edm_exp(-share);
        double mean = share > 0.0 ? -edm_expm1(-share) / share : 1.0;
        follow[i] = stays;
        follow[b->j + i] = mean - stays;
        follow[2 * b->j + i] = 1.0 - mean;
    }
}

/* Bring `follow`, which is for moves of `known_s`, to moves of `step_s`; returns the time that it is for now. */
double edm_followed(const struct bank *b, double step_s, double known_s, double *follow) {
    if (__builtin_fabs(step_s - known_s) > SAME_STEP * known_s) {
        edm_following(b, step_s, follow);
        return step_s;
    }
    return known_s;
}

/* Where rounded play i is, C u - s. */
double edm_rounded_v(const struct bank *b, int64_t i, double u, double stop) {
    return b->rounded[ROUNDED * i + 4] * u - stop;
}

/* Where a play is; from n on a rounded one. */
double edm_standing(const struct bank *b, const struct memory *s, double u, int64_t index) {
    return index < b->n ? s->plays[index] : edm_rounded_v(b, index - b->n, u, s->stops[index - b->n]);
}

/* Where it is after a monotone move; the state stays. */
double edm_moved(const struct bank *b, const struct memory *s, double before, double u, int64_t index) {
    if (index < b->n) {
        return play(b->thresholds[index], u, s->plays[index]);
    }
    int64_t i = index - b->n;
    return edm_rounded_v(b, i, u, edm_stop(b->rounded + ROUNDED * i, u - before, s->stops[i]));
}

/* Advance the state to u. */
void edm_step(const struct bank *b, struct memory *s, double before, const double *follow, double u) {
    for (int64_t g = 0; g < b->g; g++) {
        double start = edm_standing(b, s, before, b->creeping[g]), end = edm_moved(b, s, before, u, b->creeping[g]);
        double *lag = s->lags + g * b->j;
        for (int64_t i = 0; i < b->j; i++) {
            lag[i] = follow[i] * lag[i] + follow[b->j + i] * start + follow[2 * b->j + i] * end;
        }
    }
    for (int64_t i = 0; i < b->n; i++) {
        s->plays[i] = play(b->thresholds[i], u, s->plays[i]);
    }
    for (int64_t i = 0; i < b->k; i++) {
        s->stops[i] = edm_stop(b->rounded + ROUNDED * i, u - before, s->stops[i]);
    }
}

int64_t edm_bank_room(const struct bank *b) {
    return b->j * 2 * FOLLOW + b->n + b->k + b->g * b->j;
}

/* Creep after a move to u. A sum for each play, because additions wait for each other. */
static double creep_um(const struct bank *b, struct memory *s, double before, const double *follow, double u) {
    double total = 0.0;
    for (int64_t g = 0; g < b->g; g++) {
        double start = edm_standing(b, s, before, b->creeping[g]), end = edm_moved(b, s, before, u, b->creeping[g]);
        double *lag = s->lags + g * b->j, own = 0.0;
        const double *weight = b->weights + g * b->j;
        for (int64_t i = 0; i < b->j; i++) {
            lag[i] = follow[i] * lag[i] + (follow[b->j + i] * start + follow[2 * b->j + i] * end);
        }
        for (int64_t i = 0; i < b->j; i++) {
            own += weight[i] * lag[i];
        }
        total += own;
    }
    return total;
}

/* Advance the state from `before` to u, both behind the lag; returns the displacement. Most steps move few of the
 * plays: the others keep their part of the sum, `parts`, (n,). */
static double advanced_um(const struct bank *b, struct memory *s, double before, const double *follow, double *parts,
                          double u) {
    double creep = creep_um(b, s, before, follow, u), total = 0.0;
    for (int64_t i = 0; i < b->n; i++) {
        double z = play(b->thresholds[i], u, s->plays[i]);
        if (z != s->plays[i]) {
            s->plays[i] = z;
            parts[i] = edm_bent_um(b, i, z);
        }
        total += parts[i];
    }
    for (int64_t i = 0; i < b->k; i++) {
        s->stops[i] = edm_stop(b->rounded + ROUNDED * i, u - before, s->stops[i]);
        total += b->roundness[i] * edm_rounded_v(b, i, u, s->stops[i]);
    }
    return total + creep;
}

void edm_bank_advance(const struct bank *b, struct memory *s, int64_t count, const double *t_s, const double *u_v,
                      double *y_um) {
    double *follow = s->room, *parts = follow + FOLLOW * b->j, known_s = 0.0;
    for (int64_t i = 0; i < b->n; i++) {
        parts[i] = edm_bent_um(b, i, s->plays[i]);
    }
    edm_following(b, known_s, follow);
    for (int64_t k = 0; k < count; k++) {
        struct point points[2];
        int last = edm_points(b, s, t_s[k], u_v[k], points);
        for (int p = 0; p <= last; p++) {
            known_s = edm_followed(b, points[p].t_s - s->t_s, known_s, follow);
            y_um[k] = advanced_um(b, s, s->lagged_v, follow, parts, points[p].v);
            s->t_s = points[p].t_s;
            s->lagged_v = points[p].v;
        }
        s->u_v = u_v[k];
    }
}

/* Features of the state as it is, into one row. */
static void describe(const struct bank *b, const struct memory *s, const int64_t *column_of, int64_t columns,
                     double *row) {
    for (int64_t i = 0; i < b->n; i++) {
        for (int64_t piece = 0; piece < b->m; piece++) {
            *row++ = edm_hinge(b, i, piece, s->plays[i]);
        }
    }
    for (int64_t i = 0; i < b->k; i++) {
        *row++ = edm_rounded_v(b, i, s->lagged_v, s->stops[i]);
    }
    for (int64_t g = 0; g < b->g; g++, row += columns) {
        for (int64_t c = 0; c < columns; c++) {
            row[c] = 0.0;
        }
        for (int64_t i = 0; i < b->j; i++) {
            row[column_of[i]] += s->lags[g * b->j + i];
        }
    }
}

void edm_bank_features(const struct bank *b, struct memory *s, int64_t count, const double *t_s, const double *u_v,
                       const int64_t *column_of, int64_t columns, double *features) {
    int64_t width = b->n * b->m + b->k + b->g * columns;
    double *follow = s->room, known_s = 0.0;
    edm_following(b, known_s, follow);
    for (int64_t k = 0; k < count; k++) {
        struct point points[2];
        int last = edm_points(b, s, t_s[k], u_v[k], points);
        for (int p = 0; p <= last; p++) {
            known_s = edm_followed(b, points[p].t_s - s->t_s, known_s, follow);
            edm_step(b, s, s->lagged_v, follow, points[p].v);
            s->t_s = points[p].t_s;
            s->lagged_v = points[p].v;
        }
        s->u_v = u_v[k];
        describe(b, s, column_of, columns, features + k * width);
    }
}
