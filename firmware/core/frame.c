/* Frames of the line: 00 | COBS(type seq session flags payload crc32) | 00 (docs/protocol.md, Frame, Abort run). */
#include "core.h"

#define HEADER 4
#define CHECK 4
#define ENCODED_LEAST (HEADER + CHECK + 1)
#define RESIDUE 0x2144DF1Cu /* CRC-32 of anything followed by its own CRC-32 */
#define ABORT_ZEROS 8

/* CRC-32 of IEEE 802.3, nibble by nibble: 64 bytes of table. `crc` is that of what stands before, 0 at first. */
uint32_t frame_crc(uint32_t crc, const uint8_t *bytes, size_t size) {
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
        0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
    };
    crc = ~crc;
    for (size_t i = 0; i < size; i++) {
        crc = table[(crc ^ bytes[i]) & 15u] ^ (crc >> 4);
        crc = table[(crc ^ (uint32_t)(bytes[i] >> 4)) & 15u] ^ (crc >> 4);
    }
    return ~crc;
}

/* Writes a whole frame with both zeros to `out` (FRAME_MOST bytes); returns its size. COBS: Cheshire and Baker 1999. */
size_t frame_encode(uint8_t *out, uint8_t type, uint8_t seq, uint8_t session, uint8_t flags, const uint8_t *payload,
                    size_t size) {
    uint8_t body[HEADER + MAX_PAYLOAD + CHECK] = {type, seq, session, flags};
    memcpy(body + HEADER, payload, size);
    size += HEADER;
    put_u32(body + size, frame_crc(0, body, size));
    size += CHECK;
    size_t code_at = 1, at = 2;
    out[0] = 0;
    for (size_t i = 0; i < size; i++) {
        if (body[i] != 0) {
            out[at++] = body[i];
        } else {
            out[code_at] = (uint8_t)(at - code_at);
            code_at = at++;
        }
    }
    out[code_at] = (uint8_t)(at - code_at); /* at most 255: a body has at most 254 bytes */
    out[at++] = 0;
    return at;
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

/* Whether the line makes an abort run with this byte: one run is one abort, however long. Call it before frame_take. */
bool frame_aborts(const struct edm_receiver *r, uint8_t byte) {
    return byte == 0 && r->zeros == ABORT_ZEROS - 1;
}

/* Takes a byte; true where it ends a whole frame, whose payload stands in the receiver until the next byte. */
bool frame_take(struct edm_receiver *r, uint8_t byte, struct edm_frame *frame) {
    if (byte != 0) {
        r->zeros = 0;
        if (r->filled < FRAME_ENCODED_MOST) {
            r->buffer[r->filled] = byte;
        }
        if (r->filled <= FRAME_ENCODED_MOST) {
            r->filled++;
        }
        return false;
    }
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
