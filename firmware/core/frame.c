/* Frames of the line: 00 | COBS(type seq session flags payload crc32) | 00 (docs/protocol.md, Frame, Abort run). */
#include "core.h"

#define HEADER 4
#define CHECK 4
#define ENCODED_LEAST (HEADER + CHECK + 1)
#define RESIDUE 0x2144DF1Cu /* CRC-32 of anything followed by its own CRC-32 */
#define ABORT_ZEROS 8

/* Sixteen entries of the table of CRC-32: those of the low nibble, added to one of the high nibble. */
#define ROW(x)                                                                                                           \
    (x), (x) ^ 0x77073096u, (x) ^ 0xEE0E612Cu, (x) ^ 0x990951BAu, (x) ^ 0x076DC419u, (x) ^ 0x706AF48Fu,                   \
        (x) ^ 0xE963A535u, (x) ^ 0x9E6495A3u, (x) ^ 0x0EDB8832u, (x) ^ 0x79DCB8A4u, (x) ^ 0xE0D5E91Eu,                    \
        (x) ^ 0x97D2D988u, (x) ^ 0x09B64C2Bu, (x) ^ 0x7EB17CBDu, (x) ^ 0xE7B82D07u, (x) ^ 0x90BF1D91u

static const uint32_t crc_table[256] = {
    ROW(0x00000000u), ROW(0x1DB71064u), ROW(0x3B6E20C8u), ROW(0x26D930ACu), ROW(0x76DC4190u), ROW(0x6B6B51F4u),
    ROW(0x4DB26158u), ROW(0x5005713Cu), ROW(0xEDB88320u), ROW(0xF00F9344u), ROW(0xD6D6A3E8u), ROW(0xCB61B38Cu),
    ROW(0x9B64C2B0u), ROW(0x86D3D2D4u), ROW(0xA00AE278u), ROW(0xBDBDF21Cu),
};

static uint32_t crc_with(uint32_t crc, uint8_t byte) {
    return crc_table[(crc ^ byte) & 255u] ^ (crc >> 8);
}

/* CRC-32 of IEEE 802.3, byte by byte. `crc` is that of what stands before, 0 at first. */
uint32_t frame_crc(uint32_t crc, const uint8_t *bytes, size_t size) {
    crc = ~crc;
    for (size_t i = 0; i < size; i++) {
        crc = crc_with(crc, bytes[i]);
    }
    return ~crc;
}

/* A frame that is being written: `code_at` is the place of the last code, which says how far the next one is. */
struct stuffing {
    uint8_t *out;
    size_t at, code_at;
    uint32_t crc;
};

/* Writes bytes of the body. COBS: Cheshire and Baker 1999. */
static void stuff(struct stuffing *s, const uint8_t *bytes, size_t size) {
    uint8_t *out = s->out;
    size_t at = s->at, code_at = s->code_at;
    uint32_t crc = s->crc;
    for (size_t i = 0; i < size; i++) {
        uint8_t byte = bytes[i];
        crc = crc_with(crc, byte);
        out[at] = byte;
        if (__builtin_expect(byte == 0, 0)) { /* else a compiler may calculate the code for every byte */
            out[code_at] = (uint8_t)(at - code_at);
            code_at = at;
        }
        at++;
    }
    *s = (struct stuffing){out, at, code_at, crc};
}

/* Writes a whole frame with both zeros to `out` (FRAME_MOST bytes); returns its size. */
size_t frame_encode(uint8_t *out, uint8_t type, uint8_t seq, uint8_t session, uint8_t flags, const uint8_t *payload,
                    size_t size) {
    const uint8_t header[HEADER] = {type, seq, session, flags};
    uint8_t check[CHECK];
    struct stuffing s = {.out = out, .at = 2, .code_at = 1, .crc = UINT32_MAX};
    out[0] = 0;
    stuff(&s, header, HEADER);
    stuff(&s, payload, size);
    put_u32(check, ~s.crc);
    stuff(&s, check, CHECK);
    out[s.code_at] = (uint8_t)(s.at - s.code_at); /* at most 255: a body has at most 254 bytes */
    out[s.at++] = 0;
    return s.at;
}

/* Removes COBS in place; false where the bytes are none. The result is one byte shorter. */
static bool unstuff(uint8_t *bytes, size_t size) {
    size_t at = 0;
    while (at < size) {
        size_t next = at + bytes[at];
        if (next > size) {
            return false;
        }
        bytes[at] = 0; /* the zero that stood here, but for the first code */
        at = next;
    }
    return true;
}

/* Takes the bytes before the next zero; returns how many. */
size_t frame_fill(struct edm_receiver *r, const uint8_t *bytes, size_t size) {
    size_t taken = 0, filled = r->filled;
    for (; taken < size && bytes[taken] != 0; taken++) {
        if (filled < FRAME_ENCODED_MOST) {
            r->buffer[filled++] = bytes[taken];
        } else {
            filled = FRAME_ENCODED_MOST + 1; /* it is too long */
        }
    }
    r->filled = (uint16_t)filled;
    if (taken > 0) {
        r->zeros = 0;
    }
    return taken;
}

/* Whether the line makes an abort run with another zero: one run is one abort, however long. Call it before frame_end. */
bool frame_aborts(const struct edm_receiver *r) {
    return r->zeros == ABORT_ZEROS - 1;
}

/* Takes a zero; true where it ends a whole frame, whose payload stands in the receiver until the next byte. */
bool frame_end(struct edm_receiver *r, struct edm_frame *frame) {
    if (r->zeros < ABORT_ZEROS) {
        r->zeros++;
    }
    size_t size = r->filled;
    r->filled = 0;
    if (size == 0) {
        return false;
    }
    uint8_t *body = r->buffer + 1;
    if (size < ENCODED_LEAST || size > FRAME_ENCODED_MOST || !unstuff(r->buffer, size) ||
        frame_crc(0, body, size - 1) != RESIDUE) {
        r->bad++;
        return false;
    }
    frame->type = body[0];
    frame->seq = body[1];
    frame->session = body[2];
    frame->flags = body[3];
    frame->payload = body + HEADER;
    frame->size = (uint8_t)(size - 1 - HEADER - CHECK);
    return true;
}
