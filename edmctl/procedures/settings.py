"""All settings of the controller for a job, derived from the recipe and the setup."""

from __future__ import annotations

import math

from edmctl.machine.interface import (
    ControllerSettings,
    MotionSettings,
    PulseLog,
    PulseMode,
    PulseSettings,
    ServoLaw,
    TelemetrySettings,
)
from edmctl.procedures.job import target_of
from edmctl.profile.model import Profile
from edmctl.profile.setup import Setup

SHORT_SHARE_OF_OPEN_VOLTAGE = 0.15  # 6 V of 40 V, between a short (1 V) and an arc (17 V)
ARC_LIMIT_SHARE = 0.886  # 19.5 V, midway between an arc (17 V) and a discharge (22 V)
ARC_DELAY_US = 3.0
"""A discharge that ignites sooner found the last plasma channel still conducting: without one a gap of some µm
breaks down after tens of µs on average (mean gap voltage 0.8 of open, Muralidhara et al. 2009, Fig. 6)."""
RETRACT_UM_S = 1000.0  # to 0 V when disarmed and on any fault: 356 µm in 0.4 s, a third of the slew limit
SAFE_CLEARANCE_UM = 20.0  # above the surface while stages move: several times tilt (0.3 mrad, 5 mm) and creep
SHORT_STUCK_S = 1.5  # healthy shorts clear in 70 ms; 1 s at 200 µm/s clears any debris bridge (decision 0012)
ARC_RUN = 20  # consecutive arcs that are a burn: healthy gaps show 4, badly flushed ones 11 (decision 0012)
OPEN_LOST_S = 3.0  # without any discharge: a healthy gap is open for 14 ms at most (decision 0012)

JUMPING = 2.0  # a feed through open pulses takes this many times as long as at the servo's speed, with jumps
_LARGEST_COUNT = 250  # pulses per telemetry sample that a count of one byte still holds, with a margin of 2 %
_FRAME_S = 0.1  # telemetry frames come this often where the rate allows: the supervisor's 10 Hz
_LARGEST_BATCH = 14  # samples of 16 bytes that fit the 240 bytes of one frame
_JOB_HZ = 100.0  # samples a job needs: 200 of the conditioning swings to identify, three of a touch's dwell


def controller_settings(profile: Profile, setup: Setup) -> ControllerSettings:
    """Return the controller's parameters for this recipe on this machine."""
    servo, actuator, pulse = profile.servo, setup.actuator, profile.pulse
    # Behind the sheet nothing but open pulses is right; before, the host looks (servo/limits.py).
    completion_um = target_of(profile).completion_um
    lost_um = profile.limits.open_lost_um
    if completion_um:
        # The host sees the breakthrough within one such way of the last spark, and this has to be further on.
        lost_um = completion_um + 2.0 * lost_um
    return ControllerSettings(
        piezo_max_v=profile.limits.stroke_v_max,
        slew_limit_v_s=actuator.slew_v_s,
        gain_um_per_v=actuator.gain_um_per_v,
        safe_z_um=profile.approach.offset_um - SAFE_CLEARANCE_UM,
        retract_v_s=retract_v_s(setup),
        sensor_fitted=setup.sensor.fitted,
        servo_law=ServoLaw.PI if servo.mode == "pi" else ServoLaw.RELAY,
        forward_um_s=servo.forward_um_s,
        back_um_s=servo.back_um_s,
        short_back_um_s=servo.short_back_um_s,
        filter_hz=servo.filter_hz,
        hysteresis=servo.hysteresis,
        kp_um_s=servo.kp,
        ki_um_s2=servo.ki,
        servo_period_us=setup.controller.servo_period_us,
        servo_latency=setup.controller.latency,
        short_v=SHORT_SHARE_OF_OPEN_VOLTAGE * pulse.open_voltage_v,
        arc_v=ARC_LIMIT_SHARE * pulse.discharge_voltage_v,
        arc_delay_us=ARC_DELAY_US,
        block_pulses=block_pulses(profile),
        short_stuck_s=SHORT_STUCK_S,
        arc_run=ARC_RUN,
        open_lost_um=lost_um,
        open_lost_s=OPEN_LOST_S + (JUMPING * lost_um / servo.forward_um_s if completion_um else 0.0),
        watchdog_s=setup.controller.watchdog_s,
        dielectric_required=profile.flush.required,
        flow_min_lpm=profile.flush.min_flow_lpm,
        temperature_max_c=profile.flush.max_temp_c,
    )


def motion_settings(setup: Setup, safe_z_um: float, *, sensor_fitted: bool, pulses: bool) -> MotionSettings:
    """Return the parameters of a machine that follows no recipe; without `pulses` it needs no dielectric."""
    actuator = setup.actuator
    return MotionSettings(
        piezo_max_v=actuator.stroke_v,
        slew_limit_v_s=actuator.slew_v_s,
        gain_um_per_v=actuator.gain_um_per_v,
        safe_z_um=safe_z_um,
        retract_v_s=retract_v_s(setup),
        sensor_fitted=sensor_fitted,
        watchdog_s=setup.controller.watchdog_s,
        dielectric_required=pulses,
    )


def retract_v_s(setup: Setup) -> float:
    return min(setup.actuator.slew_v_s, RETRACT_UM_S / setup.actuator.gain_um_per_v)


def block_pulses(profile: Profile) -> int:
    """Pulses per recorded block: about 10 ms of them."""
    return min(_LARGEST_COUNT, max(1, round(0.01 * fastest_hz(profile))))


def fastest_hz(profile: Profile) -> float:
    """Pulses per second, of the regime that has most of them."""
    return max((one.frequency_hz or 0.0 for one in profile.regimes), default=profile.pulse.frequency_hz)


def pulse_settings(profile: Profile) -> PulseSettings:
    pulse = profile.pulse
    return PulseSettings(
        on_time_us=pulse.on_time_us,
        off_time_us=pulse.off_time_us,
        open_voltage_v=pulse.open_voltage_v,
        peak_current_a=pulse.current_a,
        mode=PulseMode.ISOPULSE if pulse.mode == "isopulse" else PulseMode.ISOFREQUENCY,
        discharge_us=pulse.discharge_us or 0.0,
    )


def telemetry_settings(profile: Profile, setup: Setup) -> TelemetrySettings:
    """Sampling for the host: a multiple of the logged rate that suffices for the job, as the line allows."""
    slowest_hz = max(_JOB_HZ, fastest_hz(profile) / _LARGEST_COUNT)
    rate_hz = profile.log.servo_hz * math.ceil(slowest_hz / profile.log.servo_hz)
    rate_hz = min(rate_hz, setup.controller.telemetry_hz)
    tick_us = setup.controller.servo_period_us
    period_us = tick_us * max(1, round(1e6 / rate_hz / tick_us))
    return TelemetrySettings(
        period_us=period_us,
        batch=max(1, min(_LARGEST_BATCH, math.floor(_FRAME_S * 1e6 / period_us + 1e-9))),
        pulse_log={"off": PulseLog.OFF, "blocks": PulseLog.BLOCKS, "full": PulseLog.FULL}[profile.log.pulses],
    )


def recorded_every(profile: Profile, setup: Setup) -> int:
    """Of so many telemetry samples one is recorded, where the telemetry has to be faster than the log."""
    rate_hz = 1e6 / telemetry_settings(profile, setup).period_us
    return max(1, round(rate_hz / profile.log.servo_hz))


def first_sparks_v(profile: Profile) -> float:
    """Return the mean gap voltage at which an approach ends, V: halfway from open to the servo's reference.

    An approach that waits for the reference itself would cut without end where erosion is as fast as the approach.
    The first sparks lower the mean at once.
    """
    return 0.5 * (1.0 + profile.servo.reference) * profile.pulse.duty_voltage_v


def gap_reference_v(profile: Profile) -> float:
    """Return the mean gap voltage that the servo holds, V."""
    return profile.servo.reference * profile.pulse.duty_voltage_v
