"""Whether a calibration holds the voltages that it is used for, at both ends."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from edmctl.actuator.identification import identify
from edmctl.actuator.record import Record
from edmctl.jobs.actuator_trial import run_trial
from edmctl.jobs.actuator_waveforms import Waveform
from edmctl.jobs.calibration.selection import reaches_down, reaches_up


class Range(NamedTuple):
    low_v: float
    high_v: float


@pytest.mark.parametrize(
    ("low_v", "used_v", "reaches"),
    [
        (0.0, (0.0, 120.0), True),
        (18.0, (0.0, 120.0), True),
        (18.1, (0.0, 120.0), False),
        (60.0, (60.0, 120.0), True),
        (60.0, (40.0, 120.0), False),
        (-150.0, (-150.0, 150.0), True),
    ],
)
def test_a_calibration_serves_a_little_below_its_lowest_voltage(
    low_v: float, used_v: tuple[float, float], reaches: bool
) -> None:
    assert reaches_down(Range(low_v, 150.0), *used_v) is reaches


def test_a_calibration_serves_up_to_its_highest_voltage() -> None:
    assert reaches_up(Range(0.0, 120.0), 120.0)
    assert not reaches_up(Range(0.0, 120.0), 120.05)
    assert reaches_up(Range(0.0, 120.0), 120.05, tolerance_v=0.1)


def test_a_waveform_is_told_of_at_both_ends() -> None:
    t_s = np.arange(1000) / 50.0
    u_v = 60.0 - 60.0 * np.cos(t_s)
    plain = Record(t_s, u_v, 3.0 * u_v + np.random.default_rng(1).normal(0.0, 0.2, 1000))
    narrow = replace(identify([plain], delay_s=0.0, folds=2, resamples=0).model, low_v=60.0, high_v=90.0)
    (up, down) = run_trial([Waveform("ramp", np.linspace(0.0, 100.0, 500))], narrow, seed=3).doubts
    assert (up.code, up.message) == ("W8104", "ramp goes up to 100.0 V and the calibration to 90.0 V.")
    assert (down.code, down.message) == ("W8104", "ramp goes down to 0.0 V and the calibration to 60.0 V.")
