"""What a watcher of a whole job is told on the way."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from edmctl.record.rows import EventLevel, RunEvent
from edmctl.results.progress import Phase, Progress
from tests.procedures.conftest import Shop


@pytest.fixture(scope="module")
def states() -> list[Progress]:
    shop = Shop(("target.depth_um=10", "jump.mode='fixed'", "jump.period_s=2"))
    shop.run_job()
    return shop.told.states


def test_a_watcher_sees_every_phase(states: list[Progress]) -> None:
    swings = [s for s in states if s.phase is Phase.CONDITIONING]
    assert len(swings) > 10
    assert max(b.time_s - a.time_s for a, b in pairwise(swings)) < 0.6
    assert max(s.displacement_um for s in swings) > 200.0
    assert {Phase.MOVING, Phase.MEASURING, Phase.APPROACHING, Phase.MACHINING} <= {s.phase for s in states}
    assert len(states) < 20.0 * (states[-1].time_s - states[0].time_s)
    approach = [s for s in states if s.phase is Phase.APPROACHING and s.ratios.open > 0.0]
    assert max(s.gap_v for s in approach) > approach[0].reference_v


def test_a_cut_tells_feed_wear_and_jumps(states: list[Progress]) -> None:
    cut = [s for s in states if s.phase is Phase.MACHINING and s.step == "cut 1"]
    last = cut[-1]
    assert last.feed_um == pytest.approx(last.depth_um + last.wear_um)
    assert last.wear_u95_um > 0.0
    assert last.jumps >= 2
    assert 0.0 <= last.time_s - last.last_jump_s < 3.0
    assert [s.jumps for s in cut] == sorted(s.jumps for s in cut)
    assert math.isnan(last.feed_target_um)
    deepest_um = max(s.displacement_um for s in states if s.phase is Phase.MACHINING)
    jumped = [s.displacement_um for s in states if s.phase is Phase.JUMPING]
    assert min(jumped) < deepest_um - 10.0


def test_the_newest_warning_is_told_from_then_on() -> None:
    run = Shop().run()
    run.decide(RunEvent.ARCING, "Many arcs.", {}, level=EventLevel.WARNING)
    run.decide(RunEvent.ARMED, "Armed.", {})
    run.begin(Phase.MOVING)
    told = run.observer.states[-1]  # type: ignore[attr-defined]
    assert told.warning == "Many arcs."
    assert told.warned_s == run.machine.time_s
