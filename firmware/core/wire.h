/* Little-endian integers in a payload, and physical values as counts of the wire (docs/protocol.md, Frame). */
#ifndef EDM_WIRE_H
#define EDM_WIRE_H

#include "real.h"

#if __STDC_HOSTED__
#include <string.h>
#else /* a freestanding compiler has these functions, but not the header */
#include <stddef.h>
void *memcpy(void *restrict to, const void *restrict from, size_t size);
void *memmove(void *to, const void *from, size_t size);
void *memset(void *to, int byte, size_t size);
int memcmp(const void *a, const void *b, size_t size);
#endif

static inline uint8_t get_u8(const uint8_t *p) {
    return p[0];
}

static inline uint16_t get_u16(const uint8_t *p) {
    return (uint16_t)(p[0] | p[1] << 8);
}

static inline uint32_t get_u32(const uint8_t *p) {
    return (uint32_t)get_u16(p) | (uint32_t)get_u16(p + 2) << 16;
}

static inline int32_t get_i32(const uint8_t *p) {
    return (int32_t)get_u32(p);
}

static inline uint64_t get_u64(const uint8_t *p) {
    return (uint64_t)get_u32(p) | (uint64_t)get_u32(p + 4) << 32;
}

static inline void put_u8(uint8_t *p, uint8_t value) {
    p[0] = value;
}

static inline void put_u16(uint8_t *p, uint16_t value) {
    p[0] = (uint8_t)value;
    p[1] = (uint8_t)(value >> 8);
}

static inline void put_i16(uint8_t *p, int16_t value) {
    put_u16(p, (uint16_t)value);
}

static inline void put_u32(uint8_t *p, uint32_t value) {
    put_u16(p, (uint16_t)value);
    put_u16(p + 2, (uint16_t)(value >> 16));
}

static inline void put_i32(uint8_t *p, int32_t value) {
    put_u32(p, (uint32_t)value);
}

static inline void put_u64(uint8_t *p, uint64_t value) {
    put_u32(p, (uint32_t)value);
    put_u32(p + 4, (uint32_t)(value >> 32));
}

static inline void put_s12(uint8_t *p, const char *text) {
    memcpy(p, text, 12);
}

/* The nearest count within a range; a value that is no number gives the least. */
static inline int64_t counts_within(real value, int64_t low, int64_t high) {
    if (!(value > (real)low)) {
        return low;
    }
    return value >= (real)high ? high : nearest(value);
}

static inline uint16_t counts_u16(real value) {
    return (uint16_t)counts_within(value, 0, UINT16_MAX);
}

static inline int16_t counts_i16(real value) {
    return (int16_t)counts_within(value, INT16_MIN, INT16_MAX);
}

static inline int32_t counts_i32(real value) {
    return (int32_t)counts_within(value, INT32_MIN, INT32_MAX);
}

static inline uint32_t counts_u32(real value) {
    return (uint32_t)counts_within(value, 0, UINT32_MAX);
}

#endif
