"""The electromechanical model of Muralidhara et al. 2009, with its hysteresis as Maxwell slip elements.

Maxwell slip gives the voltage for a displacement: u = k_0·Z + Σ k_i·stop_i(Z). Plays give the displacement for
a voltage: Z = Σ w_i·play_i(u). Each is the other's exact inverse. With W_i = w_0 + … + w_i and thresholds r_i,

    k_0 = 1/W_n,   k_i = 1/W_{i−1} − 1/W_i,   limit_i = Σ_{j<i} w_j·(r_i − r_j),

the last being the initial loading curve at r_i. So the block H of Muralidhara et al. 2009, Fig. 2 can be
identified as plays, a convex problem, and reported as the elements it is made of. It also follows what such a
model cannot do: its loops are symmetric and the same everywhere in the range, and know no time. The operators are in
C (firmware/operators).
"""

from __future__ import annotations

import cmath
import ctypes
from collections.abc import Sequence
from ctypes import c_int64, c_void_p
from typing import NamedTuple

import numpy as np

from edmctl.actuator.model import address_of, call, contiguous
from edmctl.array_types import Array
from edmctl.dataclasses import dataclass, field

UM_PER_M = 1e6


class Elements(ctypes.Structure):
    """Elasto-slip elements, `struct elements`: stiffness, limits and stretch, shape (n,); C changes the last.

    Raises ValueError when they are not equally long.
    """

    _fields_ = [("n", c_int64), *((name, c_void_p) for name in ("stiffness", "limits", "stops"))]

    def __init__(self, stiffness: Array, limits: Array, stops: Array) -> None:
        if not stiffness.shape == limits.shape == stops.shape == (len(stops),):
            raise ValueError(f"a state of shape {stops.shape} for {stiffness.size} elements")
        self._arrays = (contiguous(stiffness), contiguous(limits), stops)  # kept as long as their addresses
        super().__init__(len(stops), *(one.ctypes.data for one in self._arrays[:2]), address_of(stops))


@dataclass(slots=True)
class MaxwellState:
    """Displacement of a Maxwell model, and the stretch of each element, shape (n,), which changes in place."""

    position_um: float
    stops_um: Array


@dataclass(frozen=True, slots=True)
class HysteresisBlock:
    """The block H: voltage over charge.

    limits_v, capacitances_f : shape (n,), elasto-slip elements: a capacitor each, in series with a voltage limiter
    remainder_per_f : 1/C_r of the capacitor that never slips; 0 where there is none
    """

    limits_v: Array
    capacitances_f: Array
    remainder_per_f: float


@dataclass(frozen=True, slots=True, eq=False)
class MaxwellModel:
    """Elasto-slip elements in parallel with a plain spring.

    base_v_per_um : stiffness k_0 > 0 of the spring that never slips
    stiffness_v_per_um, limits_um : shape (n,), elements k_i ≥ 0 with the stretch at which they slip, ascending

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
        return self._advanced("maxwell_loads", y_um, state)

    def displacement(self, u_v: Array, state: MaxwellState | None = None) -> Array:
        """Displacement in µm under a voltage, shape (k,). `state` advances; default: virgin."""
        return self._advanced("maxwell_positions", u_v, state)

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

    def _advanced(self, function: str, values: Array, state: MaxwellState | None) -> Array:
        state = self.virgin() if state is None else state
        path = np.ascontiguousarray(values, dtype=np.float64)
        elements = Elements(self.stiffness_v_per_um, self.limits_um, state.stops_um)
        output = np.empty(len(path))
        call(function, elements, self.base_v_per_um, state.position_um, len(path), path, output)
        if len(path):
            state.position_um = float((path if function == "maxwell_loads" else output)[-1])
        return output


@dataclass(frozen=True, slots=True)
class Transducer:
    """Table 1 of the paper without the material, in SI units, and what follows from it.

    Two entries differ from the print. k_p is 6e7 N/m, not 6e6: the row's own material gives 5.6e7 for one
    stack, and only so do T and C make a possible coupling factor. k_a is 6 N/µm, not 6 N/mm: with both, the
    printed T = 14 is 2·n·d33·(k_p + k_a) within 0.4 %. Voltage and displacement alone identify none of T, C,
    k_p and k_a: they are not to be fitted.
    """

    mass_kg: float = 0.00481
    stack_n_per_m: float = 6e7
    damping_n_s_per_m: float = 150.0
    capacitance_f: float = 4e-6
    transformer_n_per_v: float = 14.0
    flexure_n_per_m: float = 6e6
    lever: float = 18.0

    @property
    def stiffness_n_per_m(self) -> float:
        """Stacks and flexure together, k_p + k_a."""
        return self.stack_n_per_m + self.flexure_n_per_m

    @property
    def transduction_v_per_um(self) -> float:
        """Voltage behind H per displacement of the tool, (k_p + k_a)/(T·D_a)."""
        return self.stiffness_n_per_m / (self.transformer_n_per_v * self.lever * UM_PER_M)

    @property
    def charge_c_per_m(self) -> float:
        """Charge per displacement of the stacks at rest without load, T + C·(k_p + k_a)/T."""
        return self.transformer_n_per_v + (
            self.capacitance_f * self.stiffness_n_per_m / self.transformer_n_per_v
        )


TABLE_1 = Transducer()


@dataclass(slots=True)
class ElectromechanicalState:
    """Motion of the stacks, the force on them, charge, and charge stretch of the elements of H, shape (n,)."""

    position_m: float
    speed_m_s: float
    force_n: float
    charge_c: float
    stops_c: Array


class Response(NamedTuple):
    """What the model does at each sample; ndarrays of shape (k,)."""

    y_um: Array
    charge_c: Array
    transducer_v: Array


@dataclass(frozen=True, slots=True, eq=False)
class ElectromechanicalModel:
    """A transducer behind a block H."""

    transducer: Transducer
    block: HysteresisBlock

    @classmethod
    def from_maxwell(cls, maxwell: MaxwellModel, transducer: Transducer = TABLE_1) -> ElectromechanicalModel:
        """Return the model that behaves quasi-statically as `maxwell`.

        Raises ValueError when the transducer is too stiff for it.
        """
        block = maxwell.block(transducer.charge_c_per_m, transducer.transduction_v_per_um, transducer.lever)
        return cls(transducer, block)

    def virgin(self) -> ElectromechanicalState:
        return ElectromechanicalState(0.0, 0.0, 0.0, 0.0, np.zeros(len(self.block.limits_v)))

    def conditioned(self, low_v: float, high_v: float) -> ElectromechanicalState:
        """State at rest at `low_v` after full swings between the two."""
        state = self.virgin()
        turns = np.repeat([high_v, low_v, high_v, low_v], 2)
        self.simulate(turns, 1.0, state=state)
        return state

    def simulate(
        self,
        u_v: Array,
        step_s: float,
        force_n: Array | float = 0.0,
        state: ElectromechanicalState | None = None,
    ) -> Response:
        """Response to a voltage and a force on the tool, sampled every `step_s`, shape (k,) each.

        Both are straight lines between samples, from the state on, which advances (default: virgin).
        """
        state = self.virgin() if state is None else state
        part, block = self.transducer, self.block
        volts = np.ascontiguousarray(u_v, dtype=np.float64)
        forces = np.ascontiguousarray(np.broadcast_to(force_n, (len(volts),)), dtype=np.float64) * part.lever
        constants = np.append(
            self._propagator(step_s), [part.transformer_n_per_v, part.capacitance_f, block.remainder_per_f]
        )
        elements = Elements(1.0 / block.capacitances_f, block.limits_v * block.capacitances_f, state.stops_c)
        motion = np.array([state.position_m, state.speed_m_s, state.force_n, state.charge_c])
        response = Response(*(np.empty(len(volts)) for _ in range(3)))
        call("transducer_advance", constants, elements, motion, len(volts), volts, forces, *response)
        state.position_m, state.speed_m_s, state.force_n, state.charge_c = motion.tolist()
        response.y_um[:] *= part.lever * UM_PER_M
        return response

    def _propagator(self, step_s: float) -> Array:
        """Exact step of the oscillator at a force that goes straight from f0 to f1.

        Returns (2, 4): position and speed from position, speed, f0 and f1.
        """
        part = self.transducer
        stiffness = part.stiffness_n_per_m + part.transformer_n_per_v**2 / part.capacitance_f
        decay = part.damping_n_s_per_m / (2.0 * part.mass_kg)
        square = stiffness / part.mass_kg
        turn = cmath.sqrt(square - decay**2)
        cosine = (cmath.exp(-decay * step_s) * cmath.cos(turn * step_s)).real
        sine = (cmath.exp(-decay * step_s) * cmath.sin(turn * step_s) / turn).real
        free = np.array([[cosine + decay * sine, sine], [-square * sine, cosine - decay * sine]])
        held = np.array([1.0 / stiffness, 0.0])
        lag = -part.damping_n_s_per_m / stiffness**2
        rising = np.array([lag, 1.0 / stiffness]) / step_s
        constant = held - free @ held
        ramp = held + rising - free @ rising
        return np.column_stack([free, constant - ramp, ramp])
