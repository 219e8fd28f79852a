"""Rules of materials."""

from __future__ import annotations

import pytest

from edmctl.profile.findings import Code
from edmctl.rules.load import load_profile


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
    ],
)
def test_a_virtual_machine_of_another_material_is_warned_of(override: str, contradicts: bool) -> None:
    assert (Code.SIM_CONTRADICTS in codes(override)) == contradicts
