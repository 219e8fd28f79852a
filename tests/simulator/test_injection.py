"""How injections are written, and that every fault has one."""

from __future__ import annotations

import pytest

from edmctl.link.faults import FAULTS, FaultRow
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.injection import INJECTIONS, WIRING_MISTAKES, parse_injection
from edmctl.simulator.plant import Wiring


@pytest.mark.parametrize("row", FAULTS.values(), ids=lambda row: row.name)
def test_every_row_can_be_brought_about(row: FaultRow) -> None:
    inject = row.inject
    if inject.islower():
        assert inject in ("disk", "profile")
    else:
        assert parse_injection(inject).name in INJECTIONS
        assert parse_injection(row.name).name in INJECTIONS


def test_one_of_several_is_mended_and_then_all() -> None:
    bench = open_bench(BenchConfig(), 1)
    sound, inputs = bench.plant.unit.numbers(), bench.plant.inputs()
    bench.inject(parse_injection("ESTOP@5"))
    for name in (*WIRING_MISTAKES, "DOOR", "HV_SUPPLY"):
        bench.inject(parse_injection(f"{name}@0"))
    bench.controller.advance(2)
    changed = bench.plant.unit.numbers()
    assert changed != sound
    assert bench.plant.inputs() != inputs
    for name in ("HV_SUPPLY", "ESTOP", "X_REVERSED"):
        bench.controller.injector.mend(name)
    bench.controller.advance(6000)
    assert (bench.plant.hv_supply_ok, bench.plant.estop, bench.plant.door_open) == (True, False, True)
    for name in WIRING_MISTAKES:
        bench.controller.injector.mend(name)
    assert bench.plant.wiring == Wiring()
    bench.clear_injections()
    assert (bench.plant.unit.numbers(), bench.plant.inputs()) == (sound, inputs)


@pytest.mark.parametrize("name", WIRING_MISTAKES)
def test_every_wiring_mistake_changes_what_is_read_or_driven(name: str) -> None:
    bench = open_bench(BenchConfig(), 1)
    sound, wiring = bench.plant.unit.numbers(), repr(bench.plant.wiring)
    bench.inject(parse_injection(f"{name}@0"))
    bench.controller.advance(2)
    assert (bench.plant.unit.numbers() != sound) != (repr(bench.plant.wiring) != wiring)


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
