"""The play operator written out, for data that the operators under test did not make."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def play(actuator_v: Array, threshold_v: float) -> Array:
    """One play operator, written out."""
    out = np.empty_like(actuator_v)
    z = float(actuator_v[0])
    for k, u in enumerate(actuator_v.tolist()):
        z = max(u - threshold_v, min(u + threshold_v, z))
        out[k] = z
    return out
