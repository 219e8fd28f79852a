"""Rules of materials."""

from __future__ import annotations

import pytest

import edmctl
from edmctl.errors import ProfileError
from edmctl.failures import Code
from edmctl.planning.rules.load import load_profile


def codes(*overrides: str) -> list[str]:
    return [warning.code for warning in load_profile("cu270", overrides).warnings]


@pytest.mark.parametrize("override", ["tool.material=cheese", "work.material=cheese", "work.material=W"])
def test_a_material_that_nothing_is_known_of_is_named(override: str) -> None:
    (found,) = load_profile("cu270", (override,)).warnings
    assert found.code == Code.UNKNOWN_MATERIAL
    assert override.partition("=")[2] in found.message
    assert "Cu" in found.hint


def test_known_materials_are_no_news() -> None:
    assert codes() == codes("tool.material=copper", "work.material=steel") == []


@pytest.mark.parametrize(
    ("override", "contradicts"),
    [
        ("sim.tool_wear=1.2", False),
        ("sim.tool_wear=0.1", True),
        ("sim.work_removal=0.7", False),
        ("sim.work_removal=2", True),
        ("pulse.discharge_voltage_v=30", True),
        ("sim.discharge_v=30", True),
    ],
)
def test_a_virtual_machine_of_another_material_is_warned_of(override: str, contradicts: bool) -> None:
    assert (Code.SIM_CONTRADICTS in codes(override)) == contradicts


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("pulse.current_a=2", "2 A lies outside 0.03 to 1"),
        ("pulse.frequency_hz=800", "375 µs of on-time lies outside 5 to 300"),
    ],
)
def test_what_nobody_models_is_told_of(override: str, said: str) -> None:
    found = [one for one in load_profile("cu270", (override,)).warnings if one.code == Code.BEYOND_LAWS]
    assert [said in one.message for one in found] == [True]


def test_the_ends_of_what_was_looked_at_are_within() -> None:
    ends = ("pulse.current_a=1", "pulse.frequency_hz=1000", "pulse.open_voltage_v=100", "servo.reference=0.5")
    codes = {one.code for one in load_profile("cu270", ends).warnings}
    assert Code.BEYOND_LAWS not in codes


@pytest.mark.parametrize(
    ("overrides", "contradicts"),
    [
        (("work.material=steel", "pulse.polarity=tool-positive"), True),
        (("wear.expected_ratio=0.6",), False),
        (("wear.expected_ratio=0.1",), True),
        (("work.removal_um3_per_uj=0.5",), True),
    ],
)
def test_wear_that_is_stated_of_other_materials_is_warned_of(
    overrides: tuple[str, ...], contradicts: bool
) -> None:
    assert (Code.STATED_CONTRADICTS in codes(*overrides)) == contradicts


def test_pulses_that_remove_nothing_are_refused() -> None:
    isopulse = ('pulse.mode="isopulse"', "pulse.discharge_us=1")
    with pytest.raises(ProfileError, match=r"a pulse of 0\.66 µJ removes nothing") as refused:
        load_profile("cu270", (*isopulse, "pulse.current_a=0.03"))
    assert refused.value.code == Code.NO_REMOVAL
    load_profile("cu270", (*isopulse, "pulse.current_a=0.06"))


@pytest.mark.parametrize("current_a", [1.3, 2.0, 2.9])
def test_a_forecast_beyond_the_laws_stays_within_reason(current_a: float) -> None:
    usual_s = edmctl.forecast("cu270", overrides={"target.depth_um": 8}).time_s
    far_s = edmctl.forecast("cu270", overrides={"target.depth_um": 8, "pulse.current_a": current_a}).time_s
    assert 0.5 < far_s / usual_s < 3.0
