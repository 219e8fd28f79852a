"""Time that has passed between commands: by the calendar, which people may set, or by a virtual bench's own time."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

CLOCK_STEP_S = 60.0
"""A clock may be put right by so much: in that time a zero drifts by 0.1 µm, less than a touch repeats."""


@dataclass(frozen=True, slots=True)
class Now:
    """The present of a machine. `bench_s` is the time of a virtual bench in this process, NaN on any other machine.

    Such a bench stands still between commands, and each of them lets its own time pass, whether or not a ledger
    tells of it. So whatever is written down of a machine has both times, and one of them counts.
    """

    bench_s: float = math.nan

    def time_of(self, utc_s: float, bench_s: float) -> float:
        """Of two times that were written down, the one that counts, s; NaN where it was not told."""
        return utc_s if math.isnan(self.bench_s) else bench_s

    def since_s(self, utc_s: float, bench_s: float) -> float:
        """How long ago that was, s; infinity where nobody knows: a clock was set back since, or was not told."""
        if math.isnan(self.bench_s):
            passed_s = time.time() - utc_s
            return max(0.0, passed_s) if passed_s >= -CLOCK_STEP_S else math.inf
        passed_s = self.bench_s - bench_s
        return passed_s if passed_s >= 0.0 else math.inf


CALENDAR = Now()
