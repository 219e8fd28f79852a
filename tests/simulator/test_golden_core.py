"""Plant, controller and operators give the recorded bytes, with every compiler and on every machine."""

from __future__ import annotations

import pytest

from benchmarks import kernel
from tests.firmware.schedules import Schedule, WideSchedule
from tests.simulator.golden_core import (
    BANKS,
    SAMPLE,
    SAMPLE_SEEDS,
    SCHEDULES,
    WIDE,
    golden,
    operators,
    schedule,
    session,
)
from tests.tiers import tiers

SOME, SOME_WIDE = SAMPLE_SEEDS


def test_the_recorded_digests_are_those_of_all_sessions_and_schedules() -> None:
    recorded = golden()
    assert recorded["sessions"].keys() == kernel.sessions().keys() > set(SAMPLE)
    assert list(map(int, recorded["schedules"])) == list(SCHEDULES)
    assert list(map(int, recorded["wide"])) == list(WIDE)
    assert list(map(int, recorded["operators"])) == list(BANKS)
    digests = [digest for group in ("schedules", "wide", "operators") for digest in recorded[group].values()]
    assert len(set(digests)) == len(digests)


@pytest.mark.parametrize("name", tiers(*SAMPLE, slow=[n for n in kernel.sessions() if n not in SAMPLE]))
def test_a_session_gives_the_recorded_bytes(name: str) -> None:
    assert session(name) == golden()["sessions"][name]


@pytest.mark.parametrize("seed", tiers(*SCHEDULES[:SOME], slow=SCHEDULES[SOME:]))
def test_a_random_schedule_gives_the_recorded_bytes(seed: int) -> None:
    assert schedule(Schedule, seed) == golden()["schedules"][str(seed)]


@pytest.mark.parametrize("seed", tiers(*WIDE[:SOME_WIDE], slow=WIDE[SOME_WIDE:]))
def test_parameters_of_any_value_and_failed_readings_give_the_recorded_bytes(seed: int) -> None:
    assert schedule(WideSchedule, seed) == golden()["wide"][str(seed)]


@pytest.mark.parametrize("seed", BANKS)
def test_the_operators_give_the_recorded_bytes(seed: int) -> None:
    assert operators(seed) == golden()["operators"][str(seed)]


def test_a_constant_of_the_plant_changes_the_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison can fail."""
    monkeypatch.setattr("edmctl.simulator.plant.Plant.stage_lands", lambda *_: None)
    assert session("seed 1") != golden()["sessions"]["seed 1"]
