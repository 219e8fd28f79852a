"""How long a machine takes for everything but machining: conditioning, approaches, touches, stage moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.forecasts.removal import jump_duration_s

if TYPE_CHECKING:
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup

STARTING_S = 1.6
"""Arming, the test of the gap sensor and a rest before the first stroke."""
MOVING_S = 0.7
"""A stage move besides its way: ramp to 0 V, rest, and play of the drive."""
RELUCTANCE = 1.45
"""From 0 V the actuator follows its command with less than its mean gain: an approach at 1 µm/s over 45 µm took
65 s (hysteresis of the piezo, Muralidhara et al. 2009, Fig. 3a)."""
RELUCTANCE_TOUCHING = 1.25
"""The same on average over a fast leg and the slow one after it."""
RISE_UM = 60.0
"""Before a bottom is touched the tool rises by this."""
FAST_LEG_MARGIN_UM = 3.0
OFFSET_U_UM, WEAR_U_SHARE = 7.0, 0.05
"""The slow leg begins earlier by what is unknown: of the first surface, and of the wear as a share of the feed."""
RIM_WEAR_SHARE = 0.3
"""Behind a sheet the tool hardly wears, so the pad is met earlier than expected by this share of the feed there."""
FURTHER_SPOT_S = 6.5
"""Pad and face are touched at a second spot: a move, the way down, and one touch, one less at the first spot."""
SAMPLING_S = 0.4
"""At the end of a reading, for the last samples."""
FAST_DESCENT_S = 2.0
LAST_UM = 15.0
"""Down to a known surface in fast steps, and the last µm at the speed of the approach."""
CREEP_STROKE_UM = 430.0
"""After a long fast descent the actuator creeps on by itself and shortens the slow one, down to a third."""


@dataclass(frozen=True, slots=True)
class Stand:
    """Where the stages stand."""

    x_um: float
    y_um: float
    theta_deg: float = 0.0


def conditioning_time_s(profile: Profile, setup: Setup) -> float:
    """From arming to a conditioned actuator at the parking place, s."""
    actuator = setup.actuator
    strokes_s = 2.0 * profile.limits.stroke_v_max / actuator.conditioning_slew_v_s
    return STARTING_S + actuator.conditioning_cycles * strokes_s


def approach_time_s(profile: Profile, setup: Setup) -> float:
    """From an idle machine to the spark gap beside the reference pad: conditioning, the move, the approach, s."""
    way_um = park_to_pad_um(setup) + profile.measure.site_dx_um
    move_s = move_time_s(way_um, setup)
    return conditioning_time_s(profile, setup) + move_s + surface_time_s(profile)


def touch_time_s(profile: Profile, setup: Setup) -> float:
    """From an idle machine to a reading of the reference pad: conditioning, the move, all its touches, s."""
    move_s = move_time_s(park_to_pad_um(setup), setup)
    return conditioning_time_s(profile, setup) + move_s + pad_time_s(profile)


def jumps_time_s(profile: Profile, count: int, period_s: float) -> float:
    """Electrode jumps that begin every `period_s`, or one after the other where they take longer, s."""
    return count * max(period_s, jump_duration_s(profile))


def surface_time_s(profile: Profile) -> float:
    """From home to the spark gap over an untouched surface at the offset, s."""
    way_um = max(0.0, profile.approach.offset_um - profile.measure.expected_gap_um)
    return RELUCTANCE * way_um / profile.approach.speed_um_s


def pad_time_s(profile: Profile) -> float:
    """One reading of the untouched pad from home: all its touches, s."""
    first_s = reading_time_s(profile, profile.approach.offset_um, OFFSET_U_UM, RELUCTANCE_TOUCHING)
    return first_s + further_spot_s(profile)


def face_time_s(profile: Profile, way_um: float) -> float:
    """One reading of the face at a place, expected `way_um` below the tool, s."""
    return reading_time_s(profile, way_um) + further_spot_s(profile)


def further_spot_s(profile: Profile) -> float:
    """How much longer a reading takes because pad or face are touched at two spots, s."""
    return FURTHER_SPOT_S - (again_s(profile) if profile.measure.touches > 1 else 0.0)


def again_s(profile: Profile) -> float:
    """One more touch at the same place, s."""
    measure = profile.measure
    return measure.back_off_um / measure.speed_um_s + measure.dwell_s


def reading_time_s(
    profile: Profile, way_um: float, unknown_um: float = 0.0, reluctance: float = 1.0
) -> float:
    """One reading of a surface expected `way_um` below the tool, known within `unknown_um`, s."""
    measure = profile.measure
    slow_um = min(FAST_LEG_MARGIN_UM + unknown_um, way_um)
    down_s = slow_um / measure.speed_um_s + (way_um - slow_um) / measure.fast_um_s
    rest_s = measure.settle_s + measure.dwell_s + SAMPLING_S
    return rest_s + reluctance * down_s + (measure.touches - 1) * again_s(profile)


def descent_time_s(profile: Profile, place_um: float) -> float:
    """From home to the spark gap over a surface or bottom that is known to be `place_um` below, s."""
    slow_um = LAST_UM * max(1.0 - place_um / CREEP_STROKE_UM, 1.0 / 3.0)
    return FAST_DESCENT_S + slow_um / profile.approach.speed_um_s


def stop_time_s(
    profile: Profile,
    feed_um: float,
    wear_um: float,
    pad_s: float,
    *,
    bottom: bool = True,
    rim_um: float = 0.0,
) -> float:
    """One measuring stop after a cut of `feed_um`, with a tool worn by `wear_um`: bottom, if any, and pad, s.

    `pad_s` is the way of the stages to the pad; over the last `rim_um` of the feed nobody knows the wear.
    """
    surface_um = profile.approach.offset_um + wear_um
    bottom_s = 0.5 + reading_time_s(profile, RISE_UM) if bottom else 0.0
    early_um = RIM_WEAR_SHARE * rim_um
    unknown_um = math.hypot(WEAR_U_SHARE * feed_um, 2.0 * rim_um / math.sqrt(12.0)) - early_um
    pad_reading_s = reading_time_s(profile, surface_um - early_um, unknown_um, RELUCTANCE_TOUCHING)
    return bottom_s + pad_s + pad_reading_s + further_spot_s(profile)


def pad_of(setup: Setup) -> Stand:
    """The reference pad."""
    return Stand(setup.stage.reference_x_um, setup.stage.reference_y_um)


def park_to_pad_um(setup: Setup) -> float:
    """Way of the stages from the parking place to the reference pad, µm."""
    stage = setup.stage
    return abs(stage.reference_x_um - stage.park_x_um) + abs(stage.reference_y_um - stage.park_y_um)


def beside_pad_um(profile: Profile, setup: Setup) -> tuple[float, float]:
    """Place of the single hole of a job without `[[sites]]`, stage coordinates in µm."""
    return setup.stage.reference_x_um + profile.measure.site_dx_um, setup.stage.reference_y_um


def between_s(start: Stand, end: Stand, setup: Setup) -> float:
    """One move of the stages from place to place, axis after axis, s."""
    way_um = abs(end.x_um - start.x_um) + abs(end.y_um - start.y_um)
    return move_time_s(way_um, setup) + abs(end.theta_deg - start.theta_deg) / setup.stage.rotary_deg_s


def move_time_s(way_um: float, setup: Setup) -> float:
    """One move of the stages over a way, retraction and all, s."""
    return MOVING_S + way_um / setup.stage.speed_um_s
