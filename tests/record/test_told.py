"""Numbers that are read from a run file."""

from __future__ import annotations

from edmctl.machine.interface import EventCode, MachineState
from edmctl.procedures.event_codes import RunEvent
from edmctl.record.events import State, Told


def test_every_code_that_is_looked_for_is_that_of_its_writer() -> None:
    written = {code.name: int(code) for code in (*EventCode, *RunEvent)}
    assert {told.name: int(told) for told in Told} == {told.name: written[told.name] for told in Told}


def test_every_state_is_that_of_the_protocol() -> None:
    assert {state.name: int(state) for state in State} == {state.name: int(state) for state in MachineState}
