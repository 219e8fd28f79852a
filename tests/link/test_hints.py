"""What hints tell people to type exists in this version."""

from __future__ import annotations

import re
import struct
from dataclasses import fields

import pytest

from edmctl.app import command_tree
from edmctl.link.faults import FAULTS, FaultRow
from edmctl.link.frame import Frame
from edmctl.link.link_errors import nak_error
from edmctl.link.messages import Arm, PathMove, StageMove, Status


def commands() -> set[str]:
    return set(command_tree().commands)


def unknown_commands(text: str) -> set[str]:
    return set(re.findall(r"\bedmctl ([a-z-]+)", text)) - commands()


@pytest.mark.parametrize("row", FAULTS.values(), ids=lambda row: row.name)
def test_a_fault_names_a_remedy_and_no_command_that_does_not_exist(row: FaultRow) -> None:
    assert row.hint.endswith(".")
    assert unknown_commands(row.hint) == set()


@pytest.mark.parametrize("status", [status for status in Status if status is not Status.OK])
def test_a_nak_error_names_a_remedy_and_no_command_that_does_not_exist(status: Status) -> None:
    error = nak_error(Arm.ID, Frame(Arm.ID | 0x40, 0, 1, status, b""))
    assert error.hint.endswith(".")
    assert unknown_commands(error.hint) == set()


@pytest.mark.parametrize(
    ("command", "key"), [(StageMove, "stage.speed_um_s"), (PathMove, "path.speed_um_s")], ids=["move", "path"]
)
def test_stages_that_are_slower_are_told_with_their_speed_and_the_key(
    command: type[StageMove | PathMove], key: str
) -> None:
    index = next(i for i, field in enumerate(fields(command)) if field.name.startswith("speed"))
    reply = struct.pack("<Bqq", index, 1, 1_000_000)
    error = nak_error(command.ID, Frame(command.ID | 0x40, 0, 1, Status.OUT_OF_RANGE, reply))
    assert "at most 1000 µm/s" in error.message
    assert key in error.hint
