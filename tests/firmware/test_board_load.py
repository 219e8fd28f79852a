"""The image under load: time, stacks and line in a cut at 50 kHz, and a comparator that chatters in one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from edmctl.link import messages as m
from edmctl.simulator import BenchConfig
from edmctl.simulator.config import STM32
from tests.firmware.board_load import FREQUENCY_HZ, loaded
from tests.firmware.board_twin import LAYOUT, WatchedBench, board, watched
from tests.firmware.cuts import OFFSET_UM, cut_on
from tests.needs import BOARD_COMPILERS, EMULATOR

pytestmark = [pytest.mark.slow, EMULATOR]
ON_US = 6.0  # of 20
CHATTERS, GUARD_MS = 9, 50
GEN_FAULT = 3004


@pytest.mark.parametrize("name", BOARD_COMPILERS)
def test_a_loaded_cut_stays_within_its_time_and_its_stacks(name: str) -> None:
    right = loaded(name, 2.0).right()
    assert [what for what, is_right in right.items() if not is_right] == []


@pytest.mark.parametrize("name", BOARD_COMPILERS)
def test_a_comparator_that_chatters_at_50_khz_is_not_believed_and_the_guard_stops_the_cut(name: str) -> None:
    """More than 300 edges a millisecond come to rings of 256: every pulse is read by its samples alone."""
    config = BenchConfig(offset_um=OFFSET_UM, controller=STM32)
    bench = WatchedBench(config, 2, lambda plant: board(plant, name, watched))
    cut_on(bench, 0.2, FREQUENCY_HZ)
    controller = bench.controller
    assert controller.state is m.State.MACHINING
    assert len(_pulses(controller) - {(0.0, ON_US), (ON_US, 0.0)}) > 10
    controller.bench.comparator_chatters = CHATTERS
    controller.advance(2)  # the millisecond under way, and the first one of the chatter
    seen: set[tuple[float, float]] = set()
    for _ in range(GUARD_MS):
        seen |= _pulses(controller)
        if controller.state is not m.State.MACHINING:
            break
        controller.advance(1)
    assert seen == {(0.0, ON_US), (ON_US, 0.0)}
    assert controller.fault == GEN_FAULT


def _pulses(controller: Any) -> set[tuple[float, float]]:
    """Delays and discharges that the millisecond has read, to 0.1 us."""
    size, _, count_at, _, first, _ = LAYOUT
    readings = controller.bytes_of("readings", size)
    delays, discharges, *_ = np.round(readings[first:].view("<f4").reshape(4, -1), 1)[:, : readings[count_at]]
    return set(zip(delays.tolist(), discharges.tolist(), strict=True))
