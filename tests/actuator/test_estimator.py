import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmctl.actuator.inverse import Inverse, Solution
from edmctl.actuator.model import ActuatorModel, Estimator
from tests.actuator.models import HIGH_V, LOW_V, clock, make_model, models, voltages


@given(models, voltages, st.sampled_from([0.0, 0.004, 0.03]))
@settings(max_examples=60, deadline=None)
def test_ticks_and_blocks_agree(model: ActuatorModel, u_v: list[float], delay_s: float) -> None:
    estimator, blocks = Estimator(model), Estimator(model)
    t_s = np.cumsum(np.full(len(u_v), 0.01))
    ticked = [estimator.tick(u, 0.01) for u in u_v]
    np.testing.assert_allclose(ticked, blocks.advance(t_s, np.array(u_v)), atol=1e-9)


@given(voltages, st.integers(1, 39))
@settings(max_examples=40, deadline=None)
def test_blocks_may_be_cut_anywhere(u_v: list[float], cut: int) -> None:
    model = make_model(delay_s=0.025)
    t_s = clock(len(u_v)) + 0.01
    whole, parts = Estimator(model), Estimator(model)
    joined = np.concatenate(
        [parts.advance(t_s[:cut], np.array(u_v[:cut])), parts.advance(t_s[cut:], np.array(u_v[cut:]))]
    )
    np.testing.assert_allclose(whole.advance(t_s, np.array(u_v)), joined, atol=1e-12)


def test_ticks_and_blocks_may_be_mixed() -> None:
    model = make_model(delay_s=0.004)
    mixed, ticked = Estimator(model), Estimator(model)
    u_v = 75.0 + 70.0 * np.sin(np.arange(60) / 5.0)
    for u in u_v[:20]:
        mixed.tick(u, 0.01)
        ticked.tick(u, 0.01)
    mixed.advance(clock(20) + 0.21, u_v[20:40])
    for u in u_v[20:40]:
        ticked.tick(u, 0.01)
    assert [mixed.tick(u, 0.01) for u in u_v[40:]] == pytest.approx([ticked.tick(u, 0.01) for u in u_v[40:]])


def test_gain_and_offset_correct_what_comes_out() -> None:
    plain, corrected = Estimator(make_model()), Estimator(make_model())
    corrected.correct(1.02, -4.0)
    assert corrected.tick(80.0, 0.01) == pytest.approx(1.02 * plain.tick(80.0, 0.01) - 4.0)
    with pytest.raises(ValueError, match="a gain is positive"):
        corrected.correct(0.0, 0.0)


def test_out_of_reach_is_said_and_the_very_ends_are_not() -> None:
    model = make_model()
    inverse = Inverse(model)
    low_um, high_um = (
        model.predict(np.array([0.0]), np.array([u_v]), inverse.state)[0] for u_v in (LOW_V, HIGH_V)
    )
    assert Inverse(model).tick(low_um, 0.0) == Solution(LOW_V, saturated=False)
    assert Inverse(model).tick(high_um, 0.0) == Solution(HIGH_V, saturated=False)
    assert Inverse(model).tick(low_um - 0.01, 0.0) == Solution(LOW_V, saturated=True)
    assert Inverse(model).tick(high_um + 0.01, 0.0) == Solution(HIGH_V, saturated=True)


@given(models, voltages)
@settings(max_examples=80, deadline=None)
def test_the_inverse_undoes_the_model(model: ActuatorModel, u_v: list[float]) -> None:
    t_s = clock(len(u_v)) + 0.01
    y_um = model.predict(t_s, np.array(u_v), Inverse(model).state)
    found_v, saturated = Inverse(model).solve(t_s, y_um)
    np.testing.assert_allclose(found_v, np.array(u_v), atol=1e-9)
    assert not saturated.any()
    residual_um = model.predict(t_s, found_v, Inverse(model).state) - y_um
    assert np.abs(residual_um).max() <= 1e-9 * model.stroke_um


def test_the_inverse_goes_on_after_saturation() -> None:
    model = make_model()
    inverse, estimator = Inverse(model), Estimator(model)
    for y_um in (100.0, 5000.0, 150.0, -100.0, 120.0):
        found = inverse.tick(y_um, 0.01)
        reached_um = estimator.tick(found.u_v, 0.01)
        assert found.saturated is (y_um in (5000.0, -100.0))
        if not found.saturated:
            assert reached_um == pytest.approx(y_um, abs=1e-9)


@pytest.mark.parametrize(
    ("t_s", "u_v"),
    [
        ([0.0, 1.0, 2.0], [0.0, 1.0]),
        ([0.0, 1.0], [0.0, 1.0, 2.0]),
        ([[0.0], [1.0]], [[0.0], [1.0]]),
        ([0.0, np.nan], [0.0, 1.0]),
        ([0.0, 1.0], [0.0, np.inf]),
        ([1.0, 0.0], [0.0, 1.0]),
    ],
)
def test_samples_that_cannot_be_are_refused(t_s: object, u_v: object) -> None:
    model = make_model()
    with pytest.raises(ValueError, match=r"times|time runs"):
        model.predict(t_s, u_v)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"times|time runs"):
        Inverse(model).solve(t_s, u_v)  # type: ignore[arg-type]


def test_no_samples_give_no_displacement() -> None:
    model = make_model()
    assert model.predict(np.empty(0), np.empty(0)).shape == (0,)
    assert Inverse(model).solve(np.empty(0), np.empty(0))[0].shape == (0,)


@pytest.mark.parametrize(
    ("u_v", "dt_s"), [(np.nan, 0.01), (np.inf, 0.01), (10.0, -0.01), (10.0, np.nan), (10.0, np.inf)]
)
def test_a_tick_that_cannot_be_changes_nothing(u_v: float, dt_s: float) -> None:
    estimator, untouched = Estimator(make_model()), Estimator(make_model())
    estimator.tick(50.0, 0.01)
    untouched.tick(50.0, 0.01)
    with pytest.raises(ValueError, match=r"finite numbers|time runs forwards"):
        estimator.tick(u_v, dt_s)
    assert estimator.tick(60.0, 0.01) == untouched.tick(60.0, 0.01)


def test_a_block_before_the_last_one_changes_nothing() -> None:
    estimator = Estimator(make_model())
    estimator.advance(clock(10) + 5.0, np.full(10, 50.0))
    with pytest.raises(ValueError, match="time runs forwards"):
        estimator.advance(clock(10), np.full(10, 60.0))
    assert estimator.state.u_v == 50.0


def test_lists_and_other_numbers_are_taken_as_they_are() -> None:
    model = make_model()
    expected = model.predict(np.array([0.0, 1.0]), np.array([10.0, 120.0]))
    assert (model.predict([0, 1], [10, 120]) == expected).all()  # type: ignore[arg-type]
    bytes_v = np.array([10, 120], dtype=np.int8)
    assert (model.predict(np.arange(2), bytes_v) == expected).all()  # type: ignore[arg-type]
