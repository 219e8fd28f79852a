"""How much a job removes: depth, tool wear and feed of each hole, length and volume of a channel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.process.erosion import hole_area_um2

if TYPE_CHECKING:
    from edmctl.profile.model import Profile
    from edmctl.profile.sites import PathTable


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
    """A value that the kind of a path needs: the rules refuse a path without it."""
    return math.nan if value_um is None else value_um
