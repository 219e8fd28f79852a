/* The operators of the actuator model: plays, rounded plays, creep and lag, their inverse, and the paper's model.
 *
 * The laws and symbols are in edmctl/actuator/operators.py, maxwell.py and electromechanical.py, which declare the
 * same records with ctypes. All numbers are double, and sums are written in one order: the same inputs give the same
 * bytes with every compiler (build with -ffp-contract=off). Callers check lengths and indices, and that time does not
 * run backwards. Nothing here allocates memory. */
#ifndef EDM_OPERATORS_H
#define EDM_OPERATORS_H

#include "../export.h"

#include <stdbool.h>
#include <stdint.h>

/* Parameters: n sharp plays of m pieces, k rounded plays; g of these n + k creep, with j lags each. */
struct bank {
    int64_t n, m, k, g, j;
    const double *thresholds; /* (n,) */
    const double *knots;      /* (n, m + 1) */
    const double *slopes;     /* (n, m) */
    const double *rounded;    /* (k, 5): limit of a rise and of a fall, c, rho, C */
    const double *roundness;  /* (k,): weights of the rounded plays */
    const int64_t *creeping;  /* (g,): plays, from n on rounded ones */
    const double *taus;       /* (j,) */
    const double *weights;    /* (g, j): of the lags */
    double lag_s;             /* of the amplifier */
};

#define ROUNDED 5 /* numbers of a rounded play */
#define FOLLOW 3  /* shares of a lag: of itself, of the start and of the end of a move */

/* State at time t_s: voltage before and behind the amplifier's lag, plays, stops, creep. */
struct memory {
    double *plays, *stops, *lags; /* (n,), (k,), (g, j) */
    double *room;                 /* edm_bank_room doubles to work in */
    double t_s, u_v, lagged_v;
};

/* A straight way of the voltage before the lag: how long it takes, where it begins, and what is behind the lag then. */
struct way {
    double elapsed_s, from_v, lagged_v;
};

/* A time and the voltage behind the lag then. */
struct point {
    double t_s, v;
};

/* One play operator: where it is after the voltage has gone monotonically to u. */
static inline double play(double threshold, double u, double z) {
    if (z < u - threshold) {
        return u - threshold;
    }
    return z > u + threshold ? u + threshold : z;
}

/* Laws of one operator (plays.c, lag.c). */
double edm_hinge(const struct bank *b, int64_t i, int64_t piece, double z);
double edm_bent_um(const struct bank *b, int64_t i, double z);
double edm_stop(const double *rounded, double move, double stop);
double edm_lagged(double lag_s, const struct way *way, double u);
double edm_turn_s(double lag_s, const struct way *way, double u);
double edm_turn_v(const struct way *way, double at_s, double u);
int edm_points(const struct bank *b, const struct memory *s, double t_s, double u, struct point points[2]);

/* Plays and creep of a bank (bank.c). `follow` is (3, j); `before` is the voltage behind the lag of the state. */
void edm_following(const struct bank *b, double elapsed_s, double *follow);
double edm_followed(const struct bank *b, double step_s, double known_s, double *follow);
double edm_rounded_v(const struct bank *b, int64_t i, double u, double stop);
double edm_standing(const struct bank *b, const struct memory *s, double u, int64_t index);
double edm_moved(const struct bank *b, const struct memory *s, double before, double u, int64_t index);
void edm_step(const struct bank *b, struct memory *s, double before, const double *follow, double u);

/* Doubles that a memory's room has. */
EDM_EXPORT int64_t edm_bank_room(const struct bank *b);
/* Advance the state over `count` samples of the voltage; `y_um` receives the displacement. */
EDM_EXPORT void edm_bank_advance(const struct bank *b, struct memory *s, int64_t count, const double *t_s,
                                 const double *u_v, double *y_um);
/* The same, with the features of every sample, (count, n m + k + g columns): bent plays, rounded plays, creep. Lag i
 * of each creeping play adds to its column column_of[i] < columns. */
EDM_EXPORT void edm_bank_features(const struct bank *b, struct memory *s, int64_t count, const double *t_s,
                                  const double *u_v, const int64_t *column_of, int64_t columns, double *features);
/* Advance the state along the voltages in [low_v, high_v] that give `y_um`, into `u_v`. Where none does, the nearer
 * end is taken, and `beyond` is true. */
EDM_EXPORT void edm_bank_solve(const struct bank *b, struct memory *s, int64_t count, const double *t_s,
                               const double *y_um, double low_v, double high_v, double *u_v, bool *beyond);
/* Take k stops along a voltage that goes from turn to turn; they are those at the first. */
EDM_EXPORT void edm_turned_stops(int64_t k, const double *rounded, int64_t count, const double *turns_v,
                                 double *stops);

/* Elasto-slip elements: stiffness and the stretch at which they slip, with their present stretch. */
struct elements {
    int64_t n;
    const double *stiffness, *limits;
    double *stops;
};

/* Change of the position that adds `added` to the load, with a spring `base` that never slips; the state stays. */
double edm_change_for(const struct elements *e, double base, double added);
/* Advance the state by a change of the position, monotone and of any size. */
void edm_move(const struct elements *e, double change);

/* Advance over `count` positions, from position `since`; `loads` receives the load at each. */
EDM_EXPORT void edm_maxwell_loads(const struct elements *e, double base, double since, int64_t count,
                                  const double *positions, double *loads);
/* Advance over `count` loads, from position `since`; `positions` receives each position. */
EDM_EXPORT void edm_maxwell_positions(const struct elements *e, double base, double since, int64_t count,
                                      const double *loads, double *positions);

/* The electromechanical model for one time step. propagator, (2, 4): position and speed from position, speed, force
 * before and force after. remainder: 1/C_r of the block H. */
struct transducer {
    double propagator[8];
    double transformer, capacitance, remainder;
};

/* Position, speed, force on the oscillator, charge. */
struct motion {
    double position, speed, force, charge;
};

/* Advance over voltages and forces on the stacks; the last three receive what comes of it. Elements of H: stiffness
 * is 1/C_i, limits are C_i v_i, stops are charges. */
EDM_EXPORT void edm_transducer_advance(const struct transducer *part, const struct elements *h, struct motion *motion,
                                       int64_t count, const double *u_v, const double *pushes_n, double *positions,
                                       double *charges, double *transducer_v);

#endif
