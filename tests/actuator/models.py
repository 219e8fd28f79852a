"""Actuator models to test with: one fixed, and a hypothesis strategy over the class."""

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
