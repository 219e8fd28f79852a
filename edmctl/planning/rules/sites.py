"""Cross-field rules of the target, and of where a job machines: the places of its holes, or its channel."""

from __future__ import annotations

import math
from operator import ge, gt, le

from edmctl.failures import Code
from edmctl.planning.channel import Channel
from edmctl.planning.forecast import Job, depth_and_wear_um, working_order
from edmctl.planning.measuring import beside_pad_um, pad_of
from edmctl.planning.removal import PAD_MARGIN_UM, WALL_UM, hole
from edmctl.planning.rules.bound import Bound, Finding, Findings, rounded_up
from edmctl.profile.model import PathTable
from edmctl.profile.places import Place
from edmctl.profile.setup import Limit, Setup
from edmctl.wording import coordinates

SPARE = 1.25
"""A tolerance has to be wider than the forecast of the interval by this: touches scatter from job to job."""
LEAST_SHEET_UM = 1.0  # the thinnest foils on sale are some µm thick

BOUNDS = (
    Bound(
        Code.TOOL_WEAR,
        "tool.max_wear_um",
        ge,
        lambda job: depth_and_wear_um(job.profile)[1],
        when=lambda profile: not profile.sites,
    ).says(
        "the job wears {limit:.0f} µm off the tool, more than max_wear_um {value:g} µm",
        "permit {least} µm or more, or use a tool that wears less",
    ),
    Bound(
        Code.BLIND_DEPTH,
        "work.thickness_um",
        gt,
        lambda job: max([depth_and_wear_um(job.profile)[0], *_depths_um(job)]),
        when=lambda profile: profile.work.kind == "blind" and profile.target.kind != "through",
    ).says(
        "a blind hole of {limit:.0f} µm does not end inside a sheet of {value:g} µm",
        'use a thicker sheet, a smaller target, or kind = "through"',
    ),
)


def _depths_um(job: Job) -> list[float]:
    """Return the depths that places state themselves."""
    return [place.depth_um for place in job.places if math.isfinite(place.depth_um)]


def kinds(job: Job) -> Findings:
    """Rules 14 and 23: the kinds of target and workpiece, and keys that depend on them, go together."""
    target, work = job.profile.target, job.profile.work
    if target.kind == "feed" and isinstance(job.profile.wear.remeasure, int):
        message = (
            f"a feed target of {target.feed_um:g} µm is one cut: it cannot be measured "
            f"{job.profile.wear.remeasure} times on the way"
        )
        hint = 'use remeasure = "auto" or "never", or a depth target'
        yield Finding(Code.FEED_REMEASURE, "wear.remeasure", message, hint)
    if target.kind == "through" and work.kind != "through":
        message = f'the target is through {work.thickness_um:g} µm of sheet, but work.kind is "{work.kind}"'
        hint = 'set work.kind = "through", and see that nothing under the sheet is in the way'
        yield Finding(Code.TARGET_KIND, "target.kind", message, hint)
    if target.kind != "through" and work.kind == "through":
        length_um = target.depth_um if target.kind == "depth" else target.feed_um
        message = (
            f'work.kind is "through", but the target is a {target.kind} of {length_um:g} µm: the job ends there, '
            f"whether or not it is through the sheet of {work.thickness_um:g} µm"
        )
        hint = 'use target.kind = "through" to wait for the breakthrough'
        yield Finding(Code.NOT_THROUGH, "target.kind", message, hint)
    if job.profile.path is not None and target.kind != "depth":
        message = f'a channel is cut to a depth, and target.kind is "{target.kind}"'
        yield Finding(Code.TARGET_KIND, "target.kind", message, 'use kind = "depth", with depth_um')
    deep = next((place for place in job.places if not math.isnan(place.depth_um)), None)
    if deep is not None and target.kind != "depth":
        message = f'{deep.name} has depth_um {deep.depth_um:g}, but target.kind is "{target.kind}"'
        hint = 'remove it, or use target.kind = "depth"'
        yield Finding(Code.TARGET_KIND, ("sites", deep.entry), message, hint, deep.where)


def tolerance(job: Job) -> Findings:
    """Rules 11 and 32: the tolerance exceeds the scatter of touches and the uncertainty of the depth."""
    target, measure, u95_um = job.profile.target, job.profile.measure, job.forecast.depth_u95_um
    if target.kind != "depth":
        return
    least_um = 2.0 * measure.max_sd_um / math.sqrt(measure.touches)
    if target.tolerance_um < least_um:
        message = (
            f"tolerance {target.tolerance_um:g} µm is below what {measure.touches} touches of up to "
            f"{measure.max_sd_um:g} µm scatter can resolve, {least_um:.2f} µm"
        )
        hint = f"use at least {rounded_up(max(least_um, SPARE * u95_um))} µm"
        yield Finding(Code.TOLERANCE, "target.tolerance_um", message, hint)
    elif target.tolerance_um < u95_um:
        why = "" if job.setup.sensor.fitted else ": without a displacement sensor the gain is known to 2.5 %"
        message = (
            f"the depth may remain unverified: it will be known to about ± {u95_um:.2f} µm, and the "
            f"tolerance is {target.tolerance_um:g} µm; the job ends with exit code 7 then"
        )
        hint = f"permit {rounded_up(SPARE * u95_um)} µm or more{why}"
        yield Finding(Code.NOT_SHOWN, "target.tolerance_um", message, hint)


def depth_beyond_tolerance(job: Job) -> Findings:
    """Rule 33: a depth is more than its tolerance; millimetres given for micrometres are not."""
    target, sheet_um = job.profile.target, job.profile.work.thickness_um
    in_mm = "lengths are in µm, {0:g} mm would be {1:g}"
    if target.kind == "through" and sheet_um < LEAST_SHEET_UM:
        message = f"a sheet of {sheet_um:g} µm is thinner than a foil of {LEAST_SHEET_UM:g} µm"
        hint = in_mm.format(sheet_um, 1000.0 * sheet_um)
        yield Finding(Code.LESS_THAN_TOLERANCE, "work.thickness_um", message, hint)
    if target.kind == "depth":
        own_um = _depths_um(job)
        depth_um = min(own_um if len(own_um) == len(job.places) > 0 else [target.depth_um, *own_um])
        if depth_um <= target.tolerance_um:
            message = (
                f"a depth of {depth_um:g} µm is no more than its tolerance, {target.tolerance_um:g} µm: an "
                "unmachined surface would already satisfy this target"
            )
            hint = f"{in_mm.format(depth_um, 1000.0 * depth_um)}; or set a smaller tolerance"
            yield Finding(Code.LESS_THAN_TOLERANCE, "target.depth_um", message, hint)


def time_limit(job: Job) -> Findings:
    """Rule 20: the job can end within its time limit."""
    limit_s, time_s, path = job.profile.limits.max_time_s, job.forecast.time_s, job.profile.path
    if limit_s >= time_s:
        return
    hint = f"permit {3.0 * time_s:.0f} s, three times the forecast"
    if path is not None and path.speed_um_s < (least_um_s := Channel(job.profile, path).waiting_speed_um_s):
        hint = (
            f"raise path.speed_um_s from {path.speed_um_s:g} to {rounded_up(least_um_s)} µm/s or more, where a "
            f"pass takes no longer than its sparks; or {hint}"
        )
    message = f"the job takes about {time_s:.0f} s, more than max_time_s {limit_s:g} s"
    yield Finding(Code.TIME_LIMIT, "limits.max_time_s", message, hint)


LEAST_TURN_DEG = 1.0  # places turned against each other by less are one place of the workpiece [assumed]
NEEDED = {
    "rectangle": ("width_um", "height_um"),
    "circle": ("radius_um",),
    "spiral": ("radius_um", "pitch_um", "turns"),
}
"""Keys of `[path]` by its kind; the others of these do not go with it."""
SIZES = ("width_um", "height_um", "radius_um", "pitch_um", "turns")
_STEPS_PER_TURN = 360
LAYER = Bound(
    Code.LAYER, "path.layer_um", le, "measure.expected_gap_um", when=lambda profile: profile.path is not None
).says(
    "a layer of {value:g} µm is thicker than the working gap, {limit:.1f} µm: moving sideways the tool runs into "
    "the step before it is eroded",
    "use at most {most} µm",
)


def path_keys(job: Job) -> Findings:
    """Rules 25 and 26: a path has the sizes of its kind, no others, and no places beside it."""
    path = job.profile.path
    if path is None:
        return
    if job.profile.sites:
        message = "the profile has both [[sites]] and [path], and a job makes either holes or a channel"
        hint = "remove one of the two; to drop inherited places write sites = []"
        yield Finding(Code.SITES_OR_PATH, "path", message, hint)
    for key in SIZES:
        is_given, is_needed = getattr(path, key) is not None, key in NEEDED[path.kind]
        if is_needed and not is_given:
            yield Finding(Code.PATH_KEYS, "path", f"a {path.kind} needs path.{key}", f"add {key} to [path]")
        elif is_given and not is_needed:
            message = f"path.{key} does not go with a {path.kind}"
            hint = f"remove it; a {path.kind} has {' and '.join(NEEDED[path.kind])}"
            yield Finding(Code.PATH_KEYS, f"path.{key}", message, hint)


def names(job: Job) -> Findings:
    """Rule 27: every place has a name of its own."""
    first: dict[str, Place] = {}
    for place in job.places:
        other = first.setdefault(place.name, place)
        if other is not place:
            both = f"({other.x_um:g}, {other.y_um:g}) and ({place.x_um:g}, {place.y_um:g}) µm"
            message, hint = f"two places are called {place.name}: {both}", "give one of them another name"
            yield Finding(Code.SITES, ("sites", place.entry), message, hint, place.where)
            return


def clear_of_each_other(job: Job) -> Findings:
    """Rule 28: a wall remains between holes or sides of a channel, and a margin to the reference pad."""
    diameter_um, gap_um, path = job.profile.tool.diameter_um, job.profile.work.side_gap_um, job.profile.path
    apart_um, clear_um = diameter_um + 2.0 * gap_um + WALL_UM, diameter_um + gap_um + PAD_MARGIN_UM
    sum_um = f"tool {diameter_um:g} + 2 x side gap {gap_um:g} + wall {WALL_UM:g} = {apart_um:g} µm"
    pad = pad_of(job.setup)
    at_pad = f"the reference pad at ({pad.x_um:g}, {pad.y_um:g}) µm and overlaps it or its rim"
    hint, away = (
        f"keep {rounded_up(apart_um)} µm apart or more",
        f"keep {rounded_up(clear_um)} µm away or more",
    )
    if path is not None:
        for key, across_um in _widths_um(path).items():
            if across_um < apart_um:
                message = f"the sides of the channel are {across_um:g} µm apart by path.{key}: {sum_um}"
                yield Finding(Code.OVERLAP, f"path.{key}", message, hint)
        away_um = _distance_um(path, pad.x_um, pad.y_um)
        if away_um < clear_um:
            message = f"the channel passes {away_um:.0f} µm from {at_pad}"
            yield Finding(Code.OVERLAP, "path.x_um", message, away)
    if close := _closest(job.places, apart_um):
        a, b, distance_um = close
        message = f"{a.name} and {b.name} are {distance_um:.0f} µm apart: {sum_um}"
        yield Finding(Code.OVERLAP, ("sites", b.entry), message, hint, b.where)
    for place in job.places:
        away_um = math.hypot(place.x_um - pad.x_um, place.y_um - pad.y_um)
        if away_um < clear_um:
            message = f"{place.name} is {away_um:.0f} µm from {at_pad}"
            yield Finding(Code.OVERLAP, ("sites", place.entry), message, away, place.where)
            return


def within_reach(job: Job) -> Findings:
    """Rule 40: the stages reach every place, and the workpiece is there."""
    half_um = job.profile.tool.diameter_um / 2.0 + job.profile.work.side_gap_um
    path, places = job.profile.path, job.places
    if path is not None:
        places = (Place("the channel", path.x_um, path.y_um),)
    elif not job.profile.sites:
        places = (Place("the hole beside the pad", *beside_pad_um(job.profile, job.setup)),)
    for place in places:
        if problem := unreachable(place.name, place.x_um, place.y_um, job.setup, half_um, path):
            alone = "path.x_um" if path is not None else "measure.site_dx_um"
            key = ("sites", place.entry) if places is job.places else alone
            yield Finding(Code.OUT_OF_REACH, key, *problem, place.where)
            return


def unreachable(
    name: str, x_um: float, y_um: float, setup: Setup, half_um: float, path: PathTable | None = None
) -> tuple[str, str] | None:
    """Return why a place of that half width cannot be machined, and the remedy; None where it can.

    With `path` it is a channel around that place. Edges are stage coordinates, at every angle of the rotary table.
    """
    for table, what, limits, width_um in (
        ("stage", "the travel of the stages", setup.stage_limits(), 0.0),
        ("surface", "the edge of the workpiece", setup.workpiece_limits(), half_um),
    ):
        for limit in limits:
            beyond_um = limit.beyond_um(x_um, y_um, _half_um(path, limit) + width_um)
            if beyond_um > 0.0:
                place = f"{name} at {coordinates(x_um, y_um)} reaches {beyond_um:.0f} µm beyond {what}"
                hint = f"move it, or correct {what} in the setup ({table}.x_min_um, x_max_um, ...)"
                return f"{place}, {limit.stated}", hint
    return None


def _half_um(path: PathTable | None, limit: Limit) -> float:
    """Return the extent of a channel's axis from its centre towards a limit, µm."""
    if path is None:
        return 0.0
    width_um, height_um, radius_um, pitch_um, turns = _sizes(path)
    if path.kind == "rectangle":
        return (abs(limit.ux) * width_um + abs(limit.uy) * height_um) / 2.0
    return radius_um + pitch_um * turns


def array_wear(job: Job) -> Findings:
    """Rules 17 and 29: the tool lasts for all places; if not, the job stops and reports what is done."""
    limit_um, worn_um = job.profile.tool.max_wear_um, 0.0
    ordered = working_order(job.profile, job.setup, job.places)
    for number, place in enumerate(ordered):
        worn_um += hole(job.profile, place.depth_um).wear_um
        if worn_um > limit_um:
            message = (
                f"the tool is worn by max_wear_um {limit_um:g} µm at hole {number + 1} of {len(ordered)}, "
                f"{place.name}: the job will stop there, with {number} done"
            )
            all_um = rounded_up(job.forecast.tool_wear_um)
            hint = f"permit {all_um} µm or more for all of them, or make several jobs"
            yield Finding(Code.ARRAY_WEAR if number else Code.TOOL_WEAR, "tool.max_wear_um", message, hint)
            return


def _closest(places: tuple[Place, ...], apart_um: float) -> tuple[Place, Place, float] | None:
    """Return the two closest places that are closer than this and have the same angle."""
    closest: tuple[Place, Place, float] | None = None
    swept = sorted(places, key=lambda place: place.x_um)
    for index, a in enumerate(swept):
        for b in swept[index + 1 :]:
            if b.x_um - a.x_um >= apart_um:
                break
            distance_um = math.hypot(b.x_um - a.x_um, b.y_um - a.y_um)
            turned = abs(math.remainder(b.theta_deg - a.theta_deg, 360.0)) >= LEAST_TURN_DEG
            if distance_um < (closest[2] if closest else apart_um) and not turned:
                closest = (a, b, distance_um)
    return closest


def _sizes(path: PathTable) -> list[float]:
    return [getattr(path, key) or 0.0 for key in SIZES]


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
    """Return the least distance of a place from the channel's axis."""
    x_um, y_um = x_um - path.x_um, y_um - path.y_um
    width_um, height_um, radius_um, pitch_um, turns = _sizes(path)
    if path.kind == "circle":
        return abs(math.hypot(x_um, y_um) - radius_um)
    if path.kind == "rectangle":
        beyond_x, beyond_y = abs(x_um) - width_um / 2.0, abs(y_um) - height_um / 2.0
        if beyond_x <= 0.0 and beyond_y <= 0.0:
            return min(-beyond_x, -beyond_y)
        return math.hypot(max(beyond_x, 0.0), max(beyond_y, 0.0))
    steps = math.ceil(_STEPS_PER_TURN * turns)
    points = (
        (radius_um + pitch_um * turns * step / steps, 2.0 * math.pi * turns * step / steps)
        for step in range(steps + 1)
    )
    return min(math.hypot(r * math.cos(angle) - x_um, r * math.sin(angle) - y_um) for r, angle in points)
