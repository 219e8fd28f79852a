"""Ramps and jumps solved beforehand end where they were meant to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.actuator.inverse import Inverse, jump_volts, ramp_by, travel_by
from edmctl.actuator.model import Estimator

from .models import make_model

if TYPE_CHECKING:
    from edmctl.actuator.model import ActuatorModel

RATE_HZ = 1000.0


def lowered(model: ActuatorModel, to_v: float = 60.0) -> Estimator:
    """An estimator that came up from 0 V at 20 V/s and has rested a second."""
    estimator = Estimator(model)
    go(estimator, to_v, to_v / 20.0)
    go(estimator, to_v, 1.0)
    return estimator


def go(estimator: Estimator, to_v: float, duration_s: float) -> float:
    """Ramp in time; the displacement at the end."""
    steps = round(duration_s * RATE_HZ)
    share = np.arange(1, steps + 1) / steps
    state = estimator.state
    u_v = state.u_v + (to_v - state.u_v) * share
    return float(estimator.advance(state.t_s + duration_s * share, u_v)[-1])


def here_um(estimator: Estimator) -> float:
    return estimator.tick(estimator.state.u_v, 0.0)


@pytest.mark.parametrize("distance_um", [100.0, 20.0, -60.0])
def test_a_ramp_ends_at_its_distance_with_creep_on_the_way(distance_um: float) -> None:
    estimator = lowered(make_model())
    estimator.correct(1.02, 7.0)
    start_um, start_v = here_um(estimator), estimator.state.u_v
    goal_v = ramp_by(estimator, distance_um, 60.0)
    assert estimator.state.u_v == start_v
    reached_um = go(estimator, goal_v, abs(goal_v - start_v) / 60.0) - start_um
    assert reached_um == pytest.approx(distance_um, rel=5e-3)


def test_at_once_is_too_much_for_a_ramp() -> None:
    """What the path is for: the voltage that is right at once leaves 2 % more by the end of a slow ramp."""
    estimator = lowered(make_model())
    start_um, start_v = here_um(estimator), estimator.state.u_v
    at_once_v = Inverse(estimator.model, estimator.state).tick(start_um + 100.0, 0.0).u_v
    reached_um = go(estimator, at_once_v, (at_once_v - start_v) / 60.0) - start_um
    assert reached_um > 102.0


def test_a_slow_travel_needs_less_voltage_than_a_fast_one() -> None:
    estimator = lowered(make_model())
    assert travel_by(estimator, 100.0, 1.0) < travel_by(estimator, 100.0, 50.0) - 0.5


def test_a_jump_is_up_at_the_end_of_its_dwell_and_back_to_its_clearance() -> None:
    estimator = lowered(make_model())
    start_um, start_v = here_um(estimator), estimator.state.u_v
    volts = jump_volts(estimator, 60.0, 5.0, travel_s=0.03, dwell_s=0.02)
    go(estimator, start_v - volts.height_v, 0.03)
    top_um = go(estimator, start_v - volts.height_v, 0.02)
    assert start_um - top_um == pytest.approx(60.0, rel=5e-3)
    back_um = go(estimator, start_v - volts.clearance_v, 0.03)
    assert start_um - back_um == pytest.approx(5.0, abs=0.5)
    assert volts.height_v > 60.0 / 2.967  # more than the mean gain says


def test_a_jump_beyond_0_v_goes_as_far_as_the_voltage_does() -> None:
    estimator = lowered(make_model(), 10.0)
    volts = jump_volts(estimator, 300.0, 5.0, travel_s=0.1, dwell_s=0.02)
    assert volts.height_v == 10.0
    assert 0.0 <= volts.clearance_v <= volts.height_v
