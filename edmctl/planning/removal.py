"""How much a hole removes, how fast a recipe erodes, and how the tool moves over the gap meanwhile.

That motion is the limit cycle of the relay servo, and electrode jumps that flush. A relay that flips an
integrator's slope after a dead time L makes a triangle of half-amplitude slope x L and period 4 L (exact for an
ideal integrator).
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass
from edmctl.planning.erosion import expected_gap, recipes_of, usual_depth_um
from edmctl.process.discharge import hole_area_um2
from edmctl.profile.model import Profile
from edmctl.profile.setup import Setup

SIDE_DISCHARGE_SHARE = 0.05
"""Discharges that burn at the wall of the hole: 3 % in a clean gap, more with debris."""
CATCHING_UP = 1.6
"""An approach that has to be faster than the feed is so much faster: the first sparks burn in clean oil."""
LEAST_MACHINING_SHARE = 0.1
"""However much it jumps; a recipe that jumps more than 0.3 of the time is refused anyway."""
PAD_MARGIN_UM = 50.0  # surface that remains between a hole and the reference pad, for the burr and the stages
WALL_UM = 20.0  # wall between two holes or two sides of a channel
HALF_AMPLITUDE_DESIGN_UM = 0.5
"""Swing (half-amplitude) below which shorts do not rise: 0.15 of the working gap, from a simulated sweep."""
HALF_AMPLITUDE_LIMIT_UM = 1.0
"""Swing beyond which shorts rise steeply: 0.3 of the working gap, from the same sweep."""


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


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """The steady swing of the relay loop."""

    loop_delay_s: float
    half_amplitude_um: float
    period_s: float


def hole(profile: Profile, depth_um: float = math.nan) -> Hole:
    """The hole of the profile's target, or one of this depth instead."""
    ratio, target = profile.wear.expected_ratio, profile.target
    completion_um = 0.0
    if target.kind == "through":
        depth_um, completion_um = profile.work.thickness_um, completion(profile)
    elif math.isnan(depth_um):
        depth_um = target.depth_um if target.kind == "depth" else target.feed_um / (1.0 + ratio)
    if profile.regimes:
        return Hole(depth_um, math.fsum(one.wear_um for one in recipes_of(profile)))
    return Hole(depth_um, ratio * depth_um, completion_um)


def completion(profile: Profile) -> float:
    """Feed after a breakthrough, µm: as the target says, or until the rounded tip of the worn tool is through."""
    target = profile.target
    given = target.completion_um if target.kind == "through" else None
    return profile.tool.diameter_um / 2.0 if given is None else given


def removal_um3_s(profile: Profile, depth_um: float) -> float:
    """Work removed at the bottom of a hole or channel while sparking, µm³/s, on average until it is so deep.

    The gap's steady state (`edmctl.process.steady_gap`), with the removal per energy that the profile states.
    """
    gap, mean = expected_gap(profile, depth_um), expected_gap(profile, usual_depth_um(profile))
    stated = profile.work.removal_um3_per_uj / mean.removal_um3_per_uj
    return stated * gap.removal_um3_s * (1.0 - gap.side_share)


def feed_rate_um_s(profile: Profile, depth_um: float) -> float:
    """Tool feed in a hole while sparking, µm/s."""
    section_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
    return removal_um3_s(profile, depth_um) / section_um2 * (1.0 + profile.wear.expected_ratio)


def approach_speed_um_s(profile: Profile) -> float:
    """Speed towards the spark gap: the profile's, unless sparks erode faster than that.

    Then the tool would never catch up with what its first sparks remove, and find no gap at all.
    """
    feed_um_s = feed_rate_um_s(profile, 0.0)
    if feed_um_s <= profile.approach.speed_um_s:
        return profile.approach.speed_um_s
    return min(CATCHING_UP * feed_um_s, profile.servo.forward_um_s)


def machining_share(profile: Profile) -> float:
    """Share of the machining time that is left beside the jumps.

    What is lost after a jump, until the servo is back, the clean gap makes up for.
    """
    return max(1.0 - time_share_of_jumps(profile), LEAST_MACHINING_SHARE)


def time_share_of_jumps(profile: Profile) -> float:
    """Share of the machining time that jumps take; adaptive ones as if they kept to their period."""
    return 0.0 if profile.jump.mode == "off" else jump_duration_s(profile) / profile.jump.period_s


def jump_duration_s(profile: Profile) -> float:
    """Time of one jump, s."""
    jump = profile.jump
    return jump_time_s(jump.height_um, jump.speed_um_s, jump.dwell_s)


def jump_time_s(height_um: float, speed_um_s: float, dwell_s: float) -> float:
    """Time of one jump, up and down with a dwell at the top."""
    return 2.0 * height_um / speed_um_s + dwell_s


def servo_swing(profile: Profile, setup: Setup) -> LimitCycle:
    """The swing of the gap servo that follows from the dead time of its loop.

    That is half a period of hold, the latency, the low-pass and the actuator's lag. Lags count fully, so the swing
    is over-predicted when they dominate.
    """
    controller, servo = setup.controller, profile.servo
    hold_s = (0.5 + controller.latency) * controller.servo_period_s
    delay_s = hold_s + 1.0 / (2.0 * math.pi * servo.filter_hz) + controller.actuator_lag_s
    return LimitCycle(delay_s, servo.forward_um_s * delay_s, 4.0 * delay_s)


def least_jump_um(depth_um: float, diameter_um: float, side_gap_um: float) -> float:
    """Least useful jump height in µm: the tool's stroke must refill the annulus beside it.

    `h_min = 4 s z / d * (1 + s / d)`: annulus volume of depth z over the tool's face.
    """
    return 4.0 * side_gap_um * depth_um / diameter_um * (1.0 + side_gap_um / diameter_um)
