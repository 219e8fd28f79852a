"""A channel: how much it removes, its passes, the measuring stops between them, and the time of both."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.planning.measuring import (
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
from edmctl.process.erosion import hole_area_um2
from edmctl.process.touches import TOUCH_U_UM
from edmctl.profile.model import PathTable, Profile
from edmctl.profile.places import Place
from edmctl.profile.setup import Setup

if TYPE_CHECKING:
    from edmctl.process.channel import Way  # a dry run loads no NumPy

EVEN_OUT_PASSES = 2  # before a measuring stop the floor is evened out by so many passes that do not go deeper
LAST_PASS_SHARE = 1.05  # passes over those that the sparks need, because a layer ends with a whole pass
LAYERS_BEFORE_FIRST_STOP = 2
"""Then wear and gap are measured for the first time: early, because both were only assumed."""
PLACES, PLACES_AT_THE_END = 4, 6  # the floor is touched at so many places
FACE_TOUCHES = 3
LEARNED_U_REL = 0.03  # relative uncertainty of the wear per energy after the first stop has measured it


class Channel:
    """The channel of a profile; the tool wears as much per removed volume as in a hole.

    passes_per_layer : mean number of passes until the sparks have removed a layer, at least one
    waiting_speed_um_s : speed at which a single pass just removes a layer; a slower one only takes longer
    pass_time_s : time of one pass; the stages stop during a jump
    """

    def __init__(self, profile: Profile, path: PathTable) -> None:
        self.profile, self.path = profile, path
        self.length_um = _length_um(path)
        self.depth_um = hole(profile).depth_um
        diameter_um, gap_um = profile.tool.diameter_um, profile.work.side_gap_um
        section_um2 = hole_area_um2(diameter_um, gap_um)
        ends_um2 = section_um2 if path.kind == "spiral" else 0.0  # half a hole at either end of an open way
        self.volume_um3 = ((diameter_um + 2.0 * gap_um) * self.length_um + ends_um2) * self.depth_um
        self.wear_um = profile.wear.expected_ratio * self.volume_um3 / section_um2
        self.layers = math.ceil(self.depth_um / path.layer_um - 1e-9)
        layer_s = LAST_PASS_SHARE * self.volume_um3 / self.layers / removal_um3_s(profile, self.depth_um)
        self.passes_per_layer = max(1.0, layer_s * path.speed_um_s / self.length_um)
        self.waiting_speed_um_s = self.length_um / layer_s
        self.pass_time_s = self.length_um / path.speed_um_s / (1.0 - time_share_of_jumps(profile))

    def passes(self, setup: Setup, done: int = 0) -> int:
        """Return the passes after the first `done` layers, with those that even the floor out before a stop."""
        evening = EVEN_OUT_PASSES * sum(layer > done for layer in self.stops_after(setup))
        return math.ceil((self.layers - done) * self.passes_per_layer) + evening

    def stops_after(self, setup: Setup) -> list[int]:
        """Return the layers, counted from 1, after which the channel is measured.

        Early, because wear and gap are only assumed; after the last; and where wear and drift make the position of
        the tool's face uncertain by half the tolerance, or by a quarter before the last layer.
        """
        profile, target = self.profile, self.profile.target
        tolerance_um = target.tolerance_um if target.kind == "depth" else math.inf
        layer_s = self.passes_per_layer * self.pass_time_s
        u_rel = math.hypot(profile.wear.ratio_u_rel, profile.work.removal_u_rel)
        found: list[int] = []
        for layers in range(1, self.layers + 1):
            since = layers - 1 - (found[-1] if found else 0)
            worn_um = since * self.wear_um / self.layers
            drift_um = setup.sensor.drift_um_per_s * since * layer_s
            u_um = math.hypot(TOUCH_U_UM, u_rel * worn_um, drift_um)
            early = not found and layers >= LAYERS_BEFORE_FIRST_STOP
            unknown_um = tolerance_um / (4.0 if layers == self.layers - 1 else 2.0)
            if early or layers == self.layers or u_um > unknown_um:
                found.append(layers)
                u_rel = LEARNED_U_REL
        return found

    def measuring_s(self, setup: Setup, done: int = 0) -> float:
        """Return the time of the job besides machining after the first `done` layers: surface, pad and floor, s."""
        profile, path, offset_um = self.profile, self.path, self.profile.approach.offset_um
        across_um = (path.radius_um or 0.0) + (path.pitch_um or 0.0) * (path.turns or 0.0) / 2.0
        if path.kind == "rectangle":
            across_um = ((path.width_um or 0.0) + (path.height_um or 0.0)) / 2.0
        centre = Place("centre", path.x_um, path.y_um)
        across = Place("across", path.x_um + across_um, path.y_um)  # about the mean way from place to place
        pad_s, across_s = between_s(pad_of(setup), centre, setup), between_s(centre, across, setup)
        total_s = touch_time_s(profile, setup) + pad_s
        total_s += FACE_TOUCHES * (across_s + face_time_s(profile, offset_um))
        for layers in self.stops_after(setup):
            if layers <= done:
                continue
            share = layers / self.layers
            place_um = offset_um + share * (self.depth_um + self.wear_um)
            places = PLACES_AT_THE_END if layers == self.layers else PLACES
            total_s += 2.0 * pad_s + pad_time_s(profile) + descent_time_s(profile, place_um)
            total_s += places * (across_s + reading_time_s(profile, place_um))
            total_s += stop_time_s(profile, 0.0, share * self.wear_um, pad_s, bottom=False)
        return total_s


def _length_um(path: PathTable) -> float:
    """Return the length of the way; the rules refuse a path without the sizes of its kind."""
    inner_um, pitch_um = path.radius_um or 0.0, path.pitch_um or 0.0
    if path.kind == "rectangle":
        return 2.0 * ((path.width_um or 0.0) + (path.height_um or 0.0))
    if path.kind == "circle":
        return 2.0 * math.pi * inner_um
    growth_um = pitch_um / (2.0 * math.pi)
    return _archimedes(inner_um + pitch_um * (path.turns or 0.0), growth_um) - _archimedes(
        inner_um, growth_um
    )


def _archimedes(radius_um: float, growth_um: float) -> float:
    """Return the length of a spiral of Archimedes from its centre to a radius, growing by this per radian."""
    across_um = math.hypot(radius_um, growth_um)
    return (radius_um * across_um / growth_um + growth_um * math.asinh(radius_um / growth_um)) / 2.0


PIECE_UM = 25.0
"""Longest line sent to the stages: the height of its end is planned anew for each."""


def way_of_path(path: PathTable) -> Way:
    """Way of the tool's axis of a `[path]` table, whose sizes the rules have found complete."""
    from edmctl.process import channel as ways

    if path.kind == "rectangle":
        points = ways.rectangle(path.x_um, path.y_um, path.width_um or 0.0, path.height_um or 0.0)
    elif path.kind == "circle":
        points = ways.circle(path.x_um, path.y_um, path.radius_um or 0.0)
    else:
        inner_um, pitch_um = path.radius_um or 0.0, path.pitch_um or 0.0
        points = ways.spiral(path.x_um, path.y_um, inner_um, pitch_um, path.turns or 0.0)
    return ways.way_of(points, PIECE_UM)


def is_on_way(way: Way, here: tuple[float, float], within_um: float) -> bool:
    """Return whether a place of the stages is on the way, as exactly as its pieces tell."""
    nearest_um = min(math.dist(here, (float(x_um), float(y_um))) for x_um, y_um in way.points)
    return nearest_um <= 0.5 * PIECE_UM + within_um
