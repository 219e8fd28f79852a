"""`edmctl first-start` on the emulated board: a sound machine passes, a mistake is named by its net."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from edmctl.simulator import BenchConfig, VirtualBench
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.serve import ActsFile
from tests.board.test_first_start import NAMED, items, statuses, wired, write_answers
from tests.needs import EMULATOR
from tests.serving import serving
from tests.tiers import tiers

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.commands import Here

pytestmark = EMULATOR

__all__ = ["wired"]

AT_ONCE = ("ESTOP_DOOR_SWAPPED", "LEVEL_INVERTED", "CONTACT_INVERTED", "GAP_REVERSED", "SENSOR_OPEN")
QUICK = ("GATE_STUCK", "MODE_STUCK")


@pytest.mark.slow
def test_a_sound_machine_passes(here: Here, wired: Any) -> None:
    bench = wired()
    said = here("first-start", "--yes", "--json", "--seed", "3", "--controller", "stm32")
    assert said.exit_code == 0, said.err
    assert statuses(said, "fail") == statuses(said, "skipped") == []
    assert said.document["result"]["first_start"]["complete"]
    assert bench.is_off()


def test_five_mistakes_at_once_are_all_named(here: Here, wired: Any) -> None:
    bench = wired(*AT_ONCE)
    said = here("first-start", "--yes", "--json", "--seed", "1", "--controller", "stm32")
    assert sorted(statuses(said, "fail")) == sorted(NAMED[name][0] for name in AT_ONCE), said.err
    for name in AT_ONCE:
        causes = items(said)[NAMED[name][0]]["causes"]
        assert {net for cause in causes for net in cause["nets"]} == NAMED[name][1]
    assert bench.made[-1].plant.drive.pulse_starts == 0
    assert bench.is_off()


@pytest.mark.parametrize("mistake", tiers(*QUICK, slow=[name for name in NAMED if name not in QUICK]))
def test_a_mistake_is_named_and_nothing_else_is_blamed(here: Here, wired: Any, mistake: str) -> None:
    key, nets, words = NAMED[mistake]
    bench = wired(mistake)
    said = here("first-start", "--yes", "--json", "--quiet", "--seed", "4", "--controller", "stm32")
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8049"), said.err
    assert statuses(said, "fail") == [key]
    found = items(said)[key]
    assert {net for cause in found["causes"] for net in cause["nets"]} == nets
    assert words in " ".join(cause["text"] for cause in found["causes"])
    assert bench.is_off()


def test_a_served_board_is_acted_on_by_a_file(here: Here, tmp_path: Path) -> None:
    bench = VirtualBench(BenchConfig(controller="stm32"), 2)
    bench.inject(parse_injection("LEVEL_INVERTED"))
    acts, told = tmp_path / "hands", list[str]()
    answers = write_answers(tmp_path / "answers.toml")
    with serving(bench, acts=ActsFile(acts, bench, told.append)) as port:
        said = here("first-start", "--port", port, "--answers", answers, "--acts", str(acts), "--json")
    assert statuses(said, "fail") == ["level"], said.err
    assert (said.exit_code, told) == (8, [])
    assert bench.is_safe
