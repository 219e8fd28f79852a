"""A tool that stands on flat work makes the same hole with the map of the work as with one depth for a hole."""

from __future__ import annotations

import math
from random import Random

import pytest

from edmctl.link import messages as m
from edmctl.link.session import Session
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.work_under_tool import NO_LEVELS, WorkUnderTool

CONFIG = BenchConfig(tool_diameter_um=120.0, offset_um=10.0)
SITES_NM = (0, 400_000, 0, 400_000, 0)


def one_depth(ground: WorkUnderTool, x_um: float, y_um: float) -> None:
    """The rule without a map: the depth of the hole that the tool fits into, and the whole disc."""
    ground.levels, ground.solid = NO_LEVELS, x_um > -2000.0
    ground._place, ground._footprint = (x_um, y_um), None
    state = ground._state
    state.depth_um = ground.here.depth_um if ground.here else 0.0
    state.rarity, state.next_level_um = 1.0, math.inf
    state.per_hole_area = ground._unit.per_disc_area


def run(seed: int) -> tuple[bytes, list[float], float]:
    """Cut two holes by turns, and one of them again; every sample and pulse, depths, wear."""
    bench = open_bench(CONFIG, seed)
    session = Session(bench.transport, Random(1))
    told = bytearray()
    session.subscribe(m.Tlm, lambda t: told.extend(t.records))
    session.subscribe(m.Pulses, lambda p: told.extend(p.records))
    session.open()
    crc = m.param_crc({})
    session.request(m.CommitProfile(crc))
    session.request(m.Arm(crc))
    session.request(m.PulseEnable(1))
    session.request(m.StageMove(m.Axis.X, 0, 50_000_000))
    session.pump(0.3)
    session.request(m.TlmStart(1000, 14, m.PulseLog.FULL))
    for y_nm in SITES_NM:
        session.request(m.StageMove(m.Axis.Y, y_nm, 5_000_000))
        session.pump(0.3)
        session.request(m.Approach(5.0, 200.0, 10.8))
        session.pump(10.0)
        session.request(m.ServoStop())
        session.request(m.ServoStart(9.6, 500.0, 100.0))
        session.pump(4.0)
        session.request(m.Jump(10.0, 2000.0, 0.02, 2.0))
        session.pump(1.0)
        session.request(m.ServoStop())
        session.request(m.PiezoSet(0.0, 300.0))
        session.pump(1.0)
    return bytes(told), [hole.depth_um for hole in bench.truth()], bench.tool_wear_um


@pytest.mark.parametrize("seed", [1, 2])
def test_a_blind_hole_is_bit_for_bit_that_of_one_depth_and_one_area(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    mapped = run(seed)
    monkeypatch.setattr(WorkUnderTool, "_take_up", one_depth)
    assert run(seed) == mapped
    assert len(mapped[1]) == 2
    assert min(mapped[1]) > 3.0
