"""The frame codec of the suite, written from docs/protocol.md alone: it shares no code with the host."""

from __future__ import annotations

from typing import NamedTuple
from zlib import crc32

ABORT = bytes(32)
ABORT_ZEROS = 8
REPLY = 0x40
MAX_PAYLOAD = 246
LEAST_ENCODED, MOST_ENCODED = 9, 255


class Frame(NamedTuple):
    """One frame with a good check; `flags` is the status of a reply."""

    type_id: int
    seq: int
    session: int
    flags: int
    payload: bytes


def stuff(data: bytes) -> bytes:
    """COBS: replace every zero, and the end, by the distance to it, written in front."""
    out = bytearray()
    *before, last = data.split(b"\0")
    for block in before:
        out += _stuffed(block, at_end=False)
    return bytes(out) + _stuffed(last, at_end=True)


def _stuffed(block: bytes, *, at_end: bool) -> bytes:
    out = b""
    while len(block) >= 254:
        out += b"\xff" + block[:254]
        block = block[254:]
    # A full block stands for no zero, so nothing need follow it at the end.
    return out if at_end and out and not block else out + bytes((len(block) + 1,)) + block


def unstuff(data: bytes) -> bytes | None:
    """Take COBS back; None where `data` is not COBS."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        block = data[at + 1 : at + code]
        if code == 0 or 0 in block or len(block) != code - 1:
            return None
        out += block
        at += code
        if code < 255 and at < len(data):
            out.append(0)
    return bytes(out)


def checked(body: bytes) -> bytes:
    """Return header and payload with the check behind them."""
    return body + crc32(body).to_bytes(4, "little")


def encode(type_id: int, seq: int, session: int, payload: bytes = b"", flags: int = 0) -> bytes:
    """One frame as it goes over the line, both zeros included."""
    return b"\0" + stuff(checked(bytes((type_id, seq, session, flags)) + payload)) + b"\0"


def pieces(data: bytes) -> list[bytes]:
    """What a receiver collects from `data`: everything between zeros that is not empty."""
    return [piece for piece in data.split(b"\0") if piece]


def decode(piece: bytes) -> Frame | None:
    """Read what stood between two zeros; None where it is no frame."""
    if not LEAST_ENCODED <= len(piece) <= MOST_ENCODED:
        return None
    body = unstuff(piece)
    if body is None or len(body) < 8 or crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
        return None
    return Frame(body[0], body[1], body[2], body[3], body[4:-4])


class Receiver:
    """Frames out of a stream of bytes; `bad` keeps what was no frame."""

    def __init__(self) -> None:
        self.bad: list[bytes] = []
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes; return the frames that they complete."""
        *whole, self._rest = (self._rest + data).split(b"\0")
        frames = []
        for piece in filter(None, whole):
            frame = decode(piece)
            if frame is None:
                self.bad.append(piece)
            else:
                frames.append(frame)
        return frames
