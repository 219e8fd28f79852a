"""What a job will take, before it is run: its holes or its channel in order, time, stroke, feed, servo stability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import accumulate
from typing import Any

from edmctl.dataclasses import dataclass, replace
from edmctl.planning.channel import Channel
from edmctl.planning.measuring import (
    FACE_LIMIT_UM,
    Cut,
    beside_pad_um,
    between_s,
    channel_depth_u95_um,
    descent_time_s,
    face_time_s,
    move_time_s,
    pad_of,
    planned_cuts,
    stop_time_s,
    touch_time_s,
)
from edmctl.planning.removal import (
    Hole,
    Recipe,
    expected_ra_um,
    feed_rate_um_s,
    hole,
    machining_share,
    ra_of_regimes_um,
    recipes_of,
    removal_um3_s,
    servo_swing,
    time_share_of_jumps,
)
from edmctl.process.erosion import hole_area_um2, mrr_mm3_min, pulse_energy_uj, roughness_rz_um
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.profile.setup import Setup
from edmctl.results.result import Forecast, RegimeForecast

PLANE_TOUCHES = 3
STROKE_RESERVE_UM = 15.0  # stroke kept free beyond the job, for creep and retraction


@dataclass(frozen=True, slots=True)
class Reached:
    """How deep an earlier run has made a hole, by its name, or the channel."""

    site: str = ""
    depth_um: float = 0.0


def working_order(profile: Profile, setup: Setup, places: Sequence[Place]) -> list[Place]:
    """The places as they are worked off: as given, or the nearest next; ties go to the one written first."""
    if profile.array.order == "given":
        return list(places)
    left, here, ordered = list(places), pad_of(setup), list[Place]()
    while left:
        x_um, y_um = here.x_um, here.y_um
        here = min(left, key=lambda place: math.hypot(place.x_um - x_um, place.y_um - y_um))
        left.remove(here)
        ordered.append(here)
    return ordered


@dataclass(frozen=True, slots=True)
class _Visit:
    """A hole of a job: place, what an earlier run has made, the remaining cuts, and the wear by holes before."""

    stand: Place
    hole: Hole
    done: Hole
    worn_um: float
    cuts: list[Cut]


def _holes_course(
    profile: Profile, setup: Setup, places: Sequence[Place], reached: Reached
) -> tuple[Hole, dict[str, Any]]:
    """Return the deepest hole, and values of the forecast."""
    ordered = working_order(profile, setup, places)
    stands = ordered or [Place(reached.site, *beside_pad_um(profile, setup))]
    plane = len(ordered) >= PLANE_TOUCHES and profile.array.surface == "plane"
    holes = [hole(profile, place.depth_um) for place in stands]
    all_cuts = _planned(profile, setup, holes, stands, plane=plane)
    visits, worn_um = list[_Visit](), 0.0
    for stand, one, cuts in zip(stands, holes, all_cuts, strict=True):
        done_um = reached.depth_um if stand.name == reached.site else 0.0
        done = Hole(done_um, one.wear_um * done_um / one.depth_um)
        visits.append(_Visit(stand, one, done, worn_um, _after(cuts, done.feed_um)))
        worn_um += one.wear_um
    deepest = max(holes, key=lambda one: one.depth_um)
    available_um, own_um = stroke_available_um(profile, setup), profile.approach.offset_um + STROKE_RESERVE_UM
    reaches_um = [one.worn_um + one.hole.feed_um for one in visits]
    fits = [reach_um + own_um <= available_um for reach_um in reaches_um]
    return deepest, {
        "machining_time_s": math.fsum(hole_time_s(profile, one.hole, one.done.depth_um) for one in visits),
        "measuring_time_s": _measuring_s(profile, setup, visits, plane=plane),
        "cuts": sum(len(one.cuts) for one in visits),
        "stops": sum(cut.measured for one in visits for cut in one.cuts),
        "holes": len(holes),
        "holes_in_reach": fits.index(False) if False in fits else len(fits),
        "stroke_um": profile.approach.offset_um + max(reaches_um) + STROKE_RESERVE_UM,
        "tool_wear_um": list(accumulate(one.hole.wear_um - one.done.wear_um for one in visits))[-1],
        "depth_min_um": min(one.depth_um for one in holes),
        "depth_u95_um": max(cuts[-1].depth_u95_um for cuts in all_cuts),
        "channel_um": 0.0,
        "layers": 0,
    }


def _channel_course(whole: Channel, setup: Setup, reached_um: float) -> tuple[Hole, dict[str, Any]]:
    """Return the channel as a hole, and values of the forecast."""
    done = min(whole.layers - 1, int(reached_um / whole.depth_um * whole.layers))
    passes, lowest_um = whole.passes(setup, done), whole.depth_um + whole.wear_um
    return Hole(whole.depth_um, whole.wear_um), {
        "machining_time_s": passes * whole.pass_time_s,
        "measuring_time_s": whole.measuring_s(setup, done),
        "cuts": passes,
        "stops": sum(layer > done for layer in whole.stops_after(setup)),
        "holes": 0,
        "holes_in_reach": 0,
        "stroke_um": whole.profile.approach.offset_um + lowest_um + STROKE_RESERVE_UM,
        "tool_wear_um": whole.wear_um * (1.0 - done / whole.layers),
        "depth_min_um": whole.depth_um,
        "depth_u95_um": channel_depth_u95_um(setup, whole.depth_um),
        "channel_um": whole.length_um,
        "layers": whole.layers,
    }


def _planned(
    profile: Profile, setup: Setup, holes: Sequence[Hole], stands: Sequence[Place], *, plane: bool
) -> list[list[Cut]]:
    """Return the cuts of every hole; those of the next regime begin as a new hole: its pulses are not known."""
    pad = pad_of(setup)
    away_um = [math.hypot(stand.x_um - pad.x_um, stand.y_um - pad.y_um) for stand in stands]
    if not profile.regimes:
        return planned_cuts(profile, setup, holes, away_um, plane=plane)
    of_regimes = (
        planned_cuts(one.profile, setup, [Hole(one.depth_um, one.wear_um)], away_um, plane=False)[0]
        for one in recipes_of(profile)
    )
    return [[cut for cuts in of_regimes for cut in cuts]]


def _measuring_s(profile: Profile, setup: Setup, visits: Sequence[_Visit], *, plane: bool) -> float:
    """Return the time of touches, approaches and stage moves of all holes, s."""
    stands = [one.stand for one in visits]
    total_s = touch_time_s(profile, setup) + (_plane_time_s(profile, setup, stands) if plane else 0.0)
    has_bottom = profile.target.kind != "through"
    pad = here = pad_of(setup)
    known = [pad]
    for one in visits:
        stand, bottom_um = one.stand, profile.approach.offset_um + one.worn_um + one.done.feed_um
        pad_s = between_s(stand, pad, setup)
        if one.done.depth_um > 0.0:  # pad and bottom are touched again
            total_s += stop_time_s(profile, one.done.feed_um, one.worn_um, pad_s, bottom=has_bottom)
        elif not plane and has_bottom and is_tilt_limited(setup, stand, known):
            total_s += between_s(here, stand, setup) + face_time_s(profile, bottom_um)
            known.append(stand)
            here = stand
        for cut in one.cuts:
            total_s += between_s(here, stand, setup) + descent_time_s(profile, bottom_um)
            bottom_um, here = bottom_um + cut.feed_um, stand
            if cut.measured:
                wear_um, rim_um = one.worn_um + one.hole.wear_um, one.hole.completion_um
                total_s += stop_time_s(profile, cut.feed_um, wear_um, pad_s, bottom=has_bottom, rim_um=rim_um)
                here = pad
    return total_s


def _plane_time_s(profile: Profile, setup: Setup, stands: Sequence[Place]) -> float:
    """Return the time of touching three places of an array, as far apart as any two, before it is machined."""
    # The way between two places is a sum of absolute differences: the longest joins the ends of a diagonal.
    stage = setup.stage
    diagonals_s = [
        [
            (one.x_um + y * one.y_um) / stage.speed_um_s + turn * one.theta_deg / stage.rotary_deg_s
            for one in stands
        ]
        for y in (1.0, -1.0)
        for turn in (1.0, -1.0)
    ]
    move_s = move_time_s(0.0, setup) + max(max(along_s) - min(along_s) for along_s in diagonals_s)
    return PLANE_TOUCHES * (move_s + face_time_s(profile, profile.approach.offset_um))


def is_tilt_limited(setup: Setup, stand: Place, known: Sequence[Place]) -> bool:
    """Whether the face is touched at a place before its hole: it is too far from where the face is known."""
    away_um = min(math.hypot(stand.x_um - one.x_um, stand.y_um - one.y_um) for one in known)
    return 1e-3 * setup.surface.tilt_u_mrad * away_um > FACE_LIMIT_UM


def _after(cuts: Sequence[Cut], feed_um: float) -> list[Cut]:
    """Return the cuts that remain after a feed; always the last one, whose bottom is measured."""
    after = []
    for cut in cuts:
        remaining_um = max(0.0, cut.feed_um - feed_um)
        if remaining_um > 0.0 or cut is cuts[-1]:
            after.append(replace(cut, feed_um=remaining_um))
        feed_um = max(0.0, feed_um - cut.feed_um)
    return after


def hole_time_s(profile: Profile, one: Hole, reached_um: float = 0.0) -> float:
    """Return the machining time of one hole from a depth on, s; after a breakthrough the tool opens the exit."""
    if profile.regimes:
        return math.fsum(regime_time_s(recipe, reached_um) for recipe in recipes_of(profile))

    def time_to_s(depth_um: float) -> float:
        rate_um_s = feed_rate_um_s(profile, depth_um)
        return (depth_um + one.wear_um * (depth_um / one.depth_um)) / rate_um_s / machining_share(profile)

    feed_s = time_to_s(one.depth_um)
    if reached_um > 0.0:
        feed_s = max(0.0, feed_s - time_to_s(reached_um))
    return feed_s + one.completion_um / profile.servo.forward_um_s


def regime_time_s(recipe: Recipe, reached_um: float = 0.0) -> float:
    """Return the machining time of one regime from a depth of the hole on, s."""
    rate_um_s = feed_rate_um_s(recipe.profile, recipe.to_um) * machining_share(recipe.profile)
    remaining = min(1.0, max(0.0, (recipe.to_um - reached_um) / recipe.depth_um))
    return remaining * (recipe.depth_um + recipe.wear_um) / rate_um_s


def forecast(
    profile: Profile, setup: Setup, places: Sequence[Place] = (), reached: Reached | None = None
) -> Forecast:
    """Forecast a job from its recipe, the machine's settings and the places of its holes.

    Without places it is one hole beside the reference pad, or the channel of `[path]`. `reached` is the hole or
    channel that the job resumes: times, cuts, stops, pulses and `tool_wear_um` are of what remains.
    """
    reached, recipes = reached or Reached(), recipes_of(profile)
    if profile.path is not None:
        deepest, course = _channel_course(Channel(profile, profile.path), setup, reached.depth_um)
    else:
        deepest, course = _holes_course(profile, setup, places, reached)
    cycle, regimes = servo_swing(profile, setup), tuple[RegimeForecast, ...]()
    if profile.regimes:
        regimes = tuple(
            RegimeForecast(
                name=recipe.name,
                depth_um=recipe.to_um,
                machining_time_s=regime_time_s(recipe),
                wear_um=recipe.wear_um,
                ra_um=ra_of_regimes_um(recipes[: number + 1]),
            )
            for number, recipe in enumerate(recipes)
        )
        ra_um, whole_s = regimes[-1].ra_um, math.fsum(one.machining_time_s for one in regimes)
        pulses = math.fsum(
            one.machining_time_s * recipe.profile.pulse.frequency_hz
            for one, recipe in zip(regimes, recipes, strict=True)
        )
        frequency_hz = pulses / whole_s
        area_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
        removed_um3_s = deepest.depth_um * area_um2 / whole_s
    else:
        ra_um, frequency_hz = expected_ra_um(profile, deepest.depth_um), profile.pulse.frequency_hz
        removed_um3_s = removal_um3_s(profile, deepest.depth_um)
    return Forecast(
        **course,
        time_s=course["machining_time_s"] + course["measuring_time_s"],
        feed_rate_um_s=feed_rate_um_s(profile, deepest.depth_um),
        feed_um=deepest.feed_um,
        depth_um=deepest.depth_um,
        wear_um=deepest.wear_um,
        stroke_available_um=stroke_available_um(profile, setup),
        loop_delay_s=cycle.loop_delay_s,
        limit_cycle_um=cycle.half_amplitude_um,
        limit_cycle_period_s=cycle.period_s,
        spark_energy_uj=max(
            pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.burning_time_us)
            for pulse in (recipe.profile.pulse for recipe in recipes)
        ),
        mrr_mm3_min=mrr_mm3_min(removed_um3_s),
        jump_share=time_share_of_jumps(profile),
        pulses=round(course["machining_time_s"] * frequency_hz),
        side_gap_um=profile.work.side_gap_um,
        ra_um=ra_um,
        rz_um=roughness_rz_um(ra_um),
        regimes=regimes,
    )


@dataclass(frozen=True)
class Job:
    """A job to be checked. Its forecast needs nearly every value of the profile, so it is made on demand."""

    profile: Profile
    setup: Setup
    places: tuple[Place, ...] = ()

    @cached_property
    def forecast(self) -> Forecast:
        """What the job is expected to take."""
        return forecast(self.profile, self.setup, self.places)


def depth_and_wear_um(profile: Profile) -> tuple[float, float]:
    """Depth and tool wear of one hole or channel at its target, µm, at the expected ratio of wear."""
    one = hole(profile) if profile.path is None else Channel(profile, profile.path)
    return one.depth_um, one.wear_um


def stroke_um(profile: Profile) -> float:
    """Stroke that one hole or the channel needs, µm: offset, feed and a reserve."""
    feed_um = sum(depth_and_wear_um(profile)) if profile.path else hole(profile).feed_um
    return profile.approach.offset_um + feed_um + STROKE_RESERVE_UM


def stroke_available_um(profile: Profile, setup: Setup) -> float:
    """Stroke up to the voltage limit of the job, µm."""
    return setup.actuator.gain_um_per_v * profile.limits.stroke_v_max
