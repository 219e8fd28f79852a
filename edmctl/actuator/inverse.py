"""The exact inverse: the voltage for a displacement (feed-forward), for one sample or a whole move.

The displacement rises strictly with the voltage from any state, so a bracketed root search finds the one answer. The
model's delay is left out. Its lag is inverted sample by sample, and left out of moves, which outlast it.

Creep continues during a ramp (3 % of the way per decade of time), so a move is solved as a path in time from the
estimator's present state. Moves are distances: the zeros of sensor and model cancel. If no voltage in the model's
range is enough, a move ends short.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.model import ActuatorModel, ActuatorState, Estimator, call, consecutive
from edmctl.array_types import Array
from edmctl.dataclasses import dataclass

STEPS = 32  # points of a path; more of them change its end by less than 0.1 % of the way


@dataclass(frozen=True, slots=True)
class Solution:
    """A voltage that was looked for; `saturated` where none in the range gives the displacement."""

    u_v: float
    saturated: bool


class Inverse:
    """Turns displacements into voltages, from a copy of `state` on (default: conditioned, at the low end).

    Voltages keep to the model's range; beyond it the nearer end is returned as saturated.
    """

    def __init__(self, model: ActuatorModel, state: ActuatorState | None = None) -> None:
        self.model = model
        self.state = model.own_state(state)

    def tick(self, y_um: float, dt_s: float) -> Solution:
        """Voltage that gives `y_um` at `dt_s` after the last one; the state goes there."""
        u_v, saturated = self.solve(np.array([self.state.t_s + dt_s]), np.array([y_um]))
        return Solution(float(u_v[0]), bool(saturated[0]))

    def solve(self, t_s: Array, y_um: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Voltages, shape (n,), that give y_um, shape (n,), and where they are saturated.

        Raises ValueError for arrays that are not one-dimensional, equally long, finite, or whose time runs back.
        """
        model, state = self.model, self.state
        times_s, wanted_um = consecutive(t_s, y_um, state.t_s)
        free_um = wanted_um - model.zero_um
        u_v, beyond = np.empty(len(times_s)), np.zeros(len(times_s), dtype=np.bool_)
        memory, ends_v = state.memory(model), (model.low_v, model.high_v)
        call("bank_solve", model.bank, memory, len(times_s), times_s, free_um, *ends_v, u_v, beyond)
        state.move_to(memory)
        return u_v, beyond


@dataclass(frozen=True, slots=True)
class JumpVolts:
    """A jump as voltages below the one where it begins: at its top, and where its return ends."""

    height_v: float
    clearance_v: float


def ramp_by(estimator: Estimator, distance_um: float, slew_v_s: float) -> float:
    """Voltage to ramp to at `slew_v_s`, so that the tool has moved by `distance_um` when the ramp ends."""
    way_um = distance_um / estimator.gain
    at_once_v = _path(_inverse(estimator), way_um, 0.0)
    return _path(_inverse(estimator), way_um, abs(at_once_v - estimator.state.u_v) / slew_v_s)


def travel_by(estimator: Estimator, distance_um: float, speed_um_s: float) -> float:
    """Voltage at which the tool has moved by `distance_um`, going there at `speed_um_s`."""
    return _path(_inverse(estimator), distance_um / estimator.gain, abs(distance_um) / speed_um_s)


def jump_volts(
    estimator: Estimator, height_um: float, clearance_um: float, travel_s: float, dwell_s: float
) -> JumpVolts:
    """Voltages of a jump: up in `travel_s`, at `height_um` as the dwell ends, back to `clearance_um`."""
    start_v, start_um = estimator.state.u_v, _height_um(_inverse(estimator))
    wanted_um = height_um / estimator.gain
    _, top_um, _ = _lifted(estimator, wanted_um, travel_s, dwell_s)
    creep_um = max(0.0, start_um - top_um - wanted_um)
    top_v, top_um, inverse = _lifted(estimator, wanted_um - creep_um, travel_s, dwell_s)
    height_v = max(0.0, start_v - top_v)
    back_um = start_um - clearance_um / estimator.gain - top_um
    clearance_v = start_v - _path(inverse, back_um, travel_s)
    return JumpVolts(height_v, min(max(0.0, clearance_v), height_v))


def _lifted(
    estimator: Estimator, distance_um: float, travel_s: float, dwell_s: float
) -> tuple[float, float, Inverse]:
    """Lift by a distance and dwell; return the voltage, the displacement after creep, and the inverse."""
    inverse = _inverse(estimator)
    top_v = _path(inverse, -distance_um, travel_s)
    inverse.model.advance(inverse.state, np.array([inverse.state.t_s + dwell_s]), np.array([top_v]))
    return top_v, _height_um(inverse), inverse


def _inverse(estimator: Estimator) -> Inverse:
    """Return the inverse without the lag, which is shorter than any move."""
    return Inverse(estimator.model.without_lag, estimator.state)


def _height_um(inverse: Inverse) -> float:
    return inverse.model.at_once_um(inverse.state, inverse.state.u_v)


def _path(inverse: Inverse, distance_um: float, duration_s: float) -> float:
    share = np.arange(1, STEPS + 1) / STEPS
    start_um = _height_um(inverse)
    u_v, _ = inverse.solve(inverse.state.t_s + duration_s * share, start_um + distance_um * share)
    return float(u_v[-1])
