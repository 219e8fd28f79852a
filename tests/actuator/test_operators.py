"""Records and arrays that the library in C works on: what it may write, and how long they live."""

import copy
import gc
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from edmctl.actuator.inverse import Inverse
from edmctl.actuator.maxwell import ElectromechanicalModel, MaxwellModel, MaxwellState
from edmctl.actuator.model import ActuatorModel, ActuatorState, Estimator
from edmctl.actuator.operators import Bank
from tests.actuator.models import Array, clock, make_model

T_S = clock(50)
U_V: Array = 60.0 + 50.0 * np.sin(9.0 * T_S)


def predicted(model: ActuatorModel) -> Array:
    return model.predict(T_S, U_V, ActuatorState.conditioned(model, 60.0))


@pytest.mark.parametrize("change", ["cut", "float32", "fortran", "read only"])
def test_c_writes_only_arrays_that_are_the_state_s(change: str) -> None:
    model = make_model()
    state = ActuatorState.conditioned(model)
    wide = np.zeros((2, 12))
    lags: dict[str, Any] = {
        "cut": state.lags_v[:, :-1],
        "float32": state.lags_v.astype(np.float32),
        "fortran": np.asfortranarray(state.lags_v),
        "read only": np.broadcast_to(wide[:, :6], (2, 6)),
    }
    state.lags_v = lags[change]
    for call in (model.advance, lambda state, *record: Inverse(model, state).solve(*record)):
        with pytest.raises(ValueError, match="state"):
            call(state, T_S, U_V)
    with pytest.raises(ValueError, match="state"):
        Estimator(model, state)
    assert not wide.any()
    assert state.t_s == 0.0


def test_parameters_may_lie_in_memory_as_they_like() -> None:
    model = make_model()
    scattered = replace(
        model,
        slopes_um_per_v=np.asfortranarray(model.slopes_um_per_v),
        knots_v=np.repeat(model.knots_v, 2, axis=1)[:, ::2],
        creep_um_per_v=np.asfortranarray(model.creep_um_per_v),
        creep_plays=model.creep_plays.astype(np.int32),
        time_constants_s=np.repeat(model.time_constants_s, 3)[::3],
    )
    np.testing.assert_array_equal(predicted(scattered), predicted(model))
    state = ActuatorState.conditioned(model, 60.0)
    both = np.column_stack([T_S, U_V])
    np.testing.assert_array_equal(model.predict(both[:, 0], both[:, 1], state), predicted(model))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_of_a_model_in_use_has_arrays_of_its_own(copied: object) -> None:
    model = make_model()
    expected = predicted(model)
    other = copied(model)  # type: ignore[operator]
    del model
    gc.collect()
    np.testing.assert_array_equal(predicted(other), expected)


def test_a_bank_has_no_creep_behind_a_play_that_it_has_not() -> None:
    none, one = np.empty(0), np.ones(1)
    with pytest.raises(ValueError, match="fit"):
        Bank(
            one,
            np.ones((1, 2)),
            np.ones((1, 1)),
            np.empty((0, 5)),
            none,
            np.array([1]),
            one,
            np.ones((1, 1)),
            0.0,
        )


def test_elements_of_another_model_are_refused() -> None:
    maxwell = MaxwellModel.from_plays([0.0, 10.0, 20.0], [0.1, 0.1, 0.1])
    with pytest.raises(ValueError, match="2 elements"):
        maxwell.voltage(U_V, MaxwellState(0.0, np.zeros(1)))
    electromechanical = ElectromechanicalModel.from_maxwell(maxwell)
    state = replace(electromechanical.virgin(), stops_c=np.zeros(3))
    with pytest.raises(ValueError, match="2 elements"):
        electromechanical.simulate(U_V, 0.01, state=state)


def test_no_samples_are_no_move() -> None:
    model, none = make_model(delay_s=0.02), np.empty(0)
    estimator = Estimator(model)
    assert estimator.advance(none, none).shape == (0,)
    assert Inverse(model).solve(none, none)[0].shape == (0,)
    assert estimator.state.t_s == 0.0
