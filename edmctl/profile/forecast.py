"""What a job will take, before it is run: time, stroke, feed, servo stability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.process.erosion import (
    average_power_uj_s,
    feed_rate_um_s,
    mrr_mm3_min,
    pulse_energy_uj,
    removal_rate_um3_s,
)
from edmctl.process.jump import time_share
from edmctl.process.servo import LimitCycle, limit_cycle, loop_delay_s
from edmctl.process.voltage import discharge_share, isopulse_discharge_share

if TYPE_CHECKING:
    from edmctl.profile.model import Profile, Pulse
    from edmctl.profile.setup import Setup

SIDE_DISCHARGE_SHARE = 0.05
"""Discharges that burn at the wall of the hole: 3 % in a clean gap, more with debris."""
FEED_LAW_YIELD = 0.94
"""Feed of full per-pulse runs over that of the voltage law, which counts arcs as full discharges."""
STROKE_RESERVE_UM = 15.0
"""Stroke kept free beyond the job, for creep and retraction."""
CUTS_OF_A_WEARING_TOOL = 3
CUTS_OF_A_LASTING_TOOL = 2
LASTING_TOOL_RATIO = 0.1
"""Below this wear ratio the first measurement already tells the rest."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """Expected course of a job. `limit_cycle_um` is the half-amplitude of the servo's swing."""

    machining_time_s: float
    measuring_time_s: float
    time_s: float
    cuts: int
    feed_rate_um_s: float
    feed_um: float
    depth_um: float
    wear_um: float
    stroke_um: float
    stroke_available_um: float
    loop_delay_s: float
    limit_cycle_um: float
    limit_cycle_period_s: float
    spark_energy_uj: float
    mrr_mm3_min: float
    jump_share: float
    pulses: int


def forecast(profile: Profile, setup: Setup) -> Forecast:
    """Forecast a job from its recipe and the machine's settings.

    Machining time follows the mean-voltage law of the pulse process (see `edmctl.process.voltage`) and counts
    jumps; measuring time counts conditioning, approaches, touches and stage moves.
    """
    depth_um, wear_um = depth_and_wear_um(profile)
    feed_um = depth_um + wear_um
    energy_uj = pulse_energy_uj(
        profile.pulse.discharge_voltage_v, profile.pulse.current_a, profile.pulse.burning_time_us
    )
    removal_um3_s = _removal_um3_s(profile)
    rate_um_s = FEED_LAW_YIELD * feed_rate_um_s(
        removal_um3_s,
        diameter_um=profile.tool.diameter_um,
        side_gap_um=profile.work.side_gap_um,
        side_share=SIDE_DISCHARGE_SHARE,
        wear_ratio=profile.wear.expected_ratio,
    )
    delay_s, cycle = servo_loop(profile, setup)
    jump_share = time_share_of_jumps(profile)
    machining_s = feed_um / rate_um_s / max(1.0 - jump_share, 0.1)
    cuts = _expected_cuts(profile)
    measuring_s = _measuring_time_s(profile, setup, depth_um, cuts)
    return Forecast(
        machining_time_s=machining_s,
        measuring_time_s=measuring_s,
        time_s=machining_s + measuring_s,
        cuts=cuts,
        feed_rate_um_s=rate_um_s,
        feed_um=feed_um,
        depth_um=depth_um,
        wear_um=wear_um,
        stroke_um=stroke_um(profile),
        stroke_available_um=stroke_available_um(profile, setup),
        loop_delay_s=delay_s,
        limit_cycle_um=cycle.half_amplitude_um,
        limit_cycle_period_s=cycle.period_s,
        spark_energy_uj=energy_uj,
        mrr_mm3_min=FEED_LAW_YIELD * mrr_mm3_min(removal_um3_s),
        jump_share=jump_share,
        pulses=round(machining_s * profile.pulse.frequency_hz),
    )


def depth_and_wear_um(profile: Profile) -> tuple[float, float]:
    """Depth and tool wear at the target, µm, at the expected ratio of wear."""
    ratio = profile.wear.expected_ratio
    target = profile.target
    depth_um = target.depth_um if target.kind == "depth" else target.feed_um / (1.0 + ratio)
    return depth_um, ratio * depth_um


def stroke_um(profile: Profile) -> float:
    """Stroke that the job needs, µm: offset, feed and a reserve."""
    return profile.approach.offset_um + sum(depth_and_wear_um(profile)) + STROKE_RESERVE_UM


def stroke_available_um(profile: Profile, setup: Setup) -> float:
    """Stroke up to the voltage limit of the job, µm."""
    return setup.actuator.gain_um_per_v * profile.limits.stroke_v_max


def servo_loop(profile: Profile, setup: Setup) -> tuple[float, LimitCycle]:
    """Delay of the servo loop, s, and the swing that follows from it."""
    delay_s = loop_delay_s(
        servo_period_s=setup.controller.servo_period_s,
        latency_ticks=setup.controller.latency,
        filter_hz=profile.servo.filter_hz,
        actuator_lag_s=setup.controller.actuator_lag_s,
    )
    return delay_s, limit_cycle(profile.servo.forward_um_s, delay_s)


def _burning_share(pulse: Pulse, level_s: float) -> float:
    if pulse.rho >= 1.0:
        return 0.0
    if pulse.discharge_us is None:
        return discharge_share(level_s, pulse.rho)
    return isopulse_discharge_share(level_s, pulse.rho, min(1.0, pulse.discharge_us / pulse.on_time_us))


def _removal_um3_s(profile: Profile) -> float:
    pulse = profile.pulse
    full_energy_uj = pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.on_time_us)
    share = max(_burning_share(pulse, profile.servo.reference), 1e-6)
    power_uj_s = average_power_uj_s(pulse.frequency_hz, full_energy_uj, share)
    return removal_rate_um3_s(power_uj_s, profile.work.removal_um3_per_uj)


def time_share_of_jumps(profile: Profile) -> float:
    """Share of the machining time that jumps take."""
    jump = profile.jump
    if jump.mode == "off":
        return 0.0
    return time_share(jump.height_um, jump.speed_um_s, jump.dwell_s, jump.period_s)


def _expected_cuts(profile: Profile) -> int:
    remeasure = profile.wear.remeasure
    if profile.target.kind == "feed" or remeasure == "never":
        return 1
    if remeasure != "auto":
        return min(remeasure + 1, profile.wear.max_cuts)
    lasting = profile.wear.expected_ratio < LASTING_TOOL_RATIO
    return min(CUTS_OF_A_LASTING_TOOL if lasting else CUTS_OF_A_WEARING_TOOL, profile.wear.max_cuts)


def _measuring_time_s(profile: Profile, setup: Setup, depth_um: float, cuts: int) -> float:
    measure, approach, actuator = profile.measure, profile.approach, setup.actuator
    fast_s = 1.0 / measure.fast_um_s
    one_touch_s = measure.back_off_um / measure.speed_um_s + measure.dwell_s
    one_set_s = measure.settle_s + measure.touches * one_touch_s + 2.0 * approach.offset_um * fast_s
    bottoms_s = 2.0 * depth_um * fast_s * cuts
    moves_s = 2.0 * cuts * measure.site_dx_um / setup.stage.speed_um_s
    conditioning_s = (
        2.0 * actuator.conditioning_cycles * profile.limits.stroke_v_max / actuator.conditioning_slew_v_s
    )
    approaches_s = approach.offset_um / approach.speed_um_s + (cuts - 1) * (
        measure.back_off_um / approach.speed_um_s + (approach.offset_um + depth_um) * fast_s
    )
    return conditioning_s + (1 + 2 * cuts) * one_set_s + bottoms_s + moves_s + approaches_s
