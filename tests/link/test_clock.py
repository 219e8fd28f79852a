"""Controller time by the host's clock: offset, rate, and what a jittery line does to them."""

from __future__ import annotations

from random import Random

import pytest

from edmctl.link.clock import ClockFit
from edmctl.link.statistics import LONGEST_S, SHORTEST_S, RetransmitTimer

OFFSET_S = 1234.5


def fitted(seconds: float, rate: float, jitter_s: float, seed: int = 1, period_s: float = 0.05) -> ClockFit:
    """A fit after heartbeats every 50 ms whose ways there and back take up to `jitter_s` each."""
    random, fit, sent_s = Random(seed), ClockFit(), 100.0
    while sent_s < 100.0 + seconds:
        there_s, back_s = (0.0005 + jitter_s * random.random() for _ in range(2))
        fit.note(sent_s, sent_s + there_s + back_s, OFFSET_S + rate * (sent_s + there_s))
        sent_s += period_s
    return fit


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("drift", [0.0, 50e-6, -50e-6])
def test_controller_time_is_known_to_a_millisecond_on_a_line_with_5_ms_of_jitter(
    seed: int, drift: float
) -> None:
    line = fitted(60.0, 1.0 + drift, 0.005, seed).line
    for host_s in (130.0, 160.0, 161.0):
        assert line.at(host_s) == pytest.approx(OFFSET_S + (1.0 + drift) * host_s, abs=1e-3)
    assert 1e6 * (line.rate - 1.0 - drift) == pytest.approx(0.0, abs=50.0)


def test_the_rate_of_a_young_fit_is_not_taken_from_its_jitter() -> None:
    assert fitted(0.2, 1.0, 0.002, period_s=0.02).line.rate == 1.0


def test_a_clock_that_runs_ten_times_as_fast_is_followed_at_once() -> None:
    line = fitted(0.2, 10.0, 0.0005, period_s=0.02).line
    assert line.rate == pytest.approx(10.0, rel=0.02)


def test_before_any_heartbeat_the_clocks_are_equal() -> None:
    line = ClockFit().line
    assert (line.at(5.0), line.rate) == (5.0, 1.0)


def test_what_lies_more_than_a_minute_back_is_forgotten() -> None:
    fit = fitted(60.0, 1.0, 0.0)
    for beat in range(1300):
        sent_s = 200.0 + 0.05 * beat
        fit.note(sent_s, sent_s + 0.001, OFFSET_S + 1.0 + sent_s + 0.0005)
    assert fit.line.at(270.0) == pytest.approx(OFFSET_S + 271.0, abs=1e-4)


def test_a_command_is_repeated_after_the_usual_round_trip_and_its_scatter() -> None:
    trips = RetransmitTimer()
    assert trips.timeout_s == 0.1
    assert trips.quantile_s(0.5) == 0.0
    for _ in range(100):
        trips.note(0.0001)
    assert trips.timeout_s == SHORTEST_S
    for round_trip_s in (0.03, 0.05) * 100:
        trips.note(round_trip_s)
    assert 0.05 < trips.timeout_s < 0.1
    for _ in range(100):
        trips.note(2.0)
    assert trips.timeout_s == LONGEST_S
    assert trips.quantile_s(0.99) == 2.0
