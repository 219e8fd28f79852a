"""The Maxwell slip form of hysteresis, and its exact equivalence with the play form.

Maxwell slip gives the voltage for a displacement: u = k_0·Z + Σ k_i·stop_i(Z). Plays give the displacement for
a voltage: Z = Σ w_i·play_i(u). Each is the other's exact inverse. With W_i = w_0 + … + w_i and thresholds r_i,

    k_0 = 1/W_n,   k_i = 1/W_{i−1} − 1/W_i,   limit_i = Σ_{j<i} w_j·(r_i − r_j),

the last being the initial loading curve at r_i. So the block H of Muralidhara et al. 2009, Fig. 2 can be
identified as plays, a convex problem, and reported as the elements it is made of. It also follows what such a
model cannot do: its loops are symmetric and the same everywhere in the range, and know no time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from ctypes import byref

import numpy as np

from edmctl.actuator.operators import Elements
from edmctl.array_types import Array
from edmctl.core.library import library
from edmctl.dataclasses import dataclass, field

UM_PER_M = 1e6


@dataclass(slots=True)
class MaxwellState:
    """Where a Maxwell model is; arrays change in place.

    position_um : displacement; stops_um : ndarray, shape (n,), stretch of each element.
    """

    position_um: float
    stops_um: Array


@dataclass(frozen=True, slots=True)
class HysteresisBlock:
    """The block H: voltage over charge.

    limits_v, capacitances_f : ndarray, shape (n,)
        Elasto-slip elements: a capacitor each, in series with a voltage limiter.
    remainder_per_f : float
        1/C_r of the capacitor that never slips; 0 where there is none.
    """

    limits_v: Array
    capacitances_f: Array
    remainder_per_f: float


@dataclass(frozen=True, slots=True, eq=False)
class MaxwellModel:
    """Elasto-slip elements in parallel with a plain spring.

    base_v_per_um : float, positive
        Stiffness k_0 of the spring that never slips.
    stiffness_v_per_um, limits_um : ndarray, shape (n,)
        Elements k_i ≥ 0 with the stretch at which they slip, ascending.

    Raises ValueError when the numbers are not those of such a model.
    """

    base_v_per_um: float
    stiffness_v_per_um: Array = field(default_factory=lambda: np.empty(0))
    limits_um: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        stiffness, limits = self.stiffness_v_per_um, self.limits_um
        if stiffness.shape != limits.shape or stiffness.ndim != 1:
            raise ValueError("a Maxwell model needs one limit for each element")
        if not (self.base_v_per_um > 0.0 and np.isfinite(self.base_v_per_um)):
            raise ValueError(f"a Maxwell model needs a positive k_0, not {self.base_v_per_um} V/µm")
        if not (np.isfinite(stiffness).all() and (stiffness >= 0.0).all()):
            raise ValueError("a Maxwell model needs stiffnesses that are finite and not negative")
        if not (np.isfinite(limits).all() and (np.diff(limits, prepend=0.0) > 0.0).all()):
            raise ValueError("a Maxwell model needs limits that are positive and ascend")

    @classmethod
    def from_plays(
        cls, thresholds_v: Array | Sequence[float], weights_um_per_v: Array | Sequence[float]
    ) -> MaxwellModel:
        """Return the inverse of Σ w_i·play_i; thresholds ascend from 0, shape (n + 1,) each, w_0 positive.

        A play of weight 0 becomes an element of stiffness 0.
        """
        thresholds = np.asarray(thresholds_v, dtype=np.float64)
        weights = np.asarray(weights_um_per_v, dtype=np.float64)
        if thresholds.shape != weights.shape or thresholds.ndim != 1 or not len(thresholds):
            raise ValueError("plays need one weight for each threshold")
        if thresholds[0] != 0.0 or not (np.diff(thresholds) > 0.0).all():
            raise ValueError("the thresholds of plays ascend from 0")
        if not (weights[0] > 0.0 and (weights >= 0.0).all()):
            raise ValueError("weights are not negative, and the play of threshold 0 has a positive one")
        compliance = np.cumsum(weights)
        loading_um = np.concatenate([[0.0], np.cumsum(compliance[:-1] * np.diff(thresholds))])
        stiffness = weights[1:] / (compliance[:-1] * compliance[1:])
        return cls(float(1.0 / compliance[-1]), stiffness, loading_um[1:])

    def virgin(self) -> MaxwellState:
        """State of a model that was never driven."""
        return MaxwellState(0.0, np.zeros(len(self.limits_um)))

    def conditioned(self, low_v: float, high_v: float) -> MaxwellState:
        """State at `low_v` after full swings between the two."""
        state = self.virgin()
        self.displacement(np.array([high_v, low_v, high_v, low_v]), state)
        return state

    def voltage(self, y_um: Array, state: MaxwellState | None = None) -> Array:
        """Voltage that brings the displacement to `y_um`, shape (k,): the feed-forward inverse of the plays.

        Only turning points matter. `state` advances; default: virgin.
        """
        state = self.virgin() if state is None else state
        path = np.ascontiguousarray(y_um, dtype=np.float64)
        output = self._advanced(library().maxwell_loads, path, state)
        state.position_um = float(path[-1]) if len(path) else state.position_um
        return output

    def displacement(self, u_v: Array, state: MaxwellState | None = None) -> Array:
        """Displacement in µm under a voltage, shape (k,). `state` advances; default: virgin."""
        state = self.virgin() if state is None else state
        path = np.ascontiguousarray(u_v, dtype=np.float64)
        output = self._advanced(library().maxwell_positions, path, state)
        state.position_um = float(output[-1]) if len(path) else state.position_um
        return output

    def block(self, charge_c_per_m: float, transduction_v_per_um: float, lever: float) -> HysteresisBlock:
        """Return the block H whose quasi-static behaviour in the electromechanical model is this one.

        charge_c_per_m : charge drawn per displacement of the stacks, T + C·(k_p + k_a)/T.
        transduction_v_per_um : voltage behind H per displacement of the tool, (k_p + k_a)/(T·D_a).
        lever : D_a.

        Raises ValueError when k_0 is below the latter: no H can make the actuator stiffer than its transducer.
        """
        if self.base_v_per_um < transduction_v_per_um:
            raise ValueError(
                f"the model's k_0 is {self.base_v_per_um:.4g} V/µm, less than the transducer's"
                f" {transduction_v_per_um:.4g} V/µm: it moves farther per volt than the transducer can drive"
            )
        used = self.stiffness_v_per_um > 0.0
        stiffness = self.stiffness_v_per_um[used]
        coulomb_per_um = charge_c_per_m / (lever * UM_PER_M)
        return HysteresisBlock(
            limits_v=stiffness * self.limits_um[used],
            capacitances_f=coulomb_per_um / stiffness,
            remainder_per_f=(self.base_v_per_um - transduction_v_per_um) / coulomb_per_um,
        )

    def _advanced(self, function: Callable[..., None], path: Array, state: MaxwellState) -> Array:
        """Return what the function in C makes of a path, shape (k,); the stops of the state advance."""
        elements = Elements(self.stiffness_v_per_um, self.limits_um, state.stops_um)
        output = np.empty(len(path))
        function(
            byref(elements),
            self.base_v_per_um,
            state.position_um,
            len(path),
            path.ctypes.data,
            output.ctypes.data,
        )
        return output
