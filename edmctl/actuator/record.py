"""A measured record: what was applied to the actuator, and where the tool went."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class Record(NamedTuple):
    """Consecutive samples of one measurement.

    t_s, u_v, y_um : ndarray, shape (n,)
        Time (strictly ascending), voltage applied to the actuator, displacement of the tool.
    previous_v : float or None
        Voltage that the actuator was held at before the first sample. None: it had been cycling over the
        record's own range, and comes from the end that the first move leads away from.
    name : str
        What messages call it.
    """

    t_s: Array
    u_v: Array
    y_um: Array
    previous_v: float | None = None
    name: str = "record"
