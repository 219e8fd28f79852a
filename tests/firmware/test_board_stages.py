"""Steps of the stages on the emulated board: as many rising edges as are planned, whenever the tick comes."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

import pytest

from edmctl.link.messages import ResetCause
from edmctl.simulator.emulated import PACKAGE
from tests.conformance import acts, layouts
from tests.firmware.test_board_faults import HANGS, RESET, UNDEFINED, WWDG_TICKS, Rig

if TYPE_CHECKING:
    from collections.abc import Iterator

X, Y, THETA = (layouts.enum("Axis")[name] for name in ("X", "Y", "THETA"))
STEP_UM, STEP_DEG = 0.1, 0.001
LATE_COUNTS = 80  # 1.9 µs


class Stages(Rig):
    """A board whose steps are counted."""

    def __init__(self) -> None:
        super().__init__()
        self.counted = [0.0, 0.0, 0.0]
        move = self.controller._move_stages

        def count() -> None:
            self.counted = [
                a + b for a, b in zip(self.counted, self.bench.array("steps").tolist(), strict=True)
            ]
            move()

        self.controller._move_stages = count

    @property
    def steps(self) -> list[float]:
        """Steps of all axes since the board was made, towards plus; those too that nobody has taken yet."""
        return [a + b for a, b in zip(self.counted, self.bench.array("steps").tolist(), strict=True)]

    def place(self, axis: int) -> float:
        """Where an axis stands as the board tells it, in steps."""
        status = self.peer.ok("GET_STATUS")
        told: list[float] = [status.x_um / STEP_UM, status.y_um / STEP_UM, status.theta_deg / STEP_DEG]
        return told[axis]

    def start(self, axis: int, way: int, per_ms: float) -> None:
        """Let an axis go so many steps at so many a millisecond."""
        unit = 1000 * (STEP_DEG if axis == THETA else STEP_UM)
        target = round((self.place(axis) + way) * unit)
        self.peer.ok("STAGE_MOVE", axis=axis, target=target, speed=round(per_ms * unit * 1000))

    def boots_again(self) -> None:
        """Wait for the start after a reset, and open a session."""
        self.mend()
        assert self.peer.wait(lambda: self.peer.boots, 0.5, 0.001)
        self.peer.hello()


@pytest.fixture(scope="module")
def shared_stages() -> Stages:
    return Stages()


@pytest.fixture
def stages(shared_stages: Stages) -> Iterator[Stages]:
    """A board that is armed, away from the work."""
    rig = shared_stages
    rig.mend()
    acts.settle(rig.peer)
    rig.peer.boots.clear()
    acts.arm(rig.peer)
    yield rig
    rig.bench.tick_jitter = 0


# The counts whose periods are whole ones of a millisecond, and the way in between: 1, 0, 1, 0.
@pytest.mark.parametrize("per_ms", [0.5, 1, 1.5, 2, 3, 5, 7.3, 10, 20, 83, 99, 100])
@pytest.mark.parametrize("late", [0, LATE_COUNTS])
def test_steps_are_those_that_were_planned(stages: Stages, per_ms: float, late: int) -> None:
    stages.bench.tick_jitter = late
    before, place = stages.steps[X], stages.place(X)
    way = round(60 * per_ms) + 7
    for sign in (1, -1):
        stages.start(X, sign * way, per_ms)
        stages.peer.event("STAGE_DONE", 5.0)
        assert stages.steps[X] - before == (way if sign > 0 else 0)
        assert stages.place(X) - place == pytest.approx(stages.steps[X] - before, abs=0.1)


@pytest.mark.parametrize("axis", [Y, THETA])
def test_the_other_axes_too(stages: Stages, axis: int) -> None:
    stages.bench.tick_jitter = LATE_COUNTS
    before = stages.steps
    stages.start(axis, -41, 0.5)
    stages.peer.event("STAGE_DONE", 5.0)
    stages.start(axis, 541, 20)
    stages.peer.event("STAGE_DONE", 5.0)
    assert [a - b for a, b in zip(stages.steps, before, strict=True)] == [500 * (i == axis) for i in range(3)]


def test_a_timer_whose_pin_is_high_at_the_wrap_shows_a_runt(stages: Stages) -> None:
    """What is counted is edges: mode 1, high from the begin on, makes one more where the tick comes late."""
    registers, at, steps = (
        importlib.import_module(f"{PACKAGE}.{name}") for name in ("registers", "addresses", "steps")
    )
    page, r = at.TIM10, stages.chip.r.copy()

    def write(offset: int, value: int, clock: int) -> None:
        r[registers.HALFWORDS] = clock
        registers.write_register(r, at.address(page, offset) - at.PERIPHERALS, 4, value)

    def put(n: int, clock: int) -> None:
        write(at.TIM_ARR, 42_000 // max(n, 1) - 1, clock)
        write(at.TIM_CCR1, 21_000 // n if n else 0, clock)
        write(at.TIM_EGR, at.UG, clock)

    r[steps.TICK_LATE] = 0
    write(at.TIM_CCMR1, 0x68, 0)
    seen = []
    for n, clock in ((1, 100), (0, 140), (1, 100), (0, 90)):
        put(n, clock)
        seen.append(steps.take_steps(r, page))
    assert seen == [1, 1, 1, 0]


# ------------------------------------------------------------------------------------------------------- resets
def test_a_main_loop_that_hangs_makes_no_step_that_was_not_planned(stages: Stages) -> None:
    stages.start(X, 5000, 100)
    stages.peer.pump(0.02)
    made = stages.steps[X]
    stages.derail(HANGS)
    stages.controller.advance(1)  # of what the tick has put out
    assert stages.steps[X] - made == 100
    assert stages.reset_within(WWDG_TICKS) == "WINDOW_WATCHDOG"
    assert stages.steps[X] - made == 100
    stages.peer.hello()
    stages.latched(RESET, moves=False)


@pytest.mark.parametrize("breaks", ["hang", "fault", "pin"])
def test_a_reset_in_motion_leaves_a_place_that_is_not_known(stages: Stages, breaks: str) -> None:
    stages.start(X, 20_000, 100)
    stages.peer.pump(0.02)
    if breaks == "pin":
        stages.controller.reset(ResetCause.EXTERNAL)
    else:
        stages.derail(HANGS if breaks == "hang" else UNDEFINED)
        stages.reset_within(WWDG_TICKS + 2)
    stages.boots_again()
    assert stages.place(X) * STEP_UM == pytest.approx(acts.PARK_X_UM)


@pytest.mark.parametrize("axis", [X, Y, THETA])
def test_a_reset_at_rest_leaves_the_place(stages: Stages, axis: int) -> None:
    stages.start(axis, 1234, 100)
    stages.peer.event("STAGE_DONE", 5.0)
    place = stages.place(axis)
    stages.derail(UNDEFINED)
    stages.reset_within(2)
    stages.boots_again()
    assert stages.place(axis) == pytest.approx(place)


@pytest.mark.parametrize("is_over", [False, True])
def test_a_reset_in_the_last_steps_is_one_in_motion(stages: Stages, is_over: bool) -> None:
    """Nothing is planned any more, but the millisecond is not over; a millisecond later it is."""
    place, made = stages.place(X), stages.steps[X]
    stages.start(X, 250, 100)
    while stages.steps[X] - made < 250:
        stages.controller.advance(1)
    stages.controller.advance(1 if is_over else 0)
    stages.controller.reset(ResetCause.EXTERNAL)
    stages.boots_again()
    assert stages.place(X) == pytest.approx(place + 250 if is_over else acts.PARK_X_UM / STEP_UM)
