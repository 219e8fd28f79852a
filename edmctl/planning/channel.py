"""A channel: how much it removes, its passes, the measuring stops between them, and the time of both."""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass
from edmctl.planning.measuring import (
    Stand,
    between_s,
    descent_time_s,
    face_time_s,
    pad_of,
    pad_time_s,
    reading_time_s,
    stop_time_s,
    touch_time_s,
)
from edmctl.planning.removal import hole, removal_um3_s, time_share_of_jumps
from edmctl.process.discharge import hole_area_um2
from edmctl.process.touches import TOUCH_U_UM
from edmctl.profile.model import PathTable, Profile
from edmctl.profile.setup import Setup

EVEN_OUT_PASSES = 2  # before a measuring stop the floor is evened out by so many passes that do not go deeper
LAST_PASS_SHARE = 1.05  # passes over those that the sparks need, because a layer ends with a whole pass
LAYERS_BEFORE_FIRST_STOP = 2
"""Then wear and gap are measured for the first time: early, because both were only assumed."""
PLACES, PLACES_AT_THE_END = 4, 6  # the floor is touched at so many places
FACE_TOUCHES = 3
LEARNED_U_REL = 0.03  # relative uncertainty of the wear per energy after the first stop has measured it


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel: length of its way, how wide and deep it becomes, and what it takes off the tool."""

    length_um: float
    width_um: float
    depth_um: float
    volume_um3: float
    wear_um: float
    layers: int

    @property
    def wear_ratio(self) -> float:
        """Wear length per depth of the channel."""
        return self.wear_um / self.depth_um


def channel(profile: Profile, path: PathTable) -> Channel:
    """The channel of a profile; it is a side gap wider than the tool on both sides.

    The tool loses the same volume per volume removed as in a hole, so its wear length is that of a hole as deep as
    the channel's volume over the section of a hole. An open way has half a hole at either end.
    """
    diameter_um, depth_um = profile.tool.diameter_um, hole(profile).depth_um
    width_um = diameter_um + 2.0 * profile.work.side_gap_um
    section_um2 = hole_area_um2(diameter_um, profile.work.side_gap_um)
    length_um = path_length_um(path)
    ends_um2 = section_um2 if path.kind == "spiral" else 0.0
    volume_um3 = (width_um * length_um + ends_um2) * depth_um
    return Channel(
        length_um=length_um,
        width_um=width_um,
        depth_um=depth_um,
        volume_um3=volume_um3,
        wear_um=profile.wear.expected_ratio * volume_um3 / section_um2,
        layers=math.ceil(depth_um / path.layer_um - 1e-9),
    )


def path_length_um(path: PathTable) -> float:
    """Length of a channel's way, µm."""
    if path.kind == "rectangle":
        return 2.0 * (_given(path.width_um) + _given(path.height_um))
    if path.kind == "circle":
        return 2.0 * math.pi * _given(path.radius_um)
    inner_um, pitch_um, turns = _given(path.radius_um), _given(path.pitch_um), _given(path.turns)
    growth_um = pitch_um / (2.0 * math.pi)
    return _archimedes(inner_um + pitch_um * turns, growth_um) - _archimedes(inner_um, growth_um)


def _archimedes(radius_um: float, growth_um: float) -> float:
    """Length of a spiral of Archimedes from its centre to a radius, growing by this per radian."""
    across_um = math.hypot(radius_um, growth_um)
    return (radius_um * across_um / growth_um + growth_um * math.asinh(radius_um / growth_um)) / 2.0


def _given(value_um: float | None) -> float:
    """Return a value that the kind of a path needs; the rules refuse a path without it."""
    return math.nan if value_um is None else value_um


def channel_passes(profile: Profile, setup: Setup, path: PathTable, done: int = 0) -> int:
    """Return the passes of the layers after the first `done`, and those that even the floor out before a stop."""
    whole = channel(profile, path)
    evening = EVEN_OUT_PASSES * sum(layer > done for layer in stops_after(profile, setup, path))
    return math.ceil((whole.layers - done) * passes_per_layer(profile, path, whole)) + evening


def channel_measuring_s(profile: Profile, setup: Setup, path: PathTable, done: int = 0) -> float:
    """Return the time of a channel's job besides machining after the first `done` layers, s.

    That is the surface before, and pad, floor and pad again at every measurement cycle.
    """
    whole = channel(profile, path)
    offset_um = profile.approach.offset_um
    centre, across = Stand(path.x_um, path.y_um), Stand(path.x_um + _across_um(path), path.y_um)
    pad_s, across_s = between_s(pad_of(setup), centre, setup), between_s(centre, across, setup)
    total_s = touch_time_s(profile, setup) + pad_s
    total_s += FACE_TOUCHES * (across_s + face_time_s(profile, offset_um))
    for layers in stops_after(profile, setup, path):
        if layers <= done:
            continue
        share = layers / whole.layers
        place_um = offset_um + share * (whole.depth_um + whole.wear_um)
        places = PLACES_AT_THE_END if layers == whole.layers else PLACES
        total_s += 2.0 * pad_s + pad_time_s(profile) + descent_time_s(profile, place_um)
        total_s += places * (across_s + reading_time_s(profile, place_um))
        total_s += stop_time_s(profile, 0.0, share * whole.wear_um, pad_s, bottom=False)
    return total_s


def passes_per_layer(profile: Profile, path: PathTable, whole: Channel) -> float:
    """How often the tool passes on average until the sparks have taken a layer away, at least once."""
    return max(1.0, _sparks_of_layer_s(profile, whole) * path.speed_um_s / whole.length_um)


def waiting_speed_um_s(profile: Profile, path: PathTable) -> float:
    """The speed of a scan whose single pass just takes a layer away, µm/s: a slower one only takes longer."""
    whole = channel(profile, path)
    return whole.length_um / _sparks_of_layer_s(profile, whole)


def _sparks_of_layer_s(profile: Profile, whole: Channel) -> float:
    return LAST_PASS_SHARE * whole.volume_um3 / whole.layers / removal_um3_s(profile, whole.depth_um)


def pass_time_s(profile: Profile, path: PathTable, whole: Channel) -> float:
    """Time of one pass, s; the stages stand still during a jump."""
    return whole.length_um / path.speed_um_s / (1.0 - time_share_of_jumps(profile))


def stops_after(profile: Profile, setup: Setup, path: PathTable) -> list[int]:
    """The layers after which the channel is measured, counted from 1.

    Early, because wear and gap are only assumed; after the last; and where wear and drift have left the tool's face
    unknown by half the tolerance, or by a quarter before the last layer, which is to end at the target.
    """
    whole, target = channel(profile, path), profile.target
    tolerance_um = target.tolerance_um if target.kind == "depth" else math.inf
    layer_s = passes_per_layer(profile, path, whole) * pass_time_s(profile, path, whole)
    u_rel = math.hypot(profile.wear.ratio_u_rel, profile.work.removal_u_rel)
    found: list[int] = []
    for layers in range(1, whole.layers + 1):
        since = layers - 1 - (found[-1] if found else 0)
        worn_um, drift_um = (
            since * whole.wear_um / whole.layers,
            setup.sensor.drift_um_per_s * since * layer_s,
        )
        u_um = math.hypot(TOUCH_U_UM, u_rel * worn_um, drift_um)
        early = not found and layers >= LAYERS_BEFORE_FIRST_STOP
        unknown_um = tolerance_um / (4.0 if layers == whole.layers - 1 else 2.0)
        if early or layers == whole.layers or u_um > unknown_um:
            found.append(layers)
            u_rel = LEARNED_U_REL
    return found


def _across_um(path: PathTable) -> float:
    """Way of the stages from place to place on the channel, about, µm."""
    if path.kind == "rectangle":
        return ((path.width_um or 0.0) + (path.height_um or 0.0)) / 2.0
    return (path.radius_um or 0.0) + (path.pitch_um or 0.0) * (path.turns or 0.0) / 2.0
