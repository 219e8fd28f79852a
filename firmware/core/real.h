/* Numbers of the core. `real` is float on a board; as double the core gives, bit for bit, what the virtual controller
 * gives (build with -ffp-contract=off). Nothing here needs a math library. */
#ifndef EDM_REAL_H
#define EDM_REAL_H

#include <stdbool.h>
#include <stdint.h>

#ifdef EDM_REAL_DOUBLE
typedef double real;
#else
typedef float real;
#endif

#define R(x) ((real)(x))

static inline real least(real a, real b) {
    return b < a ? b : a;
}

static inline real most(real a, real b) {
    return b > a ? b : a;
}

static inline real magnitude(real x) {
    return x < 0 ? -x : x;
}

/* x within both signs of a limit; 0 for what is no number. */
static inline real within(real x, real limit) {
    if (!(x > -limit)) {
        return x <= -limit ? -limit : 0;
    }
    return x < limit ? x : limit;
}

/* The greatest whole number that is not above x; |x| below 2^31. */
static inline int32_t floor_of(real x) {
    int32_t whole = (int32_t)x;
    return (real)whole > x ? whole - 1 : whole;
}

/* The least whole number that is not below x; |x| below 2^62. */
static inline int64_t ceiling_of(real x) {
    int64_t whole = (int64_t)x;
    return (real)whole < x ? whole + 1 : whole;
}

/* What the rest behind a whole number adds to it: the nearest is meant, the even one of two. */
static inline int32_t step_for(real rest, bool is_odd) {
    if (rest > R(0.5) || (rest == R(0.5) && is_odd)) {
        return 1;
    }
    return rest < R(-0.5) || (rest == R(-0.5) && is_odd) ? -1 : 0;
}

/* The nearest whole number, the even one of two; |x| below 2^62. */
static inline int64_t nearest(real x) {
    if (magnitude(x) < R(2e9)) { /* 32 bits are converted by one instruction, 64 by a function that is not called for these */
        int32_t whole = (int32_t)x;
        return whole + step_for(x - (real)whole, (whole & 1) != 0);
    }
    int64_t whole = (int64_t)x;
    return whole + step_for(x - (real)whole, (whole & 1) != 0);
}

/* A sum with one step more. Of a step that is small beside the sum float loses much or all; that is kept for the next one.
 * In double nothing is, so that the sums are those of the virtual controller. */
static inline real added(real sum, real step, real *rest) {
#ifdef EDM_REAL_DOUBLE
    (void)rest;
    return sum + step;
#else
    real whole = step + *rest;
    real now = sum + whole;
    *rest = whole - (now - sum);
    return now;
#endif
}

/* base to the power of a whole exponent, by squaring. */
static inline real power_of(real base, uint32_t exponent) {
    real result = 1;
    for (; exponent != 0; exponent >>= 1) {
        if ((exponent & 1u) != 0) {
            result *= base;
        }
        base *= base;
    }
    return result;
}

#endif
