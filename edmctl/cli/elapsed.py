"""Time that has passed between commands, by a clock that people may set."""

from __future__ import annotations

import math
import time

CLOCK_STEP_S = 60.0
"""A clock may be put right by so much: in that time a zero drifts by 0.1 µm, less than a touch repeats."""


def passed_since_s(utc_s: float) -> float:
    """How long ago something was written down; infinity where the clock was set back since."""
    passed_s = time.time() - utc_s
    return max(0.0, passed_s) if passed_s >= -CLOCK_STEP_S else math.inf
