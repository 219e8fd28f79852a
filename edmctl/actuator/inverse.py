"""The exact inverse: which voltage brings the tool where it is wanted (feed-forward).

The displacement rises strictly with the voltage from any state, so there is one answer, found by a bracketed
root search to the last bit. For one hinge per play and no creep it is the Maxwell form of `maxwell`. The
model's pure delay is left out: nothing can act before it is asked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.samples import consecutive

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.state import ActuatorState

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Solution:
    """A voltage that was looked for; `saturated` where none in the range gives the displacement."""

    u_v: float
    saturated: bool


class Inverse:
    """Turns wanted displacements into voltages, following the actuator's state.

    Voltages keep to the model's range; beyond it the nearer end is given and said to be saturated.
    """

    def __init__(self, model: ActuatorModel, state: ActuatorState) -> None:
        self.model = model
        self.state = state

    def tick(self, y_um: float, dt_s: float) -> Solution:
        """Voltage that gives `y_um` at `dt_s` after the last one; the state goes there."""
        u_v, saturated = self.solve(np.array([self.state.t_s + dt_s]), np.array([y_um]))
        return Solution(float(u_v[0]), bool(saturated[0]))

    def solve(self, t_s: Array, y_um: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Voltages, shape (n,), that give y_um, shape (n,), and where they are saturated.

        Raises ValueError for arrays that are not one-dimensional, equally long, finite, or whose time runs back.
        """
        from edmctl.actuator.operators import solve_bank

        model, state = self.model, self.state
        times_s, wanted_um = consecutive(t_s, y_um, state.t_s)
        u_v, beyond = np.empty(len(times_s)), np.zeros(len(times_s), dtype=np.bool_)
        if len(times_s):
            solve_bank(
                times_s,
                wanted_um - model.zero_um,
                state.t_s,
                model.low_v,
                model.high_v,
                model.thresholds_v,
                model.knots_v,
                model.slopes_um_per_v,
                model.creep_plays,
                model.time_constants_s,
                model.creep_um_per_v,
                state.plays_v,
                state.lags_v,
                np.empty((3, len(model.time_constants_s))),
                u_v,
                beyond,
            )
            state.u_v, state.t_s = float(u_v[-1]), float(times_s[-1])
        return u_v, beyond
