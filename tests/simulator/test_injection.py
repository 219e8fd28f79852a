"""How injections are written, and that every fault has one."""

from __future__ import annotations

import pytest

from edmctl.link.faults import FAULTS, FaultRow
from edmctl.simulator.injection import INJECTIONS, parse_injection


@pytest.mark.parametrize("row", FAULTS.values(), ids=lambda row: row.name)
def test_every_row_can_be_brought_about(row: FaultRow) -> None:
    inject = row.inject
    if inject.islower():
        assert inject in ("disk", "profile")
    else:
        assert parse_injection(inject).name in INJECTIONS
        assert parse_injection(row.name).name in INJECTIONS


def test_injections_are_read_and_refused_in_words() -> None:
    assert str(parse_injection("estop@12.5")) == "ESTOP@12.5"
    assert str(parse_injection(" TOOL_LOST ")) == "TOOL_LOST@sparks+1"
    assert str(parse_injection("NO_CONTACT")) == "TOOL_LOST@touch+0"
    assert str(parse_injection("PIEZO_TRACK@arm+2")) == "AMPLIFIER_DEAD@arm+2"
    with pytest.raises(ValueError, match=r"no such fault: FIRE; there are ABORT_RUN, .*WIRE_SHORT"):
        parse_injection("FIRE")
    for text in ("ESTOP@", "ESTOP@soon", "ESTOP@lunch+1", "ESTOP@-1", "ESTOP@nan", "ESTOP@+3"):
        with pytest.raises(ValueError, match=r"time"):
            parse_injection(text)
