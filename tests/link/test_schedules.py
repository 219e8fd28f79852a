"""Whatever the line does, a command acts once, or fails cleanly and acts at most once."""

from __future__ import annotations

from tests.link.lossy import Faults
from tests.link.schedules import Tally, run_schedule


def test_a_command_acts_once_or_fails_cleanly() -> None:
    tally = Tally()
    for seed in range(60):
        run_schedule(seed, tally)
    assert tally.breaches == []
    assert tally.done > 100
    assert tally.lost > 0
    assert tally.retries > 20


def test_a_good_line_needs_no_repetition() -> None:
    tally = Tally()
    for seed in range(3):
        run_schedule(seed, tally, Faults())
    assert (tally.breaches, tally.retries) == ([], 0)
