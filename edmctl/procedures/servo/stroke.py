"""How much way the actuator still has, by its model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from edmctl.actuator.estimator import Estimator


def stroke_left_um(estimator: Estimator, limit_v: float) -> float:
    """Way in µm from where the actuator is now to where it comes at once by `limit_v`."""
    here_v = estimator.state.u_v
    return estimator.gain * (_raw_um(estimator, max(here_v, limit_v)) - _raw_um(estimator, here_v))


def _raw_um(estimator: Estimator, u_v: float) -> float:
    state = estimator.state.copy()
    return float(estimator.model.advance(state, np.array([state.t_s]), np.array([u_v]))[0])
