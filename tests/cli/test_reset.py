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


def test_a_fresh_virtual_machine_holds_nothing_and_a_bench_is_not_made(here: Here) -> None:
    said = here("reset")
    fresh = "It is a fresh virtual machine, because none was named: --port names another."
    assert (said.exit_code, said.out) == (0, f"The controller holds no fault. {fresh}\n")
    for options in (("--port", "sim:typo.h5"), ("--ack", "3001")):
        said = here("reset", *options, "--json")
        assert (said.exit_code, said.document["error"]["code"]) == (8, "E8013")
        assert "--port" in said.document["error"]["hint"]
    assert not Path("typo.h5").exists()


def test_the_fault_that_is_named_is_cleared_and_no_other(here: Here, faulty: Workshop) -> None:
    said = here("reset", "--json")
    assert (said.exit_code, said.document["result"]) == (8, {"latched": 4002, "cleared": False})
    error = said.document["error"]
    assert error["code"] == "E8010"
    assert error["message"].startswith("The controller still holds fault 4002: The door")
    assert error["hint"] == "Close the door; then `edmctl reset --ack 4002`."
    wrong = here("reset", "--ack", "3001")
    assert wrong.exit_code == 2
    assert "Not fault 3001 is latched but 4002" in wrong.err
    assert "`edmctl reset --ack 4002`" in wrong.err
    faulty.bench.plant.door_open = True
    open_door = here("reset", "--ack", "4002")
    assert open_door.exit_code == 8
    assert "E8012" in open_door.err
    assert "the door is open" in open_door.err
    assert faulty.bench.controller.fault == 4002
    faulty.bench.plant.door_open = False
    said = here("reset", "--ack", "4002", "--json")
    assert (said.exit_code, said.document["simulated"]) == (0, True)
    assert said.document["result"] == {"latched": None, "cleared": True}
    assert faulty.bench.controller.fault == 0


def test_a_machine_that_lasts_and_holds_nothing_is_left_as_it_is(here: Here) -> None:
    with serving(open_bench(BenchConfig(), 1)) as port:
        said = here("reset", "--ack", "4001", "--port", port, "--json")
    assert (said.exit_code, said.document["result"]) == (0, {"latched": None, "cleared": False})
