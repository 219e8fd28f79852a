"""Frames on the wire: 00 | COBS(type, seq, session, flags, payload, CRC-32) | 00.

Consistent-overhead byte stuffing (Cheshire and Baker 1999) keeps zero out of a frame, so a zero always ends
one, whatever was lost before it, and a run of zeros can mean "abort" in any state of the decoder.
"""

from __future__ import annotations

from typing import NamedTuple
from zlib import crc32

from cobs import cobs

MAX_PAYLOAD = 246
ABORT = bytes(32)
"""What the host sends to abort."""
ABORT_RUN = bytes(8)
_HEADER_SIZE = 4
_CRC_SIZE = 4
_MIN_ENCODED = _HEADER_SIZE + _CRC_SIZE + 1
# Up to 254 decoded bytes, COBS adds exactly one.
_MAX_ENCODED = _HEADER_SIZE + MAX_PAYLOAD + _CRC_SIZE + 1
# CRC-32 of anything followed by its own little-endian CRC-32.
_RESIDUE = 0x2144DF1C


class Frame(NamedTuple):
    """One checked frame. `flags` is the status where the frame is a reply."""

    type_id: int
    seq: int
    session: int
    flags: int
    payload: bytes


# The class's own constructor takes half as long as all the rest of reading a frame.
_new_frame = tuple.__new__


def encode_frame(type_id: int, seq: int, session: int, flags: int, payload: bytes) -> bytes:
    """Return a frame with both delimiters; ValueError where a header byte or the payload is too large."""
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(f"payload of {len(payload)} bytes, {MAX_PAYLOAD} fit into a frame")
    body = bytes((type_id, seq, session, flags)) + payload
    return b"\0" + cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"  # type: ignore[no-any-return]


class FrameDecoder:
    """Finds frames in a stream of bytes that may be damaged anywhere.

    `bad` counts the frames dropped: too short, too long, not COBS, or failing the check.
    `abort_seen` becomes true with eight zeros in a row; whoever acts on it sets it back. Only a controller
    listens for that: `watch_for_abort`.
    """

    def __init__(self, *, watch_for_abort: bool = True) -> None:
        self.bad = 0
        self._watches = watch_for_abort
        self.abort_seen = False
        self._partial = b""
        self._zeros = 0

    @property
    def zeros(self) -> int:
        """So many zeros came last, in a row."""
        return self._zeros

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next bytes and return the frames that they complete."""
        if not data:
            return []
        if self._watches:
            self._watch_for_abort(data)
        parts = data.split(b"\0")
        if self._partial:
            parts[0] = self._partial + parts[0]
        # One byte over the limit is enough to know that the frame is too long.
        self._partial = parts.pop()[: _MAX_ENCODED + 1]
        frames: list[Frame] = []
        for part in parts:
            if not part:
                continue
            if not _MIN_ENCODED <= len(part) <= _MAX_ENCODED:
                self.bad += 1
                continue
            try:
                body: bytes = cobs.decode(part)
            except cobs.DecodeError:
                self.bad += 1
                continue
            # COBS of these lengths decodes to one byte less, so header and check are always there.
            if crc32(body) != _RESIDUE:
                self.bad += 1
                continue
            frames.append(_new_frame(Frame, (*body[:_HEADER_SIZE], body[_HEADER_SIZE:-_CRC_SIZE])))
        return frames

    def _watch_for_abort(self, data: bytes) -> None:
        rest = data.lstrip(b"\0")
        zeros = self._zeros + len(data) - len(rest)
        # One run is one abort, however many reads it takes to arrive.
        if self._zeros < len(ABORT_RUN) <= zeros or ABORT_RUN in rest:
            self.abort_seen = True
        self._zeros = len(rest) - len(rest.rstrip(b"\0")) if rest else zeros
