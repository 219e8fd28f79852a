"""Steps of the stages on the emulated board: as many rising edges as are planned, whenever the tick comes."""

from __future__ import annotations

import importlib
import struct
from collections.abc import Callable, Iterator

import pytest

from edmctl.board.emulated import PACKAGE
from edmctl.link.messages import ResetCause
from tests.conformance import acts, layouts, wire
from tests.conformance.peer import STATE
from tests.firmware.test_board_faults import (
    ABORT_RUN,
    DOOR,
    ESTOP,
    HANGS,
    RESET,
    UNDEFINED,
    WWDG_TICKS,
    Rig,
)
from tests.needs import EMULATOR

pytestmark = EMULATOR

X, Y, THETA = (layouts.enum("Axis")[name] for name in ("X", "Y", "THETA"))
STEP_UM, STEP_DEG = 0.1, 0.001
LATE_COUNTS = 80  # 1.9 µs
MOST_UM_S, MOST_STEPS = 10_000.0, 100
HOST_SILENT, STAGE_LIMIT = 1001, 2004
ANY_SPEED = bytes.fromhex("0020 7047")  # movs r0, #0; bx lr


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

    def follow(self, way: int, per_ms: float, **line: float) -> None:
        """Begin a scan, and let X go so many steps on its path."""
        self.peer.ok("PULSE_ENABLE", on=1)
        acts.scan_start(self.peer)
        status = self.peer.ok("GET_STATUS")
        to = acts.line_to(status.x_um + way * STEP_UM, status.y_um, speed_um_s=1000 * per_ms * STEP_UM)
        self.peer.ok("PATH_MOVE", **to | line)

    def mend(self) -> None:
        super().mend()
        self.plant.limit_switch = False

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


# ------------------------------------------------------------------------------------------------------- speeds
def test_a_speed_that_no_step_rate_makes_is_refused_with_the_one_that_does(stages: Stages) -> None:
    peer, field = stages.peer, 2
    target = round(1000 * acts.PARK_X_UM)
    for axis, most in ((X, 10_000_000), (Y, 10_000_000), (THETA, 100_000)):
        reply = peer.refused(
            "STAGE_MOVE", "OUT_OF_RANGE", axis=axis, target=target, speed=round(1.001 * most)
        )
        assert struct.unpack("<Bqq", reply.frame.payload) == (field, 1, most)
    peer.ok("STAGE_MOVE", axis=X, target=target, speed=10_000_000)
    peer.event("STAGE_DONE", 1.0)
    stages.follow(-1000, MOST_STEPS, last=0)
    line = acts.line_to(acts.PARK_X_UM, 0.0, speed_um_s=1.001 * MOST_UM_S)
    reply = peer.refused("PATH_MOVE", "OUT_OF_RANGE", **line)
    assert struct.unpack("<Bqq", reply.frame.payload) == (field, 1, round(1000 * MOST_UM_S))


def test_a_path_waits_for_stages_that_are_slower(stages: Stages) -> None:
    """No line is that fast, for PATH_MOVE refuses it; here it does not."""
    stages.patch("stages_judge_speed", ANY_SPEED)
    way, before, place = -20_000, stages.steps[X], stages.place(X)
    stages.follow(way, 100 * MOST_STEPS, last=1)
    stages.peer.event("PATH_DONE", 1.0)
    stages.controller.advance(2)
    assert stages.steps[X] - before == way
    assert stages.place(X) - place == pytest.approx(way)
    stages.peer.pump(0.1)
    assert stages.steps[X] - before == way


# -------------------------------------------------------------------------------------------------------- stops
def _sends(command: str) -> Callable[[Stages], None]:
    return lambda stages: stages.peer.write(_frame(stages, command))


def _frame(stages: Stages, command: str) -> bytes:
    peer = stages.peer
    seq, peer.seq = peer.seq, (peer.seq + 1) % 256
    return wire.encode(layouts.NAMES[command], seq, peer.session, b"")


FAULTS: dict[str, tuple[Callable[[Stages], object], int]] = {
    "estop": (lambda stages: setattr(stages.plant, "estop", True), ESTOP),
    "door": (lambda stages: setattr(stages.plant, "door_open", True), DOOR),
    "abort": (lambda stages: stages.peer.write(bytes(8)), ABORT_RUN),
    "host-silent": (lambda stages: stages.controller.advance(300), HOST_SILENT),
    "limit-switch": (lambda stages: setattr(stages.plant, "limit_switch", True), STAGE_LIMIT),
}
COMMANDS = {name: (_sends(name), 0) for name in ("SERVO_STOP", "STAGE_STOP", "DISARM")}


def stands_where_it_says(stages: Stages, place: float, made: float) -> None:
    """Nothing moves any more, the place told is the true one, and a scan without lines leaves it."""
    stood = stages.steps[X]
    stages.peer.pump(0.3)
    assert stages.steps[X] == stood
    assert stages.place(X) - place == pytest.approx(stood - made, abs=0.1)
    stages.mend()
    acts.clear(stages.peer)
    if stages.peer.state() != "IDLE":
        acts.rest(stages.peer)
    acts.arm(stages.peer)
    stages.peer.ok("PULSE_ENABLE", on=1)
    acts.scan_start(stages.peer)
    stages.peer.pump(0.3)
    assert stages.steps[X] == stood
    assert stages.controller.state == STATE["MACHINING"]


@pytest.mark.parametrize("end", [*FAULTS, "SERVO_STOP", "DISARM"])
@pytest.mark.parametrize("ahead", [False, True], ids=["", "ahead"])
def test_what_ends_a_scan_stops_the_stages(stages: Stages, end: str, ahead: bool) -> None:
    """At the greatest speed, and on a path that the stages cannot follow."""
    stop, fault = (FAULTS | COMMANDS)[end]
    if ahead:
        stages.patch("stages_judge_speed", ANY_SPEED)
    place, made = stages.place(X), stages.steps[X]
    stages.follow(-100_000, 100 * MOST_STEPS if ahead else MOST_STEPS, last=1)
    stages.peer.pump(0.1)
    assert abs(stages.steps[X] - made) > 5_000
    stop(stages)
    stages.controller.advance(
        13 if fault == ABORT_RUN else 4
    )  # what tells it, and the steps that were planned
    assert stages.controller.fault == fault
    assert stages.controller.state != STATE["MACHINING"]
    stands_where_it_says(stages, place, made)


@pytest.mark.parametrize("end", [*FAULTS, "STAGE_STOP", "DISARM"])
@pytest.mark.parametrize("per_ms", [7.3, MOST_STEPS, 5 * MOST_STEPS])
def test_what_ends_a_travel_tells_where_the_stage_stands(stages: Stages, end: str, per_ms: float) -> None:
    stop, fault = (FAULTS | COMMANDS)[end]
    if per_ms > MOST_STEPS:
        stages.patch("stages_judge_speed", ANY_SPEED)
    place, made = stages.place(X), stages.steps[X]
    stages.start(X, -100_000, per_ms)
    stages.peer.pump(0.1)
    assert abs(stages.steps[X] - made) > 500
    stop(stages)
    stages.controller.advance(13 if fault == ABORT_RUN else 4)
    assert stages.controller.fault == fault
    assert stages.controller.state != STATE["MOVING"] or not fault
    stands_where_it_says(stages, place, made)


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


@pytest.mark.parametrize(("first", "second"), [(X, Y), (Y, THETA)])
def test_a_reset_between_two_stores_leaves_no_place_that_looks_right(
    stages: Stages, first: int, second: int
) -> None:
    """Steps of one millisecond at two axes, both stored, and the check not yet."""
    stands = stages.memory("stands_before").view("<i4")
    stands[first] += 1
    stands[second] -= 128
    stages.controller.reset(ResetCause.EXTERNAL)
    stages.boots_again()
    parked = [acts.PARK_X_UM / STEP_UM, 0.0, 0.0]
    assert [stages.place(axis) for axis in (X, Y, THETA)] == pytest.approx(parked, abs=0.5)


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
