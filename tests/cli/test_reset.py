"""`edmctl reset`: names the latched fault, clears the one that is named, and no other."""

from __future__ import annotations

from pathlib import Path

import pytest

from edmctl.link.faults import FaultCode
from edmctl.simulator import BenchConfig, open_bench
from tests.cli.commands import Here
from tests.faults.workshop import Workshop
from tests.serving import serving


@pytest.fixture
def faulty(here: Here, monkeypatch: pytest.MonkeyPatch) -> Workshop:
    """Return a machine that holds fault 4002, its door closed again."""
    workshop = Workshop()
    monkeypatch.setattr("edmctl.simulator.open_bench", workshop)
    assert here("reset").exit_code == 0
    workshop.bench.controller.raise_fault(FaultCode.DOOR)
    return workshop


def test_a_fresh_virtual_machine_holds_nothing(here: Here) -> None:
    said = here("reset")
    assert (said.exit_code, said.out) == (
        0,
        "The controller holds no fault. It is a fresh virtual machine, because none was named: --port names "
        "another.\n",
    )


def test_a_bench_that_is_not_there_is_not_made(here: Here) -> None:
    said = here("reset", "--port", "sim:typo.h5", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8013")
    assert not Path("typo.h5").exists()
    assert "none was named" in here("reset").out


def test_a_fault_of_no_machine_cannot_be_cleared(here: Here) -> None:
    said = here("reset", "--ack", "3001", "--json")
    assert said.exit_code == 8
    assert said.document["error"]["code"] == "E8013"
    assert "--port" in said.document["error"]["hint"]


def test_without_a_code_the_fault_is_told_and_stays(here: Here, faulty: Workshop) -> None:
    said = here("reset", "--json")
    assert said.exit_code == 8
    assert said.document["result"] == {"latched": 4002, "cleared": False}
    error = said.document["error"]
    assert error["code"] == "E8010"
    assert error["message"].startswith("The controller still holds fault 4002: The door")
    assert error["hint"] == "Close the door; then `edmctl reset --ack 4002`."
    assert faulty.bench.controller.fault == 4002


def test_the_fault_that_is_named_is_cleared(here: Here, faulty: Workshop) -> None:
    said = here("reset", "--ack", "4002", "--json")
    assert said.exit_code == 0, said.err
    assert said.document["result"] == {"latched": None, "cleared": True}
    assert said.document["simulated"] is True
    assert faulty.bench.controller.fault == 0


def test_the_wrong_code_clears_nothing_and_the_right_one_is_told(here: Here, faulty: Workshop) -> None:
    said = here("reset", "--ack", "3001")
    assert said.exit_code == 2
    assert "Not fault 3001 is latched but 4002" in said.err
    assert "`edmctl reset --ack 4002`" in said.err
    assert faulty.bench.controller.fault == 4002


def test_an_open_interlock_is_named(here: Here, faulty: Workshop) -> None:
    faulty.bench.plant.door_open = True
    said = here("reset", "--ack", "4002")
    assert said.exit_code == 8
    assert "E8012" in said.err
    assert "the door is open" in said.err
    assert faulty.bench.controller.fault == 4002


def test_a_machine_that_lasts_and_holds_nothing_is_left_as_it_is(here: Here) -> None:
    with serving(open_bench(BenchConfig(), 1)) as port:
        said = here("reset", "--ack", "4001", "--port", port, "--json")
    assert (said.exit_code, said.document["result"]) == (0, {"latched": None, "cleared": False})
