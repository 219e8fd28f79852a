"""A line that does to frames whatever a line can do, in virtual time and by a seed."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from edmctl.link.transport import Transport

FATES = ("drop", "duplicate", "delay", "corrupt", "arrive")


@dataclass(frozen=True, slots=True)
class Faults:
    """Chance of each fate of a frame, in both directions; what is left arrives as it was sent."""

    drop: float = 0.0
    duplicate: float = 0.0
    delay: float = 0.0
    corrupt: float = 0.0
    longest_delay_s: float = 0.6


class LossyLine:
    """Wraps a line of virtual time. A delayed frame arrives after later ones: delays reorder."""

    def __init__(self, line: Transport, random: Random, faults: Faults) -> None:
        self.name, self.live = line.name, False
        self._line, self._random, self._faults = line, random, faults
        self._to_device: list[tuple[float, bytes]] = []
        self._to_host: list[tuple[float, bytes]] = []

    def now_s(self) -> float:
        return self._line.now_s()

    def close(self) -> None:
        self._line.close()

    def write(self, data: bytes) -> None:
        self._scatter(data, self._to_device)
        self._deliver()

    def read(self, timeout_s: float) -> bytes:
        """Pass on what is due; let time pass up to the next arrival otherwise."""
        end_s = self.now_s() + timeout_s
        while True:
            self._deliver()
            if due := self._take(self._to_host):
                return due
            left_s = end_s - self.now_s()
            if left_s <= 1e-9:
                return b""
            times = [time_s for time_s, _ in self._to_device + self._to_host]
            step_s = min([left_s, *(time_s - self.now_s() for time_s in times)])
            self._scatter(self._line.read(max(step_s, 1e-3)), self._to_host)

    def _deliver(self) -> None:
        if data := self._take(self._to_device):
            self._line.write(data)

    def _take(self, queue: list[tuple[float, bytes]]) -> bytes:
        now_s = self.now_s() + 1e-9
        due = [entry for entry in queue if entry[0] <= now_s]
        queue[:] = [entry for entry in queue if entry[0] > now_s]
        return b"".join(data for _, data in sorted(due, key=lambda entry: entry[0]))

    def _scatter(self, data: bytes, queue: list[tuple[float, bytes]]) -> None:
        """Decide the fate of every frame in `data`, whose frames are whole."""
        for part in data.split(b"\0"):
            if part:
                self._decide(b"\0" + part + b"\0", queue)

    def _decide(self, frame: bytes, queue: list[tuple[float, bytes]]) -> None:
        faults, now_s = self._faults, self.now_s()
        chances = (faults.drop, faults.duplicate, faults.delay, faults.corrupt)
        (name,) = self._random.choices(FATES, (*chances, 1.0 - sum(chances)))
        late_s = now_s + self._random.uniform(0.0, faults.longest_delay_s)
        if name in ("arrive", "duplicate"):
            queue.append((now_s, frame))
        if name in ("duplicate", "delay"):
            queue.append((late_s, frame))
        if name == "corrupt":
            queue.append((now_s, self._damaged(frame)))

    def _damaged(self, frame: bytes) -> bytes:
        damaged = bytearray(frame)
        for _ in range(self._random.randint(1, 4)):
            damaged[self._random.randrange(len(damaged))] ^= 1 << self._random.randrange(8)
        return bytes(damaged)
