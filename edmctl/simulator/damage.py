"""What an injected bad line does to the bytes of the host."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from edmctl.link.messages import Advance

if TYPE_CHECKING:
    from edmctl.simulator.injection import LineState

SEED = 1
_ADVANCE = bytes([Advance.ID])


class LineDamage:
    """Loses or damages the host's frames as the line's state says; always the same ones in a run.

    ADVANCE passes: it is no part of the line that is imitated.
    """

    def __init__(self, line: LineState) -> None:
        self._line = line
        self._random = Random(SEED)

    def to(self, data: bytes) -> bytes:
        """Return what arrives of `data`, which holds whole frames."""
        if self._line.silent:
            return b"".join(b"\0" + part + b"\0" for part in data.split(b"\0") if _is_advance(part))
        if not self._line.noise:
            return data
        return b"\0".join(self._of_frame(part) for part in data.split(b"\0"))

    def _of_frame(self, part: bytes) -> bytes:
        if not part or _is_advance(part) or self._random.random() >= self._line.noise:
            return part
        damaged = bytearray(part)
        # A byte that becomes zero would only cut the frame in two.
        at = self._random.randrange(len(damaged))
        damaged[at] = damaged[at] ^ 1 or 2
        return bytes(damaged)


def _is_advance(part: bytes) -> bool:
    """COBS puts its first code byte before the type, which is never zero."""
    return part[1:2] == _ADVANCE
