"""The voltage that a CSV file asks for, as the virtual actuator can run it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.errors import RecordError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def command_from(path: Path, longest_s: float) -> Array:
    """Return the voltage at every millisecond, shape (n,), from columns t_s and u_V; straight between the rows.

    Raises RecordError: E3601 to E3605 as for measured records, E3612 what is not finite, E3613 time that does not
    ascend, E3630 a voltage out of the actuator's range, E3631 one that lasts longer than `longest_s`.
    """
    import numpy as np

    from edmctl.record.columns import read_voltage
    from edmctl.simulator.actuator import HIGH_V, LOW_V, RATE_HZ

    t_s, u_v = read_voltage(path)
    for wrong, said, hint, code in (
        (~(np.isfinite(t_s) & np.isfinite(u_v)), "is not finite", "Correct or delete it.", "E3612"),
        (np.diff(t_s, prepend=-math.inf) <= 0.0, "is not later than the one before", "Sort by t_s.", "E3613"),
        (
            (u_v < LOW_V) | (u_v > HIGH_V),
            f"is outside {LOW_V:g} to {HIGH_V:g} V",
            "u_V is in volts.",
            "E3630",
        ),
    ):
        if wrong.any():
            row = int(np.argmax(wrong))
            told = f"row {row + 1} ({t_s[row]:g} s, {u_v[row]:g} V) {said}"
            raise RecordError(f"{path}: {told}.", hint=hint, code=code)
    length_s = float(t_s[-1] - t_s[0])
    if length_s > longest_s:
        raise RecordError(
            f"{path} lasts {length_s:.0f} s; {longest_s:g} s is the longest.",
            hint="Cut it into several; t_s is in seconds.",
            code="E3631",
        )
    ticks_s = t_s[0] + np.arange(math.floor(length_s * RATE_HZ + 1e-6) + 1) / RATE_HZ
    return np.asarray(np.interp(ticks_s, t_s, u_v), dtype=np.float64)
