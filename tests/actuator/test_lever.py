"""The lever factor comes with an uncertainty that can be believed, or with what is wrong with the data."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from edmctl.actuator.maxwell import autocorrelation_time, lever_factor
from edmctl.errors import RecordError

Array = NDArray[np.float64]

STACK_UM = 12.0 * (1.0 - np.cos(np.linspace(0.0, 4.0 * np.pi, 2000)))


@given(st.floats(2.0, 60.0), st.floats(-100.0, 100.0))
def test_an_exact_lever_is_found_exactly(factor: float, offset_um: float) -> None:
    lever = lever_factor(STACK_UM, factor * STACK_UM + offset_um)
    assert lever.factor == pytest.approx(factor, rel=1e-9)
    assert lever.offset_um == pytest.approx(offset_um, abs=1e-6)
    assert lever.sd < 1e-9


@pytest.mark.parametrize("memory", [0.0, 0.9], ids=["white", "correlated"])
def test_the_error_is_as_large_as_the_uncertainty_says(memory: float) -> None:
    rng = np.random.default_rng(18)
    ratios = []
    for _ in range(100):
        lever = lever_factor(STACK_UM, 18.0 * STACK_UM + 3.0 + noise_um(rng, memory))
        ratios.append((lever.factor - 18.0) / lever.sd)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.2)


def test_correlated_residuals_are_worth_fewer_samples() -> None:
    rng = np.random.default_rng(4)
    assert autocorrelation_time(noise_um(rng, 0.0)) == pytest.approx(1.0, abs=0.2)
    assert autocorrelation_time(noise_um(rng, 0.9)) == pytest.approx(19.0, rel=0.5)


def test_residuals_of_nothing_count_each() -> None:
    assert autocorrelation_time(np.zeros(100)) == 1.0


@pytest.mark.parametrize(
    ("x_um", "z_um", "code", "words"),
    [
        (STACK_UM, STACK_UM[:-1], "E3620", "2000 samples of the stacks' displacement, but 1999"),
        (STACK_UM[:9], STACK_UM[:9], "E3621", "9 samples are too few"),
        (np.where(np.arange(2000) == 6, np.nan, STACK_UM), 18 * STACK_UM, "E3622", "sample 7 "),
        (np.full(2000, 3.0), 18 * STACK_UM, "E3623", "stays at 3 µm"),
        (STACK_UM, -18 * STACK_UM, "E3624", "moves back"),
        (18 * STACK_UM, STACK_UM, "E3625", r"0\.0556 is not that of a flexure"),
        (STACK_UM / 1000.0, 18 * STACK_UM, "E3625", r"1\.8e\+04 is not"),
    ],
    ids=["lengths", "short", "nan", "still", "sign", "swapped", "units"],
)
def test_data_that_are_no_lever_are_named(x_um: Array, z_um: Array, code: str, words: str) -> None:
    with pytest.raises(RecordError, match=words) as refusal:
        lever_factor(x_um, z_um)
    assert refusal.value.code == code
    assert refusal.value.hint


def noise_um(rng: np.random.Generator, memory: float) -> Array:
    white = rng.normal(0.0, 0.3, len(STACK_UM))
    noise = np.empty_like(white)
    last = white[0] / np.sqrt(1.0 - memory**2)
    for k, value in enumerate(white.tolist()):
        last = memory * last + value
        noise[k] = last
    return noise
