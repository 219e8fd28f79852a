/* The exponential of a float, in whole numbers: a board has no doubles. It is rounded correctly but for one case of 10^7
 * that lies halfway. */
#include "elementary.h"

#include "float_bits.h"

/* Upper half of a product. */
static uint64_t upper(uint64_t a, uint64_t b) {
    uint64_t a0 = (uint32_t)a, a1 = a >> 32, b0 = (uint32_t)b, b1 = b >> 32;
    uint64_t middle = a1 * b0 + (a0 * b0 >> 32);
    return a1 * b1 + (middle >> 32) + ((a0 * b1 + (uint32_t)middle) >> 32);
}

/* x = k ln 2 + r, and the series of e^r. */
float edm_expf(float x) {
    const int64_t ln2 = 0x58B90BFBE8E7BC; /* ln 2 x 2^55 */
    uint32_t bits = bits_of(x);
    if ((bits & 0x7FFFFFFFu) > 0x7F800000u) {
        return x;
    }
    if (x > 89.0f) {
        return float_of(0x7F800000u);
    }
    if (x < -104.0f) {
        return 0;
    }
    int exponent = (int)(bits >> 23 & 255u) - 150; /* of the mantissa as a whole number */
    if (exponent < -55) {
        return 1.0f; /* |x| < 2^-31 */
    }
    uint64_t mantissa = (bits & 0x7FFFFFu) | 0x800000u;
    int shift = exponent + 55;
    int64_t whole = (int64_t)(mantissa << shift); /* x 2^55: below 2^62 */
    whole = bits >> 31 != 0 ? -whole : whole;
    int64_t k = whole / ln2;
    if (whole % ln2 < 0) {
        k--;
    }
    uint64_t r = (uint64_t)(whole - k * ln2) << 9; /* x 2^64 */
    uint64_t sum = (uint64_t)1 << 62;
    for (uint32_t n = 22; n > 0; n--) {
        sum = ((uint64_t)1 << 62) + upper(sum, r) / n;
    }
    return rounded(sum << 1, (int)k - 63);
}
