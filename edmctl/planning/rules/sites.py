"""Cross-field rules of where a job machines: the places of its holes, or its channel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from operator import le

from edmctl.failures import Code
from edmctl.planning.forecast import STROKE_RESERVE_UM, Job, stroke_available_um, working_order
from edmctl.planning.measuring import beside_pad_um, pad_of
from edmctl.planning.removal import hole
from edmctl.planning.rules.bound import Bound, Conflict
from edmctl.profile.findings import PAD_MARGIN_UM, WALL_UM, Finding, rounded_up
from edmctl.profile.model import PathTable
from edmctl.profile.places import Place
from edmctl.profile.setup import Limit, Setup
from edmctl.wording import coordinates

LEAST_TURN_DEG = 1.0  # places turned against each other by less are one place of the workpiece [assumed]
NEEDED = {
    "rectangle": ("width_um", "height_um"),
    "circle": ("radius_um",),
    "spiral": ("radius_um", "pitch_um", "turns"),
}
"""Keys of `[path]` by its kind; the others of these do not go with it."""
SIZES = ("width_um", "height_um", "radius_um", "pitch_um", "turns")
_STEPS_PER_TURN = 360
SITES_OR_PATH = Conflict(
    Code.SITES_OR_PATH, "path", lambda profile: bool(profile.sites) and profile.path is not None
).says(
    "the profile has both [[sites]] and [path], and a job makes either holes or a channel",
    "remove one of the two; to drop inherited places write sites = []",
)
CHANNEL_DEPTH = Conflict(
    Code.TARGET_KIND,
    "target.kind",
    lambda profile: profile.path is not None and profile.target.kind != "depth",
).says('a channel is cut to a depth, and target.kind is "{target.kind}"', 'use kind = "depth", with depth_um')
LAYER = Bound(
    Code.LAYER, "path.layer_um", le, "measure.expected_gap_um", when=lambda profile: profile.path is not None
).says(
    "a layer of {value:g} µm is thicker than the working gap, {limit:.1f} µm: moving sideways the tool runs into "
    "the step before it is eroded",
    "use at most {most} µm",
)


def names(job: Job) -> Iterator[Finding]:
    """Rule 27: every place has a name of its own."""
    first: dict[str, Place] = {}
    for place in job.places:
        other = first.setdefault(place.name, place)
        if other is not place:
            both = f"({other.x_um:g}, {other.y_um:g}) and ({place.x_um:g}, {place.y_um:g}) µm"
            message, hint = f"two places are called {place.name}: {both}", "give one of them another name"
            yield Finding(Code.SITES, ("sites", place.entry), message, hint, place.where)
            return


def depths_of_places(job: Job) -> Iterator[Finding]:
    """Rule 23: a place has a depth of its own only where depths are the target."""
    kind = job.profile.target.kind
    deep = next((place for place in job.places if not math.isnan(place.depth_um)), None)
    if deep is not None and kind != "depth":
        message = f'{deep.name} has depth_um {deep.depth_um:g}, but target.kind is "{kind}"'
        hint = 'remove it, or use target.kind = "depth"'
        yield Finding(Code.TARGET_KIND, ("sites", deep.entry), message, hint, deep.where)


def clear_of_each_other(job: Job) -> Iterator[Finding]:
    """Rule 28: a wall stands between holes, and between a hole and the reference pad."""
    diameter_um, gap_um = job.profile.tool.diameter_um, job.profile.work.side_gap_um
    apart_um = diameter_um + 2.0 * gap_um + WALL_UM
    if close := _closest(job.places, apart_um):
        a, b, found_um = close
        message = (
            f"{a.name} and {b.name} are {found_um:.0f} µm apart: hole {diameter_um:g} + 2 x side gap {gap_um:g} + "
            f"wall {WALL_UM:g} = {apart_um:g} µm"
        )
        hint = f"keep them {rounded_up(apart_um)} µm apart or more"
        yield Finding(Code.OVERLAP, ("sites", b.entry), message, hint, b.where)
    pad_um, pad = diameter_um + gap_um + PAD_MARGIN_UM, pad_of(job.setup)
    for place in job.places:
        found_um = math.hypot(place.x_um - pad.x_um, place.y_um - pad.y_um)
        if found_um < pad_um:
            message = f"{place.name} is {found_um:.0f} µm from the {_overlapped(job)}"
            hint = f"keep it {rounded_up(pad_um)} µm away or more"
            yield Finding(Code.OVERLAP, ("sites", place.entry), message, hint, place.where)
            return


def _overlapped(job: Job) -> str:
    pad = pad_of(job.setup)
    return f"reference pad at ({pad.x_um:g}, {pad.y_um:g}) µm and overlaps it or its rim"


def within_reach(job: Job) -> Iterator[Finding]:
    """Rule 40: the stages reach every place, and the workpiece is there."""
    half_um = job.profile.tool.diameter_um / 2.0 + job.profile.work.side_gap_um
    path, places, key = job.profile.path, job.places, ("path", "x_um")
    if path is not None:
        places = (Place("the channel", path.x_um, path.y_um),)
    elif not job.profile.sites:
        places = (Place("the hole beside the pad", *beside_pad_um(job.profile, job.setup)),)
        key = ("measure", "site_dx_um")
    for place in places:
        if found := unreachable(place.name, place.x_um, place.y_um, job.setup, half_um, path):
            is_listed = bool(job.profile.sites) and path is None
            blamed = ("sites", place.entry) if is_listed else key
            yield Finding(Code.OUT_OF_REACH, blamed, *found, place.where)
            return


def unreachable(
    name: str,
    x_um: float,
    y_um: float,
    setup: Setup,
    half_um: float,
    path: PathTable | None = None,
) -> tuple[str, str] | None:
    """Return why a place of that half width cannot be machined, and the remedy; None where it can.

    With `path` it is a channel around that place. Edges are stage coordinates, at every angle of the rotary table.
    """
    what, state = f"{name} at {coordinates(x_um, y_um)}", "move it, or state the"
    for limit in setup.stage_limits():
        if (beyond_um := limit.beyond_um(x_um, y_um, _half_um(path, limit))) > 0.0:
            hint = f"{state} travel of the stages in the setup (stage.x_min_um, x_max_um, ...)"
            return f"{what} is {beyond_um:.0f} µm beyond the travel of the stages, {limit.stated}", hint
    for edge in setup.workpiece_limits():
        if (beyond_um := edge.beyond_um(x_um, y_um, _half_um(path, edge) + half_um)) > 0.0:
            hint = f"{state} edges of the workpiece in the setup (surface.x_min_um, x_max_um, ...)"
            return f"{what} reaches {beyond_um:.0f} µm beyond the edge of the workpiece, {edge.stated}", hint
    return None


def _half_um(path: PathTable | None, limit: Limit) -> float:
    """Return the extent of a channel's axis from its centre towards a limit, µm."""
    if path is None:
        return 0.0
    width_um, height_um, radius_um, pitch_um, turns = _sizes(path)
    if path.kind == "rectangle":
        return (abs(limit.ux) * width_um + abs(limit.uy) * height_um) / 2.0
    return radius_um + pitch_um * turns


def array_wear(job: Job) -> Iterator[Finding]:
    """Rules 17 and 29: the tool lasts for all places; if not, the job stops and says what is done."""
    limit_um, worn_um = job.profile.tool.max_wear_um, 0.0
    ordered = working_order(job.profile, job.setup, job.places)
    for number, place in enumerate(ordered):
        worn_um += hole(job.profile, place.depth_um).wear_um
        if worn_um > limit_um:
            code = Code.ARRAY_WEAR if number else Code.TOOL_WEAR
            message = (
                f"the tool is worn by max_wear_um {limit_um:g} µm at hole {number + 1} of {len(ordered)}, "
                f"{place.name}: the job will stop there, with {number} done"
            )
            all_um = rounded_up(job.forecast.tool_wear_um)
            hint = f"permit {all_um} µm or more for all of them, or make several jobs"
            yield Finding(code, ("tool", "max_wear_um"), message, hint)
            return


def array_stroke(job: Job) -> Iterator[Finding]:
    """Rules 2 and 30: with the wear carried over, every place is within the stroke, for there is no coarse Z."""
    profile = job.profile
    available_um = stroke_available_um(profile, job.setup)
    ordered, worn_um = working_order(profile, job.setup, job.places), 0.0
    for number, place in enumerate(ordered):
        one = hole(profile, place.depth_um)
        needed_um = profile.approach.offset_um + worn_um + one.feed_um + STROKE_RESERVE_UM
        if needed_um > available_um:
            code, hint = Code.STROKE, "make it less deep, or raise limits.stroke_v_max"
            if number:
                code = Code.ARRAY_STROKE
                hint = f"{number} fit: make the others another job, with the tool set anew"
            message = (
                f"hole {number + 1} of {len(ordered)}, {place.name}, is out of reach: offset "
                f"{profile.approach.offset_um:g} + tool wear so far {worn_um:.0f} + feed {one.feed_um:.0f} + "
                f"reserve {STROKE_RESERVE_UM:g} = {needed_um:.0f} µm of stroke, but "
                f"{profile.limits.stroke_v_max:g} V give {available_um:.0f} µm"
            )
            yield Finding(code, ("sites", place.entry), message, hint, place.where)
            return
        worn_um += one.wear_um


def _closest(places: tuple[Place, ...], apart_um: float) -> tuple[Place, Place, float] | None:
    """Return the two closest places that are closer than this and have the same angle."""
    found: tuple[Place, Place, float] | None = None
    swept = sorted(places, key=lambda place: place.x_um)
    for index, a in enumerate(swept):
        for b in swept[index + 1 :]:
            if b.x_um - a.x_um >= apart_um:
                break
            distance_um = math.hypot(b.x_um - a.x_um, b.y_um - a.y_um)
            turned = abs(math.remainder(b.theta_deg - a.theta_deg, 360.0)) >= LEAST_TURN_DEG
            if distance_um < (found[2] if found else apart_um) and not turned:
                found = (a, b, distance_um)
    return found


def _sizes(path: PathTable) -> list[float]:
    return [getattr(path, key) or 0.0 for key in SIZES]


def path_keys(job: Job) -> Iterator[Finding]:
    """Rule 25: a path has the sizes of its kind, and no others."""
    path = job.profile.path
    if path is None:
        return
    for key in SIZES:
        given, needed = getattr(path, key) is not None, key in NEEDED[path.kind]
        if needed and not given:
            message, hint = f"a {path.kind} needs path.{key}", f"add {key} to [path]"
            yield Finding(Code.PATH_KEYS, ("path",), message, hint)
        elif given and not needed:
            message = f"path.{key} does not go with a {path.kind}"
            hint = f"remove it; a {path.kind} has {' and '.join(NEEDED[path.kind])}"
            yield Finding(Code.PATH_KEYS, ("path", key), message, hint)


def walls(job: Job) -> Iterator[Finding]:
    """Rule 28: the walls of a channel stand, and it keeps clear of the reference pad."""
    path = job.profile.path
    if path is None:
        return
    diameter_um, gap_um = job.profile.tool.diameter_um, job.profile.work.side_gap_um
    least_um = diameter_um + 2.0 * gap_um + WALL_UM
    for key, across_um in _widths_um(path).items():
        if across_um < least_um:
            message = (
                f"the channel runs into itself: its sides are {across_um:g} µm apart by path.{key}, and tool "
                f"{diameter_um:g} + 2 x side gap {gap_um:g} + wall {WALL_UM:g} = {least_um:g} µm"
            )
            hint = f"make them {rounded_up(least_um)} µm apart or more, or use a thinner tool"
            yield Finding(Code.OVERLAP, ("path", key), message, hint)
    clear_um, pad = diameter_um + gap_um + PAD_MARGIN_UM, pad_of(job.setup)
    found_um = _distance_um(path, pad.x_um, pad.y_um)
    if found_um < clear_um:
        message = f"the channel passes {found_um:.0f} µm from the {_overlapped(job)}"
        hint = f"keep {rounded_up(clear_um)} µm away or more"
        yield Finding(Code.OVERLAP, ("path", "x_um"), message, hint)


def _widths_um(path: PathTable) -> dict[str, float]:
    """Return the least distances between a channel's sides, axis to axis, by the key that sets them."""
    width_um, height_um, radius_um, pitch_um, turns = _sizes(path)
    if path.kind == "rectangle":
        return {"width_um": width_um, "height_um": height_um}
    if path.kind == "circle":
        return {"radius_um": 2.0 * radius_um}
    across = {"radius_um": 2.0 * radius_um + pitch_um / 2.0} if turns >= 0.5 else {}
    return across | ({"pitch_um": pitch_um} if turns > 1.0 else {})


def _distance_um(path: PathTable, x_um: float, y_um: float) -> float:
    x_um, y_um = x_um - path.x_um, y_um - path.y_um
    width_um, height_um, radius_um, pitch_um, turns = _sizes(path)
    if path.kind == "circle":
        return abs(math.hypot(x_um, y_um) - radius_um)
    if path.kind == "rectangle":
        beyond_x, beyond_y = abs(x_um) - width_um / 2.0, abs(y_um) - height_um / 2.0
        if beyond_x <= 0.0 and beyond_y <= 0.0:
            return min(-beyond_x, -beyond_y)
        return math.hypot(max(beyond_x, 0.0), max(beyond_y, 0.0))

    def away_um(turned: float) -> float:
        here_um, angle = radius_um + pitch_um * turned, 2.0 * math.pi * turned
        return math.hypot(here_um * math.cos(angle) - x_um, here_um * math.sin(angle) - y_um)

    steps = math.ceil(_STEPS_PER_TURN * turns)
    return min(away_um(turns * step / steps) for step in range(steps + 1))
