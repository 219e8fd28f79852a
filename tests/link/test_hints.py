"""Hints name commands that exist; those on stages whose position is unknown say one thing, and nothing dangerous."""

from __future__ import annotations

import re
import struct
from dataclasses import fields
from pathlib import Path

import pytest

from edmctl.app import command_tree
from edmctl.errors import stages_by_hand
from edmctl.link.faults import FAULTS, FaultCode, FaultRow
from edmctl.link.frame import Frame
from edmctl.link.link_errors import nak_error, restarted
from edmctl.link.messages import Arm, Boot, PathMove, ResetCause, StageMove, Status

ROOT = Path(__file__).parents[2]
DANGEROUS = re.compile(
    r"hom(e|ed|ing) (both |all |the )?stages|stages (were|are) homed|on again: there a touch"
    r"|[Dd]rive the stage to its|[Ii]f a stage was moving",
)
"""There is no homing command, and a controller that is started over the pad counts itself as parked."""
TEXTS = [
    *ROOT.glob("edmctl/**/*.py"),
    *ROOT.glob("edmctl/**/*.toml"),
    *ROOT.glob("docs/*.md"),
    ROOT / "README.md",
]


def unknown_commands(text: str) -> set[str]:
    return set(re.findall(r"\bedmctl ([a-z-]+)", text)) - set(command_tree().commands)


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
def test_a_speed_that_the_stages_do_not_reach_is_refused_with_their_speed_and_the_key(
    command: type[StageMove | PathMove], key: str
) -> None:
    index = next(i for i, field in enumerate(fields(command)) if field.name.startswith("speed"))
    reply = struct.pack("<Bqq", index, 1, 1_000_000)
    error = nak_error(command.ID, Frame(command.ID | 0x40, 0, 1, Status.OUT_OF_RANGE, reply))
    assert "at most 1000 µm/s" in error.message
    assert key in error.hint


def test_no_text_advises_what_leads_to_a_collision() -> None:
    found = {
        str(path.relative_to(ROOT)): wrong.group()
        for path in TEXTS
        if (wrong := DANGEROUS.search(re.sub(r'"?\s*\n\s*f?"?', " ", path.read_text(encoding="utf-8"))))
    }
    assert found == {}


@pytest.mark.parametrize("cause", [*ResetCause])
def test_every_restart_makes_the_position_uncertain(cause: ResetCause) -> None:
    assert stages_by_hand() in restarted("board", Boot(cause, 3)).hint


@pytest.mark.parametrize(
    "fault", [FaultCode.STAGE_LIMIT, FaultCode.COLLISION, FaultCode.RESET, FaultCode.POWER_LOSS]
)
def test_faults_that_leave_the_position_uncertain_say_so(fault: FaultCode) -> None:
    assert stages_by_hand() in FAULTS[fault].hint
