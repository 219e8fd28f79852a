"""Hints and pages on stages whose position is unknown: one text, and no advice that leads to a collision."""

import re
from pathlib import Path

import pytest

from edmctl.errors import stages_by_hand
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.link_errors import restarted
from edmctl.link.messages import Boot, ResetCause

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
