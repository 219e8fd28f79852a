"""Intel HEX: the image as text, as most programs for flashing take it."""

from __future__ import annotations

_DATA, _END, _SEGMENT, _UPPER = 0, 1, 2, 4
_LINE_BYTES = 16
_FARTHEST = 1 << 26


def hex_of(address: int, data: bytes) -> str:
    """Return data at an address as Intel HEX."""
    lines, upper = [], -1
    for at in range(0, len(data), _LINE_BYTES):
        place = address + at
        if place >> 16 != upper:
            upper = place >> 16
            lines.append(_line(0, _UPPER, upper.to_bytes(2, "big")))
        lines.append(_line(place & 0xFFFF, _DATA, data[at : at + _LINE_BYTES]))
    return "\n".join([*lines, _line(0, _END, b"")]) + "\n"


def parse_hex(text: str) -> tuple[int, bytes]:
    """Return the lowest address and the data from there on, with gaps as erased flash. Raises ValueError."""
    pieces: dict[int, bytes] = {}
    upper, is_ended = 0, False
    for number, line in enumerate(text.split(), 1):
        record = _bytes_of(line)
        if len(record) < 5 or len(record) != record[0] + 5 or sum(record) & 0xFF:
            raise ValueError(f"line {number} is damaged")
        place, kind, content = int.from_bytes(record[1:3], "big"), record[3], record[4:-1]
        if kind == _DATA:
            pieces[upper + place] = content
        elif kind in (_SEGMENT, _UPPER):
            upper = int.from_bytes(content, "big") << (4 if kind == _SEGMENT else 16)
        elif kind == _END:
            is_ended = True
    if not pieces or not is_ended:
        raise ValueError("it is cut off")
    base, end = min(pieces), max(at + len(piece) for at, piece in pieces.items())
    if end - base > _FARTHEST:
        raise ValueError("its data lie too far apart")
    data = bytearray(b"\xff") * (end - base)
    for at, piece in pieces.items():
        data[at - base : at - base + len(piece)] = piece
    return base, bytes(data)


def _bytes_of(line: str) -> bytes:
    """The bytes of a line; none where it is no line of Intel HEX."""
    try:
        return bytes.fromhex(line[1:]) if line.startswith(":") else b""
    except ValueError:
        return b""


def _line(address: int, kind: int, content: bytes) -> str:
    record = bytes((len(content), address >> 8, address & 0xFF, kind)) + content
    return f":{record.hex().upper()}{-sum(record) & 0xFF:02X}"
