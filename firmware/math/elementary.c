/* Elementary functions by table and polynomial. The constants with _HI have so few bits that their product with a
 * whole number is exact; _LO is what they lack (Cody & Waite 1980). */
#include "elementary.h"

#include "tables.h"

#include <stdint.h>

#define LN2_HI 0x1.62e42fee00000p-1
#define LN2_LO 0x1.a39ef35793c76p-33
#define STEP_HI 0x1.62e42fee00000p-7 /* ln 2 / EXP_STEPS */
#define STEP_LO 0x1.a39ef35793c76p-39
#define PER_STEP 0x1.71547652b82fep+6
#define ROUND 0x1.8p52 /* added and taken away, it rounds to a whole number */
#define HALF_PI_HI 0x1.921fb54400000p+0
#define HALF_PI_MID 0x1.0b4611a600000p-34
#define HALF_PI_LO 0x1.3198a2e037073p-69
#define PER_HALF_PI 0x1.45f306dc9c883p-1
#define HALF_PI 0x1.921fb54442d18p+0
#define MOST_ANGLE 1e5
#define MOST_EXP 709.782712893384
#define LEAST_EXP (-745.1332191019412)
#define NEAR 0.0625 /* 1 within it: no logarithm from differences of the table */
#define SERIES 0.35 /* below it a power series is exact enough, and a difference from 1 is not */

static uint64_t bits_of(double x) {
    union {
        double x;
        uint64_t bits;
    } as = {.x = x};
    return as.bits;
}

static double number_of(uint64_t bits) {
    union {
        uint64_t bits;
        double x;
    } as = {.bits = bits};
    return as.x;
}

/* 2^k for -1022 <= k <= 1023 */
static double power_of_two(int64_t k) {
    return number_of((uint64_t)(k + 1023) << 52);
}

/* exp(x + rest): x = (64 k + i) ln 2 / 64 + r, so that it is 2^k * 2^(i/64) * exp(r). */
static double exp_of(double x, double rest) {
    double n = (x * PER_STEP + ROUND) - ROUND;
    int64_t steps = (int64_t)n, i = steps & (EXP_STEPS - 1), k = (steps - i) / EXP_STEPS;
    double r = (x - n * STEP_HI) - n * STEP_LO + rest, r2 = r * r;
    double p = r + r2 * (0.5 + r * (1.0 / 6.0) + r2 * (1.0 / 24.0 + r * (1.0 / 120.0)));
    double y = POWERS[i][0] + (POWERS[i][1] + POWERS[i][0] * p);
    if (k < -1021) { /* the last factor rounds to a number with fewer bits */
        return y * power_of_two(k + 200) * power_of_two(-200);
    }
    return k > 1023 ? y * 2.0 * power_of_two(k - 1) : y * power_of_two(k);
}

double edm_exp(double x) {
    if (!(x < MOST_EXP)) {
        return x > MOST_EXP ? INFINITE : exp_of(MOST_EXP, x - MOST_EXP);
    }
    return x < LEAST_EXP ? 0.0 : exp_of(x, 0.0);
}

double edm_expm1(double x) {
    if (!(x < SERIES && x > -SERIES)) {
        return edm_exp(x) - 1.0;
    }
    double sum = 0.0;
    for (int n = 14; n > 1; n--) {
        sum = (sum + 1.0) * (x / n);
    }
    return x + x * sum;
}

/* log(1 + f) for |f| up to NEAR, by the series of 2 atanh(s), s = f / (2 + f). */
static double log_near(double f) {
    double s = f / (2.0 + f), z = s * s, half = 0.5 * f * f;
    double sum = z * (2.0 / 3.0 + z * (2.0 / 5.0 + z * (2.0 / 7.0 + z * (2.0 / 9.0 + z * (2.0 / 11.0)))));
    return f - (half - s * (half + sum));
}

/* x = 2^k m, and m / c = 1 + r for a c of the table: its logarithm is k ln 2 + log(c) + log(1 + r). */
double edm_log(double x) {
    if (!(x > 0.0) || x == INFINITE) {
        return x == 0.0 ? -INFINITE : x > 0.0 ? x : NOT_A_NUMBER;
    }
    if (x > 1.0 - NEAR && x < 1.0 + NEAR) {
        return log_near(x - 1.0);
    }
    int64_t k = -1023;
    if (x < 0x1p-1022) {
        x *= 0x1p54;
        k -= 54;
    }
    uint64_t bits = bits_of(x);
    k += (int64_t)(bits >> 52);
    double m = number_of((bits & 0xFFFFFFFFFFFFFu) | 0x3FF0000000000000u);
    double high = number_of(bits_of(m) & 0xFFFFFFFFF8000000u);
    int i = (int)(bits >> 45 & (LOG_STEPS - 1));
    double r = (high * INVERSES[i] - 1.0) + (m - high) * INVERSES[i], r2 = r * r;
    double tail = r2 * r * (1.0 / 3.0 + r * (-1.0 / 4.0) + r2 * (1.0 / 5.0 + r * (-1.0 / 6.0) + r2 * (1.0 / 7.0)));
    double whole = (double)k * LN2_HI + LOGS[i][0], sum = whole + r;
    return sum + (((whole - sum) + r) + ((double)k * LN2_LO + LOGS[i][1]) - 0.5 * r2 + tail);
}

double edm_log1p(double x) {
    if (x > -NEAR && x < NEAR) {
        return log_near(x);
    }
    double u = 1.0 + x;
    return edm_log(u) + (u > 0.0 && u < INFINITE ? (x - (u - 1.0)) / u : 0.0);
}

double edm_pow(double x, double y) {
    if (y == 0.0 || x == 1.0) {
        return 1.0;
    }
    if (x == 0.0) {
        return y > 0.0 ? 0.0 : y < 0.0 ? INFINITE : y;
    }
    return edm_exp(y * edm_log(x));
}

/* Which quarter turn x is in, and r, what it is beyond the nearest whole one. */
static int quarter_of(double x, double *r) {
    if (!(x < MOST_ANGLE && x > -MOST_ANGLE)) {
        *r = NOT_A_NUMBER;
        return 0;
    }
    double n = (x * PER_HALF_PI + ROUND) - ROUND;
    *r = ((x - n * HALF_PI_HI) - n * HALF_PI_MID) - n * HALF_PI_LO;
    return (int)((int64_t)n & 3);
}

static double sin_of(double r) {
    double r2 = r * r, sum = 0.0;
    for (int n = 16; n > 1; n -= 2) {
        sum = -(sum + 1.0) * (r2 / (n * (n + 1)));
    }
    return r + r * sum;
}

static double cos_of(double r) {
    double r2 = r * r, sum = 0.0;
    for (int n = 17; n > 0; n -= 2) {
        sum = -(sum + 1.0) * (r2 / (n * (n + 1)));
    }
    return 1.0 + sum;
}

double edm_sin(double x) {
    double r;
    int quarter = quarter_of(x, &r);
    double y = (quarter & 1) != 0 ? cos_of(r) : sin_of(r);
    return (quarter & 2) != 0 ? -y : y;
}

double edm_cos(double x) {
    double r;
    int quarter = quarter_of(x, &r);
    double y = (quarter & 1) != 0 ? sin_of(r) : cos_of(r);
    return quarter == 1 || quarter == 2 ? -y : y;
}

double edm_sinh(double x) {
    double y = edm_expm1(x < 0.0 ? -x : x), half = 0.5 * (y + y / (y + 1.0));
    return x < 0.0 ? -half : half;
}

double edm_cosh(double x) {
    double y = edm_exp(x < 0.0 ? -x : x);
    return 0.5 * y + 0.5 / y;
}

double edm_atanh(double x) {
    double size = x < 0.0 ? -x : x, half = 0.5 * edm_log1p(2.0 * size / (1.0 - size));
    return x < 0.0 ? -half : half;
}

/* By halving the angle twice; the series needs few terms then. */
double edm_atan(double x) {
    double size = x < 0.0 ? -x : x, t = size > 1.0 ? 1.0 / size : size;
    t = t / (1.0 + edm_sqrt(1.0 + t * t));
    t = t / (1.0 + edm_sqrt(1.0 + t * t));
    double t2 = t * t, sum = 0.0;
    for (int n = 23; n > 1; n -= 2) {
        sum = t2 * (1.0 / n - sum);
    }
    double angle = 4.0 * (t - t * sum);
    angle = size > 1.0 ? HALF_PI - angle : angle;
    return x < 0.0 ? -angle : angle;
}
