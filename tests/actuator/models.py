"""Actuator models to test with: one fixed, and a hypothesis strategy over the class."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from edmctl.actuator.model import ActuatorModel, ActuatorState

Array = NDArray[np.float64]

LOW_V, HIGH_V = 0.0, 150.0
TAUS_S = (0.02, 0.1, 0.5, 2.5, 12.5, 62.5)


def make_model(
    seed: int = 0, *, hinges: int = 3, plays: int = 6, creep: float = 0.02, delay_s: float = 0.0
) -> ActuatorModel:
    """A model of about 3 µm/V with slopes that vary from piece to piece."""
    rng = np.random.default_rng(seed)
    thresholds_v: Array = 0.5 * (HIGH_V - LOW_V) * np.power(np.arange(plays) / plays, 1.4)
    slopes = rng.uniform(0.05, 0.3, (plays, hinges))
    slopes[0] += 1.5
    return ActuatorModel(
        thresholds_v=thresholds_v,
        knots_v=np.linspace(LOW_V + thresholds_v, HIGH_V - thresholds_v, hinges + 1, axis=1),
        slopes_um_per_v=slopes,
        creep_plays=np.array([0, plays // 2], dtype=np.int64),
        time_constants_s=np.array(TAUS_S),
        creep_um_per_v=creep * rng.uniform(0.5, 1.5, (2, len(TAUS_S))),
        zero_um=-3.0,
        delay_s=delay_s,
        low_v=LOW_V,
        high_v=HIGH_V,
    )


models = st.builds(
    make_model,
    seed=st.integers(0, 10_000),
    hinges=st.integers(1, 5),
    plays=st.integers(2, 12),
    creep=st.sampled_from([0.0, 0.02, 0.1]),
)


def rounded_model(
    limits_v: tuple[float, float] = (20.0, 28.0),
    sharpness: float = 0.5,
    unloading: float = 0.6,
    lag_s: float = 0.0,
) -> ActuatorModel:
    """A model with a rounded play that creeps, of half the slope."""
    plain = make_model(creep=0.01)
    return replace(
        plain,
        rounded_limits_v=np.array([limits_v]),
        rounded_sharpness=np.array([sharpness]),
        rounded_unloading=np.array([unloading]),
        rounded_um_per_v=np.array([0.5]),
        creep_plays=np.append(plain.creep_plays, 6),
        creep_um_per_v=np.vstack([plain.creep_um_per_v, plain.creep_um_per_v[:1]]),
        lag_s=lag_s,
    )


rounded_models = st.builds(
    rounded_model,
    limits_v=st.tuples(st.floats(1.0, 75.0), st.floats(1.0, 75.0)),
    sharpness=st.floats(0.0, 1.0),
    unloading=st.floats(0.0, 2.0),
    lag_s=st.sampled_from([0.0, 0.002, 0.02]),
)
voltages = st.lists(st.floats(LOW_V, HIGH_V), min_size=2, max_size=40)


def clock(samples: int, step_s: float = 0.01) -> Array:
    """Evenly spaced times."""
    times_s: Array = step_s * np.arange(samples, dtype=np.float64)
    return times_s


def driven(model: ActuatorModel, t_s: Array, u_v: Array) -> ActuatorState:
    """State after a voltage, shape (n,), from a conditioned start at its first sample."""
    state = ActuatorState.conditioned(model, float(u_v[0]))
    state.t_s = float(t_s[0])
    model.advance(state, t_s, u_v)
    return state


THRESHOLDS_V = (0.0, 1.5, 4.0, 7.0, 10.0, 13.0, 16.0, 20.0, 24.0, 28.0, 40.0, 55.0)
WEIGHTS_UM_PER_V = (
    *(1.5891, 0.1214, 0.1214, 0.1325, 0.1325, 0.1325),
    *(0.1545, 0.1766, 0.1766, 0.1766, 0.0493, 0.0352),
)
"""The APA400M of Muralidhara et al. 2009, as far as the figures of the paper tell.

The paper publishes no parameters of its block H. These were derived from what it does publish: plays of even
density up to 30 V with a small tail, and a creep of 3 % per decade behind all of them, scaled to 445 µm at
150 V. Creep of that size, a gain that is 2.6 % high and a start without memory then reproduce the errors told
of Figs 3a, 3b and 4. It is one plausible actuator, not a measured one.
"""
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


def play(actuator_v: Array, threshold_v: float) -> Array:
    """One play operator, written out."""
    out = np.empty_like(actuator_v)
    z = float(actuator_v[0])
    for k, u in enumerate(actuator_v.tolist()):
        z = max(u - threshold_v, min(u + threshold_v, z))
        out[k] = z
    return out
