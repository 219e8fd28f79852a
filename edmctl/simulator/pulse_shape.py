"""What an oscilloscope would show of a pulse.

The open voltage comes up through the series resistor, breaks down to the plateau at ignition, `delay_us` after the
pulse's begin, and falls when the generator's switch opens, `opens_us` after it; a pulse without ignition has
`delay_us` = `opens_us`. The law and its constants: firmware/plant/pulse_shape.c.
"""

from __future__ import annotations

import numpy as np

from edmctl.array_types import Array
from edmctl.core.library import library

PLATEAU_NOISE = 0.025  # rms over plateau voltage [assumed]
VOLTAGE_NOISE_V, CURRENT_NOISE_A = 0.05, 0.0005  # rms of the converters [assumed]


def pulse_signals(
    t_us: Array, open_v: float, delay_us: float, opens_us: float, plateau_v: float, siemens: float
) -> tuple[Array, Array]:
    """Return voltage, V, and current, A, of a pulse at times since its begin, shape (n,) as `t_us`."""
    t_us = np.ascontiguousarray(t_us)
    v, a = np.empty_like(t_us), np.empty_like(t_us)
    library().pulse_signals(
        len(t_us),
        t_us.ctypes.data,
        open_v,
        delay_us,
        opens_us,
        plateau_v,
        siemens,
        v.ctypes.data,
        a.ctypes.data,
    )
    return v, a
