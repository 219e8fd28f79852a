"""The black box: every millisecond of the last two seconds, as telemetry would have told it, up to a fault."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.link.messages import BlackboxReadReply, Tlm
from edmctl.simulator import kernel as k

if TYPE_CHECKING:
    from numpy.typing import NDArray

PER_REPLY = 14
_COUNTS = (("n_open", k.OPEN), ("n_normal", k.NORMAL), ("n_arc", k.ARC), ("n_short", k.SHORT))
_MOST = 0xFFFF


class BlackBox:
    """A ring that the kernel writes; a fault freezes what it holds then."""

    def __init__(self) -> None:
        self.ring = np.zeros((k.BOX, k.BOX_COLUMNS))
        self._frozen: tuple[NDArray[np.float64], int, int] | None = None

    def freeze(self, now: int, start: int) -> None:
        """Keep the ring as it is at tick `now` of a controller started at tick `start`; what is kept stays."""
        if self._frozen is None:
            self._frozen = (self.ring.copy(), now, start)

    @property
    def frozen_tick(self) -> int | None:
        """When a fault froze it; None while it goes on."""
        return None if self._frozen is None else self._frozen[1]

    def thaw(self) -> None:
        """Let the ring go on."""
        self._frozen = None

    def newest_flags(self, now: int) -> int:
        """TlmFlags of the millisecond that ended at tick `now`."""
        return int(self.ring[now - 1 & (k.BOX - 1), 5]) & 255

    def read(self, offset: int, now: int, start: int) -> BlackboxReadReply:
        """Part of what is held, oldest first, from sample `offset` on."""
        ring, end, origin = self._frozen or (self.ring, now, start)
        total = min(k.BOX, end - origin)
        first = end - total + offset
        n = max(0, min(PER_REPLY, total - offset))
        records = _records(ring[np.arange(first, first + n) & (k.BOX - 1)])
        return BlackboxReadReply(total, (first + 1 - origin) * 1000 & 0xFFFFFFFF, n, records)


def _records(rows: NDArray[np.float64]) -> bytes:
    """Pack rows of the ring, shape (n, BOX_COLUMNS), as the kernel packs samples of 1 ms."""
    records = np.zeros(len(rows), dtype=Tlm.record_dtype())
    records["displacement_um"] = np.floor(rows[:, 0] * 1000.0 + 0.5)
    records["actuator_v"] = rows[:, 1] * k.STEPS_PER_V + 0.5
    records["gap_v"] = np.minimum(_MOST, rows[:, 2] * 200.0 + 0.5)
    records["current_a"] = np.minimum(_MOST, rows[:, 3] / 1000.0 * 1000.0 + 0.5)
    counts = rows[:, 4].astype(np.int64)
    for name, index in _COUNTS:
        records[name] = np.minimum(255, counts >> (k.PACK * index) & ((1 << k.PACK) - 1))
    rest = rows[:, 5].astype(np.int64)
    records["state"], records["flags"] = rest >> 8, rest & 255
    return records.tobytes()
