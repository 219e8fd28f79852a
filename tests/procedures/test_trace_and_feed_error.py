"""What is remembered of the last seconds, and what the estimate is off by while machining."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.machine.interface import MachineState, TelemetryBlock
from edmctl.procedures.estimation import SPAN_S, FeedError, Trace
from tests.procedures.conftest import samples


def block(start_s: float, sensor_um: float, state: MachineState = MachineState.MACHINING) -> TelemetryBlock:
    """50 samples with the sensor at one height."""
    return samples(start_s, np.full(50, sensor_um), state=state)


def test_a_trace_interpolates_and_forgets_what_is_long_past() -> None:
    trace = Trace()
    assert math.isnan(trace.at(0.0))
    for second in range(60):
        times_s = second + np.array([0.0, 0.5])
        trace.append(times_s, 2.0 * times_s)
    assert trace.at(55.25) == pytest.approx(110.5)
    assert trace.at(1e3) == 2.0 * 59.5
    assert 2.0 * (59.5 - SPAN_S - 1.0) <= trace.at(0.0) <= 2.0 * (59.5 - SPAN_S)


def test_the_feed_error_is_largest_and_rms_of_means_while_machining() -> None:
    error = FeedError()
    assert math.isnan(error.max_um)
    assert math.isnan(error.rms_um)
    error.update(block(0.0, 100.0), np.full(50, 101.0))
    error.update(block(0.5, 100.0), np.full(50, 97.0))
    error.update(block(1.0, 100.0, state=MachineState.JUMP), np.full(50, 150.0))
    assert error.max_um == pytest.approx(3.0)
    assert error.rms_um == pytest.approx(math.sqrt((1.0 + 9.0) / 2.0))


def test_noise_of_single_samples_is_averaged_out_of_the_feed_error() -> None:
    error = FeedError()
    noise = 0.15 * np.random.default_rng(1).standard_normal((200, 50))
    for k in range(200):
        error.update(block(0.5 * k, 0.0), noise[k])
    assert error.rms_um == pytest.approx(0.15 / math.sqrt(10.0), rel=0.1)
    assert error.max_um < 0.2
