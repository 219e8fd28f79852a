/* Elementary functions in plain double arithmetic: the same bits with every compiler and on every processor, which no C
 * library promises. Build with -ffp-contract=off. Relative errors (tests/firmware/test_elementary.py): below 4 units in the
 * last place, edm_pow below 1e-13. Nothing here sets errno. */
#ifndef EDM_ELEMENTARY_H
#define EDM_ELEMENTARY_H

#include "../export.h"

#define INFINITE __builtin_inf()
#define NOT_A_NUMBER __builtin_nan("")

EDM_EXPORT double edm_exp(double x);
EDM_EXPORT double edm_expm1(double x);
EDM_EXPORT double edm_log(double x); /* x positive */
EDM_EXPORT double edm_log1p(double x);
EDM_EXPORT double edm_pow(double x, double y); /* x not negative */
EDM_EXPORT double edm_sin(double x);           /* |x| up to 1e5 */
EDM_EXPORT double edm_cos(double x);
EDM_EXPORT double edm_sinh(double x);
EDM_EXPORT double edm_cosh(double x);
EDM_EXPORT double edm_atanh(double x);
EDM_EXPORT double edm_atan(double x);
EDM_EXPORT float edm_expf(float x); /* correctly rounded */

static inline double edm_sqrt(double x) { /* exact by IEEE 754: an instruction */
    return __builtin_sqrt(x);
}

#endif
