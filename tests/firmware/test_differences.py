"""The core does, byte for byte, what the virtual controller does; benchmarks/firmware_differences.py tries more."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import pytest

from edmctl.link import messages as m
from edmctl.simulator.controller import Controller
from tests.firmware.schedules import Difference, Schedule, WideSchedule
from tests.tiers import tiers

if TYPE_CHECKING:
    from edmctl.core.build import Build


@pytest.mark.parametrize("seed", tiers(3, slow=(4, 6, 8), full=tuple(range(10, 30))))
def test_a_random_schedule_makes_no_difference(core: Build, seed: int) -> None:
    schedule = Schedule(seed)
    schedule.run(150)
    assert isinstance(schedule.twins.benches[1].controller, Controller)
    assert schedule.commands > 150


@pytest.mark.parametrize("seed", tiers(2, slow=(5, 9), full=tuple(range(10, 30))))
def test_parameters_of_any_value_and_failed_readings_make_no_difference(core: Build, seed: int) -> None:
    schedule = WideSchedule(seed)
    schedule.run(150)
    assert schedule.commands > 150


def test_a_difference_is_found(core: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison can fail: one controller whose ramp is a step longer."""

    def run(seed: int) -> None:
        schedule = Schedule(seed)
        schedule.twins.benches[0].controller.motion.volts = lambda um: um * 1.001  # type: ignore[method-assign, union-attr]
        schedule.run(300)

    with pytest.raises(Difference):
        deque(map(run, range(3, 7)), 0)  # not every schedule comes to a ramp in so few commands


def test_float_arithmetic_cuts_as_deep(core: Build) -> None:
    """A board calculates in float: what is chaotic about sparks comes out otherwise, what counts does not."""
    from tests.firmware.cuts import cut

    exact, board = cut("firmware", 4.0), cut("firmware-float", 4.0)
    assert board.controller.state is exact.controller.state is m.State.MACHINING
    assert board.plant.state.depth_um == pytest.approx(exact.plant.state.depth_um, rel=0.05)
    assert board.controller.loop.pulse_no == exact.controller.loop.pulse_no
