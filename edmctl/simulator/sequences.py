"""The controller's motions, phase by phase: approach, cut, scan, jump, touch, self test."""

from __future__ import annotations

import math

from edmctl.actuator.compiling import compiled
from edmctl.simulator.controller_state import (
    APPROACH,
    CUT_DONE,
    DISPLACEMENT_FAILED_UM,
    FAULT_COLLISION,
    FAULT_GAP_SENSOR,
    FAULT_MODE_SWITCH,
    FAULT_NO_CONTACT,
    FAULT_NO_SPARK,
    FAULT_STUCK_CONTACT,
    FAULT_TRAVEL,
    HOLD,
    JUMP_DONE,
    JUMP_DOWN,
    JUMP_DWELL,
    JUMP_RESUMED,
    JUMP_RETURN,
    JUMP_UP,
    NOTHING,
    PATH_DONE,
    RAMP,
    RAMP_DONE,
    SERVO,
    SPARK_FOUND,
    TEST_OFF,
    TEST_ON,
    TESTED,
    TIME_UP,
    TOUCH_BACK,
    TOUCH_FAST,
    TOUCH_HUNT,
    TOUCH_SLOW,
    TOUCHED,
    TOUCHES_DONE,
    LoopState,
    Settings,
)
from edmctl.simulator.plant_interface import PATH_LINES, TICK_S, Drive, Readings
from edmctl.simulator.servo import SETTLE_TICKS, hold_at_limit, servo_tick

LIMIT_TICKS_MAX = 500
HELD_WITHIN_UM = 1.0
LOST_TICKS = 100  # all open, before the way since the last spark counts
BACK_OFF_TICKS = 200  # for the contact to open after a back-off
OPEN_TICKS = 50  # in a row it has to be open at rest: one that comes and goes tells no place
PATIENCE_TICKS = 100  # more for that, so that a single disturbance is no fault
TEST_OFF_TICKS, TEST_ON_TICKS = 100, 200
TEST_MEAN_TICKS = 100  # the last ones of each half speak


@compiled
def sequence_tick(settings: Settings, loop: LoopState, drive: Drive, readings: Readings) -> int:
    """Where the running motion stands after this tick: go on, change phase, or report what happened."""
    mode = loop.mode
    loop.phase += 1
    if mode == HOLD:
        return NOTHING
    if mode == RAMP:
        if readings.contact == 1 and loop.feeds == 1:
            return FAULT_COLLISION
        return end_motion(loop, drive, RAMP_DONE) if loop.command_v == loop.target_v else NOTHING
    if loop.limit_ticks > LIMIT_TICKS_MAX:
        return FAULT_TRAVEL
    if mode == APPROACH:
        return approach_tick(loop, drive)
    if mode == SERVO:
        return cut_tick(settings, loop, drive)
    if mode <= JUMP_RETURN:
        return jump_tick(settings, loop, drive, readings)
    if mode >= TEST_OFF:
        return test_tick(loop, drive)
    return touch_tick(settings, loop, drive, readings)


@compiled
def end_motion(loop: LoopState, drive: Drive, happened: int) -> int:
    """Pulses off, hold tool and stages, report."""
    drive.pulses_on = 0
    loop.scanning = 0
    loop.path_count = 0
    enter(loop, HOLD)
    return happened


@compiled
def enter(loop: LoopState, mode: int) -> None:
    loop.mode = mode
    loop.phase = 0
    loop.limit_ticks = 0


@compiled
def start_pulses(loop: LoopState, drive: Drive) -> None:
    drive.pulses_on = 1
    drive.pulse_starts += 1
    loop.silent_ticks = 0


@compiled
def approach_tick(loop: LoopState, drive: Drive) -> int:
    if loop.phase <= SETTLE_TICKS:
        return NOTHING
    if loop.gap_v <= loop.gap_ref_v:
        return end_motion(loop, drive, SPARK_FOUND)
    z_um = loop.slow_displacement_um
    if z_um >= DISPLACEMENT_FAILED_UM or z_um - loop.start_z_um > loop.z_max_um:
        return FAULT_NO_SPARK
    return NOTHING


@compiled
def watch_cut(settings: Settings, loop: LoopState) -> int:
    """What no millisecond with pulses of a cut or scan passes: a depth that is not known, lost sparks.

    Its time counts.
    """
    if loop.displacement_um >= DISPLACEMENT_FAILED_UM:
        return FAULT_TRAVEL  # nobody knows how deep: no limit that has been reached
    loop.time_ticks -= 1
    held = loop.scanning == 1 and loop.slow_displacement_um >= loop.z_limit_um - HELD_WITHIN_UM
    if held:
        loop.open_ticks = min(loop.open_ticks, LOST_TICKS + 1)  # where it waits, time tells nothing
    way_um = loop.slow_displacement_um - loop.last_spark_um
    lost = loop.open_ticks > LOST_TICKS and way_um > settings.open_lost_um
    if lost or (not held and loop.open_ticks > settings.open_ticks_max):
        return FAULT_NO_SPARK
    return NOTHING


@compiled
def cut_tick(settings: Settings, loop: LoopState, drive: Drive) -> int:
    """A millisecond of a cut or scan: the end of the one, the hold of the other, time, and what is watched."""
    found = watch_cut(settings, loop)
    if found == FAULT_TRAVEL:
        return found
    servo_tick(settings, loop)
    if loop.scanning == 1:
        hold_at_limit(settings, loop)
    elif loop.slow_displacement_um >= loop.z_limit_um:
        return end_motion(loop, drive, CUT_DONE)
    if loop.time_ticks <= 0:
        return end_motion(loop, drive, TIME_UP)
    return found


@compiled
def follow_path(loop: LoopState, drive: Drive) -> int:
    """Move the stages of a scan by one millisecond along the path, and the limit with them.

    Nothing moves while the gap is shorted, or in a jump.
    """
    if loop.mode != SERVO or loop.shorted == 1 or loop.path_count == 0:
        return NOTHING
    drive.stage_moves = 1
    drive.stage_line = loop.path_at
    drive.stage_lines_done = 0
    drive.stage_share = 0.0
    drive.stage_way_um = 0.0
    left_s = TICK_S
    while loop.path_count > 0 and left_s > 0.0:
        line = loop.path_at
        x, y = loop.path_x_um[line] - drive.stage_x_um, loop.path_y_um[line] - drive.stage_y_um
        way = math.sqrt(x * x + y * y)
        needed_s = way / loop.path_speed_um_s[line]
        if needed_s > left_s:
            share = left_s / needed_s
            drive.stage_x_um += share * x
            drive.stage_y_um += share * y
            loop.z_limit_um += share * (loop.path_z_um[line] - loop.z_limit_um)
            drive.stage_share = share
            drive.stage_way_um += share * way
            return NOTHING
        left_s -= needed_s
        drive.stage_x_um, drive.stage_y_um = loop.path_x_um[line], loop.path_y_um[line]
        loop.z_limit_um = loop.path_z_um[line]
        drive.stage_lines_done += 1
        drive.stage_way_um += way
        loop.path_at = (line + 1) % PATH_LINES
        loop.path_count -= 1
        if loop.path_last[line] == 1.0:
            return end_motion(loop, drive, PATH_DONE)
    return NOTHING


@compiled
def jump_tick(settings: Settings, loop: LoopState, drive: Drive, readings: Readings) -> int:
    mode = loop.mode
    if mode == JUMP_UP and loop.phase >= loop.phase_ticks:
        enter(loop, JUMP_DWELL)
    elif mode == JUMP_DWELL and loop.phase >= loop.dwell_ticks:
        enter(loop, JUMP_DOWN)
    elif mode == JUMP_DOWN and loop.phase >= loop.phase_ticks:
        if loop.jump_resumes == 0:
            return end_motion(loop, drive, JUMP_DONE)
        enter(loop, JUMP_RETURN)
        start_pulses(loop, drive)
        loop.tick_gap_v = settings.open_v
        loop.open_ticks = 0
        return JUMP_RESUMED
    elif mode == JUMP_RETURN:
        found = watch_cut(settings, loop)  # its pulses are watched as those of the cut
        if found != NOTHING or not jump_is_back(loop, readings):
            return found
        enter(loop, SERVO)
        loop.open_ticks = 0
        return JUMP_DONE
    return NOTHING


@compiled
def jump_is_back(loop: LoopState, readings: Readings) -> bool:
    """A millisecond as busy as the reference asks for, or of shorts alone, or well past where the jump began.

    Shorts are not shown by a reference below their voltage. Or the cut's limit or the end of its time, which the
    servo then finds.
    """
    busy = loop.tick_gap_v <= loop.gap_ref_v or (loop.shorted == 1 and readings.pulses > 0)
    past = loop.command_v >= loop.start_v + loop.clearance_v
    over = loop.slow_displacement_um >= loop.z_limit_um or loop.time_ticks <= 0
    return bool(busy or past or over)


@compiled
def touch_tick(settings: Settings, loop: LoopState, drive: Drive, readings: Readings) -> int:
    mode = loop.mode
    if readings.stray_pulses > 0:
        return FAULT_MODE_SWITCH
    if readings.contact == 1 and loop.tick_gap_v > settings.short_v:
        return FAULT_GAP_SENSOR
    if loop.slow_displacement_um >= DISPLACEMENT_FAILED_UM or loop.slow_displacement_um > loop.z_max_um:
        return FAULT_NO_CONTACT
    if mode == TOUCH_FAST:
        if readings.contact == 1:
            back_off(loop)
        elif loop.displacement_um >= loop.fast_to_um:
            enter(loop, TOUCH_SLOW)
    elif mode == TOUCH_SLOW:
        if readings.contact == 1:
            loop.touch_v = drive.actuator_v
            loop.touch_sum = 0.0
            loop.touch_count = 0
            enter(loop, TOUCH_HUNT)
    elif mode == TOUCH_HUNT:
        loop.touch_sum += loop.displacement_um
        loop.touch_count += 1
        if loop.phase >= loop.dwell_ticks:
            loop.touch_no += 1
            loop.touches_left -= 1
            back_off(loop)
            return TOUCHED
    elif loop.command_v == loop.target_v:
        return end_of_back_off(loop, drive, readings)
    return NOTHING


@compiled
def end_of_back_off(loop: LoopState, drive: Drive, readings: Readings) -> int:
    """The tool rests after a back-off until contact has been open for a while; then the next touch, or the end."""
    if loop.phase_ticks == 0:  # the ramp has just ended
        loop.phase_ticks = max(BACK_OFF_TICKS, loop.phase + OPEN_TICKS)
        loop.contact_open_ticks = 0
        return NOTHING
    loop.contact_open_ticks = 0 if readings.contact == 1 else loop.contact_open_ticks + 1
    if loop.phase < loop.phase_ticks:
        return NOTHING
    if loop.contact_open_ticks < OPEN_TICKS:
        return NOTHING if loop.phase < loop.phase_ticks + PATIENCE_TICKS else FAULT_STUCK_CONTACT
    if loop.touches_left <= 0:
        return end_motion(loop, drive, TOUCHES_DONE)
    drive.contact_tests += 1
    enter(loop, TOUCH_SLOW)
    return NOTHING


@compiled
def back_off(loop: LoopState) -> None:
    loop.target_v = max(0.0, loop.command_v - loop.back_v)
    loop.ramp_v_s = loop.fast_v_s
    loop.phase_ticks = 0  # known when the ramp has ended
    enter(loop, TOUCH_BACK)


@compiled
def test_tick(loop: LoopState, drive: Drive) -> int:
    """Self test of the gap sensor: its mean with the generator off, then with the generator on."""
    ticks = TEST_OFF_TICKS if loop.mode == TEST_OFF else TEST_ON_TICKS
    if loop.phase > ticks - TEST_MEAN_TICKS:
        loop.touch_sum += loop.tick_gap_v
        loop.touch_count += 1
    if loop.phase < ticks:
        return NOTHING
    if loop.mode == TEST_ON:
        return end_motion(loop, drive, TESTED)
    loop.test_off_v = loop.touch_sum / loop.touch_count
    loop.touch_sum = 0.0
    loop.touch_count = 0
    start_pulses(loop, drive)
    enter(loop, TEST_ON)
    return NOTHING
