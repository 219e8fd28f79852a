"""Waveforms of the paper's figures, and what is read off them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.actuator.waveforms import FIGURE_NAMES, figure_command, readings

RATE_HZ = 1000.0


def read(figure: str, error_um: np.ndarray, model_um: np.ndarray | None = None) -> dict[str, float]:
    u_v = figure_command(figure, RATE_HZ)
    found = readings(figure, u_v, error_um, u_v if model_um is None else model_um, RATE_HZ)
    return {reading.what: reading.ours_um for reading in found}


def peak(figure: str, at_s: float, height_um: float) -> np.ndarray:
    """An error of 1 µm everywhere but at one instant."""
    error_um = np.full(len(figure_command(figure, RATE_HZ)), 1.0)
    error_um[round(at_s * RATE_HZ)] = height_um
    return error_um


@pytest.mark.parametrize(
    ("figure", "at_s", "what"),
    [
        ("fig3a", 0.0, "first trough"),
        ("fig3a", 100.0, "later troughs"),
        ("fig3a", 50.0, "away from the troughs"),
        ("fig3b", 2.5, "crests"),
        ("fig4", 0.12, "as the voltage arrives"),
        ("fig4", 20.0 + 0.12 + 0.1, "0.1 s later"),
        ("fig4", 5.62, "5 to 6 s later"),
        ("fig5", 5.0, "rising ramps, the first"),
        ("fig5", 15.0, "rising ramps, later ones"),
        ("fig5", 10.7, "retracted, from 0.1 s on"),
    ],
)
def test_each_reading_is_taken_where_it_says(figure: str, at_s: float, what: str) -> None:
    found = read(figure, peak(figure, at_s, -30.0))
    assert found[what] == 30.0
    others = {name: value for name, value in found.items() if name != what}
    assert others.get("as the voltage arrives", 1.0) in (1.0, 30.0)
    assert all(value == 1.0 for name, value in others.items() if name != "as the voltage arrives")


def test_nothing_is_read_within_a_tenth_of_a_second_of_a_retract() -> None:
    assert max(read("fig5", peak("fig5", 10.05, 30.0)).values()) == 1.0


def test_the_stroke_of_the_loop_is_that_of_its_first_cycle() -> None:
    u_v = figure_command("loop", RATE_HZ)
    assert read("loop", np.zeros(len(u_v)), 3.0 * u_v) == {"stroke at 150 V": pytest.approx(450.0)}


def test_the_papers_own_figures_stand_beside_ours() -> None:
    for figure in FIGURE_NAMES:
        u_v = figure_command(figure, RATE_HZ)
        for reading in readings(figure, u_v, u_v, u_v, RATE_HZ):
            assert math.isnan(reading.paper_low_um) == (reading.paper in ("–", "small"))
            assert not reading.paper_low_um > reading.paper_high_um


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bias_that_is_left_is_on_the_side_of_the_error_that_it_is_left_of(sign: float) -> None:
    u_v = figure_command("fig4", RATE_HZ)
    arrival = np.flatnonzero(np.diff(u_v) > 0.0)[-1] + 1
    error_um = np.zeros(len(u_v))
    error_um[arrival : arrival + round(RATE_HZ)] = 30.0 * sign
    error_um[arrival + round(5.5 * RATE_HZ)] = -2.0 * sign
    found = {one.what: one for one in readings("fig4", u_v, error_um, u_v, RATE_HZ)}
    assert found["5 to 6 s later"].ours_um == 2.0
    assert found["5 to 6 s later"].paper_side == found["as the voltage arrives"].paper_side == sign


def test_a_figure_of_another_name_is_no_figure() -> None:
    with pytest.raises(KeyError):
        readings("fig7", np.zeros(3), np.zeros(3), np.zeros(3), RATE_HZ)
