"""Numbers that are read from a run file."""

from __future__ import annotations

from edmctl.machine.interface import EventCode, MachineState
from edmctl.record.reader import RecordedCode, RecordedState
from edmctl.record.rows import RunEvent


def test_every_code_that_is_looked_for_is_that_of_its_writer() -> None:
    written = {code.name: int(code) for code in (*EventCode, *RunEvent)}
    assert {code.name: int(code) for code in RecordedCode} == {
        code.name: written[code.name] for code in RecordedCode
    }


def test_every_state_is_that_of_the_protocol() -> None:
    assert {state.name: int(state) for state in RecordedState} == {
        state.name: int(state) for state in MachineState
    }
