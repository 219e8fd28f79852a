"""What a process holds, as Linux tells it: memory, open file descriptors and threads."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class Held:
    """What a process held at one time."""

    rss_mb: float
    descriptors: int
    threads: int


@dataclass(frozen=True, slots=True)
class SecondHalf:
    """Least, most and last of a count in the second half of a run, and how much it grew there.

    growth : most of the last quarter less most of the one before
    """

    least: int
    most: int
    last: int
    growth: int

    def __str__(self) -> str:
        return f"{self.least} to {self.most}, {self.last} at the end, growth {self.growth:+d}"


def held_by(pid: int) -> Held | None:
    """Return what a process holds now; None when it has ended."""
    with suppress(OSError):
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
        told = dict(line.split(":", 1) for line in lines)
        if "VmRSS" in told:  # of a process that has ended and that nobody has waited for, nothing is told
            descriptors = sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())
            return Held(float(told["VmRSS"].split()[0]) / 1024.0, descriptors, int(told["Threads"]))
    return None


def second_half(counts: Sequence[int]) -> SecondHalf:
    """Return how a count went in the second half of a run, from samples of all of it, four at least."""
    late = counts[len(counts) // 2 :]
    middle = len(late) // 2
    return SecondHalf(min(late), max(late), late[-1], max(late[middle:]) - max(late[:middle]))
