"""Plant and controller share nothing but two records, and anything that knows these is a controller."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from edmctl.simulator import BenchConfig
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_records import Drive, Readings

FIRMWARE = Path(__file__).parents[2] / "firmware"


@pytest.mark.parametrize(
    ("half", "headers"),
    [
        (
            "plant",
            {
                "../export.h",
                "plant.h",
                "plant_records.h",
                "../math/elementary.h",
                "stdbool.h",
                "stdint.h",
                "stdlib.h",
            },
        ),
        ("core", set()),
    ],
)
def test_a_half_includes_nothing_of_the_other(half: str, headers: set[str]) -> None:
    sources = sorted((FIRMWARE / half).glob("*.[ch]"))
    assert len(sources) > 4
    for source in sources:
        included = set(re.findall(r'#include [<"]([^>"]+)[>"]', source.read_text(encoding="utf-8")))
        assert not headers or included <= headers, source.name
        assert not any("plant" in name or "host" in name for name in included) or half == "plant", source.name


class ByHand:
    """Another controller: it steps down until the gap voltage falls, then keeps it by little steps both ways."""

    def __init__(self) -> None:
        self.pulses = 0

    def __call__(self, readings: Readings, drive: Drive) -> None:
        if not drive.pulses_on:
            drive.pulses_on = 1
            drive.pulse_starts += 1
        self.pulses += readings.pulses
        sparks = readings.pulses > 0 and min(readings.plateau_v[: readings.pulses]) < 30.0
        step_v = -0.005 if sparks and readings.gap_v < 9.6 else 0.0025
        drive.actuator_v = max(0.0, drive.actuator_v + step_v)


def test_a_plain_callable_drives_the_plant() -> None:
    plant, by_hand = Plant(BenchConfig(offset_um=5.0), 1), ByHand()
    plant.stage_lands(0, 0.0)
    plant.advance(by_hand, 5000)
    assert plant.readings.tick == 5000
    assert by_hand.pulses == pytest.approx(5000 * 2.3, rel=0.01)
    assert plant.state.depth_um > 0.3
    assert plant.state.wear_um > 0.05
    assert abs(plant.readings.sensor_um - plant.state.true_z_um) < 1.0


def test_pulses_that_were_due_long_ago_are_not_made_up_for() -> None:
    """As after a loss of power, when a controller counts its starts anew."""
    plant = Plant(BenchConfig(offset_um=5.0), seed=1)
    plant.drive.pulses_on = 1
    plant.drive.pulse_starts = plant.state.pulse_starts = 1
    plant.readings.tick = 10_000
    plant.advance(lambda readings, drive: None, 1)
    assert 1 <= plant.readings.pulses <= 1e6 / plant.unit.pulse_period_ns + 1
