"""How much a hole removes, how fast a recipe erodes, and how the servo swings meanwhile."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.process.discharge import (
    discharge_share,
    hole_area_um2,
    isopulse_discharge_share,
    pulse_energy_uj,
    tool_area_um2,
)
from edmctl.process.servo import LimitCycle, jump_time_s, limit_cycle, loop_delay_s

if TYPE_CHECKING:
    from edmctl.profile.model import Profile, Pulse
    from edmctl.profile.setup import Setup

SIDE_DISCHARGE_SHARE = 0.05
"""Discharges that burn at the wall of the hole: 3 % in a clean gap, more with debris."""
YIELD_CLEAN, YIELD_LOST = 1.04, 0.056
"""Removal of per-pulse runs over that of the voltage law, which counts arcs as full discharges: the first in a
clean gap, less the second per debris in it."""
FLUSH_DEPTH_RATIO = 0.7
"""Depth over diameter of a hole that takes twice as long to flush as a flat face."""
LEAST_YIELD = 0.5
LEAST_MACHINING_SHARE = 0.1
"""However much it jumps; a recipe that jumps more than 0.3 of the time is refused anyway."""
RECOVERY_S = 0.25
"""Machining lost after a jump, while the servo comes back to the gap from a little above it."""


@dataclass(frozen=True, slots=True)
class Hole:
    """One hole at the expected ratio of wear; `completion_um` is fed on after a breakthrough."""

    depth_um: float
    wear_um: float
    completion_um: float = 0.0

    @property
    def feed_um(self) -> float:
        """How far the tool feeds below the surface, wear and all."""
        return self.depth_um + self.wear_um + self.completion_um


def hole(profile: Profile, depth_um: float = math.nan) -> Hole:
    """The hole of the profile's target, or one of this depth instead."""
    ratio, target = profile.wear.expected_ratio, profile.target
    completion_um = 0.0
    if target.kind == "through":
        depth_um, completion_um = profile.work.thickness_um, completion(profile)
    elif math.isnan(depth_um):
        depth_um = target.depth_um if target.kind == "depth" else target.feed_um / (1.0 + ratio)
    return Hole(depth_um, ratio * depth_um, completion_um)


def completion(profile: Profile) -> float:
    """Feed after a breakthrough, µm: as the target says, or until the rounded tip of the worn tool is through."""
    target = profile.target
    given = target.completion_um if target.kind == "through" else None
    return profile.tool.diameter_um / 2.0 if given is None else given


def removal_um3_s(profile: Profile, depth_um: float) -> float:
    """Work removed at the bottom of a hole or channel while sparking, µm³/s, on average until it is so deep.

    The mean-voltage law (see `edmctl.process.discharge`), less what burns at the wall and what arcs leave undone,
    which is more the worse a deep hole flushes.
    """
    pulse = profile.pulse
    full_energy_uj = pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.on_time_us)
    share = max(_burning_share(pulse, profile.servo.reference), 1e-6)
    power_uj_s = pulse.frequency_hz * full_energy_uj * share
    law_um3_s = profile.work.removal_um3_per_uj * power_uj_s
    return law_um3_s * (1.0 - SIDE_DISCHARGE_SHARE) * _yield(profile, depth_um)


def feed_rate_um_s(profile: Profile, depth_um: float) -> float:
    """Tool feed in a hole while sparking, µm/s."""
    section_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
    return removal_um3_s(profile, depth_um) / section_um2 * (1.0 + profile.wear.expected_ratio)


def machining_share(profile: Profile) -> float:
    """Share of the machining time that is left beside the jumps."""
    lost_s = 0.0 if profile.jump.mode == "off" else RECOVERY_S / profile.jump.period_s
    return max(1.0 - time_share_of_jumps(profile) - lost_s, LEAST_MACHINING_SHARE)


def time_share_of_jumps(profile: Profile) -> float:
    """Share of the machining time that jumps take; adaptive ones as if they kept to their period."""
    jump = profile.jump
    if jump.mode == "off":
        return 0.0
    return jump_duration_s(profile) / jump.period_s


def jump_duration_s(profile: Profile) -> float:
    """Time of one jump, s."""
    jump = profile.jump
    return jump_time_s(jump.height_um, jump.speed_um_s, jump.dwell_s)


def servo_swing(profile: Profile, setup: Setup) -> LimitCycle:
    """The swing of the gap servo that follows from the delay of its loop."""
    delay_s = loop_delay_s(
        servo_period_s=setup.controller.servo_period_s,
        latency_ticks=setup.controller.latency,
        filter_hz=profile.servo.filter_hz,
        actuator_lag_s=setup.controller.actuator_lag_s,
    )
    return limit_cycle(profile.servo.forward_um_s, delay_s)


def _yield(profile: Profile, depth_um: float) -> float:
    """Removal over that of the voltage law, on average down to a depth."""
    diameter_um = profile.tool.diameter_um
    areas = tool_area_um2(diameter_um) / hole_area_um2(diameter_um, profile.work.side_gap_um)
    volume = 1.0 + profile.wear.expected_ratio * areas
    flushing = 1.0 + (depth_um / (FLUSH_DEPTH_RATIO * diameter_um)) ** 2 / 3.0
    return max(YIELD_CLEAN - YIELD_LOST * volume * flushing, LEAST_YIELD)


def _burning_share(pulse: Pulse, level_s: float) -> float:
    if pulse.rho >= 1.0:
        return 0.0
    if pulse.discharge_us is None:
        return discharge_share(level_s, pulse.rho)
    return isopulse_discharge_share(level_s, pulse.rho, min(1.0, pulse.discharge_us / pulse.on_time_us))
