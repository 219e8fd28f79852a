"""What a job will take, before it is run: time, stroke, feed, servo stability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.process.erosion import mrr_mm3_min, pulse_energy_uj
from edmctl.profile.amounts import channel, hole
from edmctl.profile.job_sequence import course_of
from edmctl.profile.rates import feed_rate_um_s, removal_um3_s, servo_loop, time_share_of_jumps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.profile.model import Profile
    from edmctl.profile.places import Place
    from edmctl.profile.setup import Setup

STROKE_RESERVE_UM = 15.0
"""Stroke kept free beyond the job, for creep and retraction."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """Expected course of a job.

    Times, cuts, measuring stops and pulses are those of the whole job, as is `tool_wear_um`; depth, wear and feed
    are of its deepest hole or of its channel, whose cuts are its passes, `depth_min_um` is that of its shallowest
    hole. `holes_in_reach` are those, in working order, for which the stroke lasts. `limit_cycle_um` is the
    half-amplitude of the servo's swing; `channel_um` and `layers` are 0 where there is no channel. `depth_u95_um` is
    half the 95 % interval of the depth that will be known least, NaN where no depth is wanted.
    """

    machining_time_s: float
    measuring_time_s: float
    time_s: float
    cuts: int
    feed_rate_um_s: float
    feed_um: float
    depth_um: float
    depth_min_um: float
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
    holes: int
    holes_in_reach: int
    stops: int
    tool_wear_um: float
    channel_um: float
    layers: int
    depth_u95_um: float


def forecast(profile: Profile, setup: Setup, places: Sequence[Place] = ()) -> Forecast:
    """Forecast a job from its recipe, the machine's settings and the places of its holes.

    Without places it is one hole beside the reference pad, or the channel of `[path]`. Machining time follows the
    mean-voltage law of the pulse process (see `edmctl.process.voltage`) and counts jumps; measuring time counts
    conditioning, approaches, touches and stage moves.
    """
    course = course_of(profile, setup, places)
    deepest, available_um = course.deepest, stroke_available_um(profile, setup)
    delay_s, cycle = servo_loop(profile, setup)
    pulse = profile.pulse
    return Forecast(
        machining_time_s=course.machining_s,
        measuring_time_s=course.measuring_s,
        time_s=course.machining_s + course.measuring_s,
        cuts=course.cuts,
        feed_rate_um_s=feed_rate_um_s(profile, deepest.depth_um),
        feed_um=deepest.feed_um,
        depth_um=deepest.depth_um,
        depth_min_um=course.depth_min_um,
        wear_um=deepest.wear_um,
        stroke_um=profile.approach.offset_um + course.lowest_um + STROKE_RESERVE_UM,
        stroke_available_um=available_um,
        loop_delay_s=delay_s,
        limit_cycle_um=cycle.half_amplitude_um,
        limit_cycle_period_s=cycle.period_s,
        spark_energy_uj=pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.burning_time_us),
        mrr_mm3_min=mrr_mm3_min(removal_um3_s(profile, deepest.depth_um)),
        jump_share=time_share_of_jumps(profile),
        pulses=round(course.machining_s * pulse.frequency_hz),
        holes=course.holes,
        holes_in_reach=_in_reach(course.reaches_um, available_um - profile.approach.offset_um),
        stops=course.stops,
        tool_wear_um=course.tool_wear_um,
        channel_um=course.channel_um,
        layers=course.layers,
        depth_u95_um=course.depth_u95_um,
    )


def _in_reach(reaches_um: Sequence[float], stroke_um: float) -> int:
    """How many holes are made before one asks for more than this stroke."""
    fits = [reach_um + STROKE_RESERVE_UM <= stroke_um for reach_um in reaches_um]
    return fits.index(False) if False in fits else len(fits)


def depth_and_wear_um(profile: Profile) -> tuple[float, float]:
    """Depth and tool wear of one hole or channel at its target, µm, at the expected ratio of wear."""
    one = hole(profile) if profile.path is None else channel(profile, profile.path)
    return one.depth_um, one.wear_um


def stroke_um(profile: Profile) -> float:
    """Stroke that one hole or the channel needs, µm: offset, feed and a reserve."""
    feed_um = sum(depth_and_wear_um(profile)) if profile.path else hole(profile).feed_um
    return profile.approach.offset_um + feed_um + STROKE_RESERVE_UM


def stroke_available_um(profile: Profile, setup: Setup) -> float:
    """Stroke up to the voltage limit of the job, µm."""
    return setup.actuator.gain_um_per_v * profile.limits.stroke_v_max
