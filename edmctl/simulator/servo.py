"""The command of the actuator: the gap servo's law and the ramps of every other motion, within slew and range.

Muralidhara et al. 2009, Fig. 6: filtered mean gap voltage, comparator, ramp up or down from the present level.
"""

from __future__ import annotations

from edmctl.actuator.compiling import compiled
from edmctl.link.messages import State
from edmctl.simulator.controller_state import (
    APPROACH,
    HISTORY,
    HOLD,
    JUMP_DOWN,
    JUMP_RETURN,
    JUMP_UP,
    RAMP,
    RELAY,
    SERVO,
    TOUCH_BACK,
    TOUCH_FAST,
    TOUCH_HUNT,
    TOUCH_SLOW,
    LoopState,
    Settings,
)
from edmctl.simulator.plant_interface import TICK_S, Drive, Readings, on_grid

SETTLE_TICKS = 100  # generator on before the approach judges the gap voltage
SHORT_HURRY_TICKS = 500  # a short this long retracts four times as fast
BLEND_TICKS = 8  # of a jump's ramp, at each end
IN_APPROACH, IN_MACHINING, IN_JUMP = int(State.APPROACH), int(State.MACHINING), int(State.JUMP)
HOLD_PER_S = 4.0  # of the way to a scan's limit; well below the bandwidth of the displacement's low-pass


@compiled
def command_tick(settings: Settings, loop: LoopState, drive: Drive, readings: Readings) -> None:
    """Move the actuator's command by one millisecond, within slew and range, onto the converter's grid."""
    drive.stage_moves = 0
    mode = loop.mode
    before = loop.command_v
    most = settings.slew_limit_v_s * TICK_S
    v = before
    slope_v_s = 0.0  # asked for; that of a jump is within the limit by its plan
    if mode == HOLD:
        pass
    elif mode == SERVO:
        slope_v_s = loop.rate_v_s
    elif mode in (RAMP, TOUCH_BACK):
        step = loop.ramp_v_s * TICK_S
        if abs(loop.target_v - v) > most:
            slope_v_s = loop.ramp_v_s
        v = min(loop.target_v, v + step) if loop.target_v > v else max(loop.target_v, v - step)
    elif mode == APPROACH:
        if loop.phase >= SETTLE_TICKS and loop.shorted == 0:
            slope_v_s = loop.slow_v_s
    elif mode == JUMP_UP:
        v = loop.start_v - loop.jump_v * s_curve(loop.phase + 1, loop.phase_ticks)
    elif mode == JUMP_DOWN:
        back = loop.clearance_v - loop.jump_v
        v = (loop.start_v - loop.jump_v) - back * s_curve(loop.phase + 1, loop.phase_ticks)
    elif mode in (JUMP_RETURN, TOUCH_FAST):
        slope_v_s = loop.fast_v_s
    elif mode == TOUCH_SLOW:
        slope_v_s = loop.slow_v_s
    elif mode == TOUCH_HUNT:
        slope_v_s = (-1.0 if readings.contact == 1 else 1.0) * loop.slow_v_s
    if mode not in (RAMP, TOUCH_BACK):
        v += slope_v_s * TICK_S
    loop.slewed = (
        1 if abs(slope_v_s) > settings.slew_limit_v_s else 0
    )  # before it is summed: sums are rounded
    v = min(before + most, max(before - most, v))
    top = max(settings.piezo_max_v, before)  # what a reset has left beyond the range comes down by its ramp
    loop.limit_ticks = loop.limit_ticks + 1 if v > top else 0
    v = min(top, max(0.0, v))
    loop.command_v = v
    drive.actuator_v = on_grid(v)
    sparks = loop.link_state == IN_APPROACH or loop.link_state == IN_MACHINING or loop.link_state == IN_JUMP
    drive.generator = 1 if drive.pulses_on or sparks else 0


@compiled
def s_curve(tick: int, ticks: int) -> float:
    """Share of a ramp after `tick` of `ticks`: constant speed with soft ends, so that the tool does not ring."""
    blend = min(BLEND_TICKS, 0.5 * ticks)
    peak = 1.0 / (ticks - blend)
    if tick < blend:
        return float(0.5 * peak * tick * tick / blend)
    if tick <= ticks - blend:
        return float(peak * (tick - 0.5 * blend))
    rest = ticks - tick
    return float(1.0 - 0.5 * peak * rest * rest / blend)


@compiled
def servo_tick(settings: Settings, loop: LoopState) -> None:
    """Gap servo: relay with hysteresis, or PI velocity.

    Decisions fall every `servo_ticks` and act on the value `latency_decisions` decisions old.
    """
    if settings.servo_ticks > 1 and loop.phase % settings.servo_ticks != 0:
        return
    count = loop.servo_count
    per_duty_v = settings.per_duty_v
    loop.history[count & (HISTORY - 1)] = loop.gap_v * per_duty_v
    loop.servo_count = count + 1
    s = loop.history[max(0, count - settings.latency_decisions) & (HISTORY - 1)]
    error = s - loop.gap_ref_v * per_duty_v
    if loop.shorted == 1:
        hurry = 4.0 if loop.short_ticks > SHORT_HURRY_TICKS else 1.0
        loop.rate_v_s = -hurry * settings.short_back_um_s * settings.v_per_um
        loop.direction = -1
        return
    if settings.law == RELAY:
        if error > 0.5 * settings.hysteresis:
            loop.direction = 1
        elif error < -0.5 * settings.hysteresis:
            loop.direction = -1
        speed = settings.forward_um_s if loop.direction > 0 else -settings.back_um_s
        loop.rate_v_s = speed * settings.v_per_um
        return
    dt = settings.servo_ticks * TICK_S
    forward, back = settings.forward_um_s, settings.back_um_s
    loop.integral_um_s = min(forward, max(-back, loop.integral_um_s + settings.ki_um_s2 * error * dt))
    speed = min(forward, max(-back, settings.kp_um_s * error + loop.integral_um_s))
    loop.direction = 1 if speed >= 0.0 else -1
    loop.rate_v_s = speed * settings.v_per_um


@compiled
def hold_at_limit(settings: Settings, loop: LoopState) -> None:
    """Let the servo feed no faster than brings a scanning tool softly to its limit, from either side.

    Nothing slows down the way back out of a short.
    """
    most = HOLD_PER_S * (loop.z_limit_um - loop.slow_displacement_um)
    if loop.rate_v_s > most * settings.v_per_um:
        loop.rate_v_s = min(loop.rate_v_s, max(most, -settings.back_um_s) * settings.v_per_um)
        loop.integral_um_s = min(loop.integral_um_s, max(0.0, most))
