"""A default actuator: the APA400M of Muralidhara et al. 2009, as far as the paper's figures tell.

The paper publishes no parameters of its block H. These were derived from what it does publish: plays of even
density up to 30 V with a small tail, and a creep of 3 % per decade behind all of them, scaled to 445 µm at
150 V. Creep of that size, a gain that is 2.6 % high and a start without memory then reproduce the errors told
of Figs 3a, 3b and 4. It is one plausible actuator, not a measured one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.model import ActuatorModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

LOW_V, HIGH_V = 0.0, 150.0
THRESHOLDS_V = (0.0, 1.5, 4.0, 7.0, 10.0, 13.0, 16.0, 20.0, 24.0, 28.0, 40.0, 55.0)
WEIGHTS_UM_PER_V = (
    *(1.5891, 0.1214, 0.1214, 0.1325, 0.1325, 0.1325),
    *(0.1545, 0.1766, 0.1766, 0.1766, 0.0493, 0.0352),
)
TIME_CONSTANTS_S = (0.01, 0.05, 0.25, 1.25, 6.25, 31.25, 156.25, 781.25)
CREEP_SHARE = 0.021
"""Share of each time constant, 3 % per decade over a spacing of 5."""


def default_model() -> ActuatorModel:
    """Return the default actuator: plays first, the same creep behind the sum of them."""
    weights = np.array(WEIGHTS_UM_PER_V)
    return ActuatorModel(
        thresholds_v=np.array(THRESHOLDS_V),
        knots_v=np.tile([LOW_V, HIGH_V], (len(weights), 1)),
        slopes_um_per_v=weights[:, np.newaxis],
        creep_plays=np.arange(len(weights)),
        time_constants_s=np.array(TIME_CONSTANTS_S),
        creep_um_per_v=np.outer(weights, np.full(len(TIME_CONSTANTS_S), CREEP_SHARE)),
        zero_um=0.0,
        delay_s=0.0,
        low_v=LOW_V,
        high_v=HIGH_V,
    )
