"""Errors with and without what differs from sample to sample."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.actuator.validation import ErrorFigures

RANGE_UM = 400.0


def test_noise_is_taken_off_the_errors_and_what_neighbours_share_stays() -> None:
    rng = np.random.default_rng(5)
    t_s = np.arange(0.0, 100.0, 0.005)
    model_um = 0.4 * np.sin(2.0 * np.pi * 0.3 * t_s) + 0.1
    read_um = model_um + rng.normal(0.0, 0.3, len(t_s))
    found = ErrorFigures.without_noise(np.split(read_um, 8), RANGE_UM)
    true = ErrorFigures.over(model_um, RANGE_UM)
    plain = ErrorFigures.over(read_um, RANGE_UM)
    assert found.rms_um == pytest.approx(true.rms_um, rel=0.05)
    assert plain.rms_um > 1.3 * true.rms_um
    assert true.max_um <= found.max_um < plain.max_um
    assert found.range_um == RANGE_UM


def test_without_noise_the_figures_are_those_of_the_errors() -> None:
    t_s = np.arange(0.0, 100.0, 0.005)
    model_um = 0.4 * np.sin(2.0 * np.pi * 0.3 * t_s)
    found = ErrorFigures.without_noise([model_um], RANGE_UM)
    assert found.rms_um == pytest.approx(ErrorFigures.over(model_um, RANGE_UM).rms_um, rel=1e-3)
    assert found.max_um == pytest.approx(0.4, rel=1e-3)


def test_noise_alone_leaves_next_to_nothing() -> None:
    noise_um = np.random.default_rng(6).normal(0.0, 0.3, 20_000)
    assert ErrorFigures.without_noise([noise_um], RANGE_UM).rms_um < 0.03


def test_stretches_that_are_too_short_are_taken_as_they_are() -> None:
    stretches = [np.array([0.3]), np.array([-0.5, 0.1])]
    assert ErrorFigures.without_noise(stretches, RANGE_UM) == ErrorFigures.over(
        np.concatenate(stretches), RANGE_UM
    )
