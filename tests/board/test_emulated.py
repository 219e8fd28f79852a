"""A board's image as the controller of a virtual machine, where there is no emulator for it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from edmctl.board import emulated
from edmctl.errors import MEANING, PreconditionError
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.config import STM32
from tests.cli.commands import Here


@pytest.fixture(params=["no unicorn", "installed package"])
def _no_emulator(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delitem(sys.modules, emulated.PACKAGE, raising=False)
    if request.param == "no unicorn":
        monkeypatch.setitem(sys.modules, "unicorn", None)
    else:
        monkeypatch.setattr(emulated, "source_folder", lambda: tmp_path)


@pytest.mark.usefixtures("_no_emulator")
def test_where_there_is_no_emulator_the_remedy_is_told() -> None:
    with pytest.raises(PreconditionError, match="no emulator of the board") as caught:
        open_bench(BenchConfig(controller=STM32), 1)
    assert (caught.value.code, '`pip install -e ".[emulator]"`' in caught.value.hint) == ("E8095", True)
    assert "source tree" in caught.value.hint


@pytest.mark.usefixtures("_no_emulator")
def test_a_command_that_asks_for_it_ends_before_it_serves(here: Here) -> None:
    said = here("simulate", "serve", "--link", "edm", "--controller", STM32, "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8095")
    assert 8 in MEANING
