/* A float and its bits. */
#ifndef EDM_FLOAT_BITS_H
#define EDM_FLOAT_BITS_H

#include <stdint.h>

static inline uint32_t bits_of(float x) {
    union {
        float x;
        uint32_t bits;
    } as = {.x = x};
    return as.bits;
}

static inline float float_of(uint32_t bits) {
    union {
        uint32_t bits;
        float x;
    } as = {.bits = bits};
    return as.x;
}

/* m x 2^e, the nearest float, the even one of two; bit 63 of m is set. Below the normal ones in steps of the least. */
static inline float rounded(uint64_t m, int e) {
    int exponent = e + 63 + 127; /* biased */
    int shift = 40;
    if (exponent <= 0) {
        shift += 1 - exponent;
        exponent = 0;
    }
    if (shift > 64) {
        return 0;
    }
    uint64_t kept = shift < 64 ? m >> shift : 0, lost = m << (64 - shift);
    if (lost > (uint64_t)1 << 63 || (lost == (uint64_t)1 << 63 && (kept & 1u) != 0)) {
        kept++;
    }
    uint32_t bits = (uint32_t)kept;
    if (exponent > 0) {
        bits += (uint32_t)(exponent - 1) << 23; /* the leading bit adds one, a carry of the rounding another one */
    }
    return float_of(bits < 0x7F800000u ? bits : 0x7F800000u);
}

#endif
