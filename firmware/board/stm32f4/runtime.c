/* What the compilers ask of a C library and of their own: memory, a float and 64 bits. Here and not theirs, so that
 * every image has the same bits, and none any double (libgcc converts to 64 bits by way of it). */
#include "../../math/float_bits.h"

#include <stddef.h>
#include <stdint.h>

#define NOT_BY_ITSELF __asm__ volatile("") /* a compiler makes no call of memcpy of the loop in memcpy */

void *memcpy(void *restrict to, const void *restrict from, size_t size);
void *memmove(void *to, const void *from, size_t size);
void *memset(void *to, int byte, size_t size);
int memcmp(const void *a, const void *b, size_t size);

/* A word at any address: the core reads and writes those too, one at a time (PM0214 3.3.5). */
struct __attribute__((packed, may_alias)) word {
    uint32_t bits;
};

void *memcpy(void *restrict to, const void *restrict from, size_t size) {
    uint8_t *t = to;
    const uint8_t *f = from;
    for (; size >= 16; size -= 16, t += 16, f += 16) {
        struct word *words = (void *)t;
        const struct word *these = (const void *)f;
        words[0].bits = these[0].bits;
        words[1].bits = these[1].bits;
        words[2].bits = these[2].bits;
        words[3].bits = these[3].bits;
        NOT_BY_ITSELF;
    }
    for (; size >= 4; size -= 4, t += 4, f += 4) {
        ((struct word *)(void *)t)->bits = ((const struct word *)(const void *)f)->bits;
        NOT_BY_ITSELF;
    }
    for (; size > 0; size--) {
        *t++ = *f++;
        NOT_BY_ITSELF;
    }
    return to;
}

void *memmove(void *to, const void *from, size_t size) {
    uint8_t *t = to;
    const uint8_t *f = from;
    if ((uintptr_t)t <= (uintptr_t)f || (uintptr_t)t >= (uintptr_t)f + size) {
        return memcpy(to, from, size);
    }
    while (size > 0) {
        size--;
        t[size] = f[size];
        NOT_BY_ITSELF;
    }
    return to;
}

void *memset(void *to, int byte, size_t size) {
    uint8_t *t = to;
    uint32_t word = (uint8_t)byte * 0x01010101u;
    for (; size > 0 && ((uintptr_t)t & 3u) != 0; size--) {
        *t++ = (uint8_t)byte;
        NOT_BY_ITSELF;
    }
    for (; size >= 4; size -= 4, t += 4) {
        *(uint32_t *)(void *)t = word;
        NOT_BY_ITSELF;
    }
    for (; size > 0; size--) {
        *t++ = (uint8_t)byte;
        NOT_BY_ITSELF;
    }
    return to;
}

int memcmp(const void *a, const void *b, size_t size) {
    const uint8_t *x = a, *y = b;
    for (; size > 0; size--, x++, y++) {
        if (*x != *y) {
            return *x - *y;
        }
    }
    return 0;
}

/* Conversions that the processor has no instruction for (run-time ABI of the ARM architecture, 4.1.2): they are called with
 * floats in core registers, also where others have them in those of the FPU. */
#if defined(__arm__)
#define BY_CORE_REGISTERS __attribute__((pcs("aapcs")))
BY_CORE_REGISTERS int64_t __aeabi_f2lz(float x);
BY_CORE_REGISTERS uint64_t __aeabi_f2ulz(float x);
BY_CORE_REGISTERS float __aeabi_l2f(int64_t x);
BY_CORE_REGISTERS float __aeabi_ul2f(uint64_t x);

uint64_t __aeabi_f2ulz(float x) {
    uint32_t bits = bits_of(x);
    int exponent = (int)(bits >> 23) - 150;
    uint64_t mantissa = (bits & 0x7FFFFFu) | 0x800000u;
    if (bits >> 31 != 0 || exponent < -23) {
        return 0;
    }
    if (exponent > 40) {
        return bits > 0x7F800000u ? 0 : UINT64_MAX;
    }
    return exponent < 0 ? mantissa >> -exponent : mantissa << exponent;
}

int64_t __aeabi_f2lz(float x) {
    uint64_t whole = __aeabi_f2ulz(float_of(bits_of(x) & 0x7FFFFFFFu));
    if (bits_of(x) >> 31 != 0) {
        return whole > INT64_MAX ? INT64_MIN : -(int64_t)whole;
    }
    return whole > INT64_MAX ? INT64_MAX : (int64_t)whole;
}

float __aeabi_ul2f(uint64_t x) {
    if (x == 0) {
        return 0;
    }
    int zeros = __builtin_clzll(x);
    return rounded(x << zeros, -zeros);
}

float __aeabi_l2f(int64_t x) {
    return x < 0 ? -__aeabi_ul2f(0u - (uint64_t)x) : __aeabi_ul2f((uint64_t)x);
}
#endif
