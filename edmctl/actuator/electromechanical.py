"""The electromechanical model of Muralidhara et al. 2009, §2.1, Fig. 2, with its dynamics.

    V_in = H[q] + V_t            the applied voltage is divided between hysteresis and transducer
    q = T·x + C·V_t              charge through H goes into the transducer and its capacitance
    F_t = T·V_t                  force of the transducer
    m x″ + c x′ + k_p x = F_t − k_a x − D_a·F_Z
    Z = D_a·x                    the flexure amplifies the stacks' displacement; F_Z > 0 pushes the tool back

The structure of H is that of Goldfarb & Celanovic 1997 (`stops`). With V_t eliminated, the charge drives an
oscillator stiffened by T²/C. Between samples charge and force are straight lines, for which the oscillator is
solved exactly; its displacement at the next sample is then a straight line over the charge there, so that
charge, displacement and hysteresis come out of one equation, and any time step is stable: 1 µs to see the
resonance, 1 s where only the quasi-static motion matters.
"""

from __future__ import annotations

import cmath
from ctypes import byref
from typing import NamedTuple

import numpy as np

from edmctl.actuator.maxwell import UM_PER_M, HysteresisBlock, MaxwellModel
from edmctl.actuator.operators import Elements
from edmctl.array_types import Array
from edmctl.core.library import library
from edmctl.dataclasses import dataclass


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

        Both are straight lines between samples, the first from where the state is. `state` advances; default:
        virgin.
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
        library().transducer_advance(
            constants.ctypes.data,
            byref(elements),
            motion.ctypes.data,
            len(volts),
            *(one.ctypes.data for one in (volts, forces, *response)),
        )
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
