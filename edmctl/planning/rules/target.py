"""Cross-field rules of target, measurement and limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from operator import ge, gt

from edmctl.failures import Code
from edmctl.planning.channel import Channel
from edmctl.planning.forecast import Job, depth_and_wear_um
from edmctl.planning.rules.bound import Bound, Conflict
from edmctl.profile.findings import Finding, rounded_up
from edmctl.profile.model import Profile
from edmctl.profile.positions import KeyPath

SPARE = 1.25
"""A tolerance has to be wider than the forecast of the interval by this: touches scatter from job to job."""

LEAST_SHEET_UM = 1.0  # the thinnest foils on sale are some µm thick

FEED_WITHOUT_REMEASURING = Conflict(
    Code.FEED_REMEASURE,
    "wear.remeasure",
    lambda profile: profile.target.kind == "feed" and isinstance(profile.wear.remeasure, int),
).says(
    "a feed target of {target.feed_um:g} µm is one cut: it cannot be measured {wear.remeasure} times on the way",
    'use remeasure = "auto" or "never", or a depth target',
)
TOOL_WEAR = Bound(
    Code.TOOL_WEAR,
    "tool.max_wear_um",
    ge,
    lambda job: depth_and_wear_um(job.profile)[1],
    when=lambda profile: not profile.sites,
).says(
    "the job wears {limit:.0f} µm off the tool, more than max_wear_um {value:g} µm",
    "permit {least} µm or more, or use a tool that wears less",
)
"""Rule 17; of several places see `sites.array_wear`."""


def _ends_inside(kind: str) -> Callable[[Profile], bool]:
    return lambda profile: profile.work.kind == "through" and profile.target.kind == kind


THROUGH_TARGET = (
    Conflict(
        Code.TARGET_KIND,
        "target.kind",
        lambda profile: profile.target.kind == "through" and profile.work.kind != "through",
    ).says(
        'the target is a way through the sheet of {work.thickness_um:g} µm, but work.kind is "{work.kind}"',
        'set work.kind = "through", and see that nothing under the sheet is in the way',
    ),
    *(
        Conflict(Code.NOT_THROUGH, "target.kind", _ends_inside(kind)).says(
            f'work.kind is "through", but the target is a {kind} of {{target.{kind}_um:g}} µm: the job ends there, '
            "whether or not it is through the sheet of {work.thickness_um:g} µm",
            'use target.kind = "through" to wait for the breakthrough',
        )
        for kind in ("depth", "feed")
    ),
)
"""Rule 23: a way through is stated of the work and of the target."""


def _deepest_um(job: Job) -> float:
    depth_um, _ = depth_and_wear_um(job.profile)
    return max((place.depth_um for place in job.places if place.depth_um > depth_um), default=depth_um)


BLIND_DEPTH = Bound(
    Code.BLIND_DEPTH,
    "work.thickness_um",
    gt,
    _deepest_um,
    when=lambda profile: profile.work.kind == "blind" and profile.target.kind != "through",
).says(
    "a blind hole of {limit:.0f} µm does not end inside a sheet of {value:g} µm",
    'use a thicker sheet, a smaller target, or kind = "through"',
)


def _least_resolved_um(job: Job) -> float:
    """Return the least tolerance that touches of the permitted scatter resolve."""
    measure = job.profile.measure
    return 2.0 * measure.max_sd_um / math.sqrt(measure.touches)


def tolerance(job: Job) -> Iterator[Finding]:
    """Rule 11: the tolerance is wider than the scatter of the touches."""
    target, measure = job.profile.target, job.profile.measure
    if target.kind != "depth":
        return
    least_um = _least_resolved_um(job)
    if target.tolerance_um < least_um:
        message = (
            f"tolerance {target.tolerance_um:g} µm is below what {measure.touches} touches of up to "
            f"{measure.max_sd_um:g} µm scatter can resolve, {least_um:.2f} µm"
        )
        hint = f"use at least {rounded_up(max(least_um, SPARE * job.forecast.depth_u95_um))} µm"
        yield Finding(Code.TOLERANCE, ("target", "tolerance_um"), message, hint)


def depth_shown(job: Job) -> Iterator[Finding]:
    """Rule 32: the depth will be known as well as it is wanted; rule 11 speaks first."""
    target = job.profile.target
    if target.kind != "depth":
        return
    u95_um = job.forecast.depth_u95_um
    if _least_resolved_um(job) <= target.tolerance_um < u95_um:
        why = "" if job.setup.sensor.fitted else ": without a displacement sensor the gain is known to 2.5 %"
        message = (
            f"the depth may not be shown to be right: it will be known to about ± {u95_um:.2f} µm, and the "
            f"tolerance is {target.tolerance_um:g} µm; the job ends with exit code 7 then"
        )
        hint = f"permit {rounded_up(SPARE * u95_um)} µm or more{why}"
        yield Finding(Code.NOT_SHOWN, ("target", "tolerance_um"), message, hint)


def depth_beyond_tolerance(job: Job) -> Iterator[Finding]:
    """Rule 33: a depth is more than its tolerance; millimetres given for micrometres are not."""
    target = job.profile.target
    in_mm = "lengths are in µm, {0:g} mm would be {1:g}"
    if target.kind == "through" and (sheet_um := job.profile.work.thickness_um) < LEAST_SHEET_UM:
        message = f"a sheet of {sheet_um:g} µm is thinner than a foil of {LEAST_SHEET_UM:g} µm"
        hint = in_mm.format(sheet_um, 1000.0 * sheet_um)
        yield Finding(Code.LESS_THAN_TOLERANCE, ("work", "thickness_um"), message, hint)
    if target.kind != "depth":
        return
    path: KeyPath = ("target", "depth_um")
    depth_um, where = target.depth_um, None
    own = [place for place in job.places if math.isfinite(place.depth_um)]
    shallow = min(own, key=lambda place: place.depth_um, default=None)
    if shallow is not None and (len(own) == len(job.places) or shallow.depth_um <= depth_um):
        path, depth_um, where = ("sites", shallow.entry), shallow.depth_um, shallow.where
    if depth_um <= target.tolerance_um:
        limit = f"its tolerance, {target.tolerance_um:g} µm"
        message = (
            f"a depth of {depth_um:g} µm is no more than {limit}: work that was never touched is as good"
        )
        hint = f"{in_mm.format(depth_um, 1000.0 * depth_um)}; or set a smaller tolerance"
        yield Finding(Code.LESS_THAN_TOLERANCE, path, message, hint, where)


def time_limit(job: Job) -> Iterator[Finding]:
    """Rule 20: the job can end within its time limit."""
    limit_s, time_s = job.profile.limits.max_time_s, job.forecast.time_s
    if limit_s < time_s:
        hint = f"permit {3.0 * time_s:.0f} s, three times the forecast"
        path = job.profile.path
        least_um_s = 0.0 if path is None else Channel(job.profile, path).waiting_speed_um_s
        if path is not None and path.speed_um_s < least_um_s:
            hint = (
                f"raise path.speed_um_s from {path.speed_um_s:g} to {rounded_up(least_um_s)} µm/s or more, where a "
                f"pass takes no longer than its sparks; or {hint}"
            )
        message = f"the job takes about {time_s:.0f} s, more than max_time_s {limit_s:g} s"
        yield Finding(Code.TIME_LIMIT, ("limits", "max_time_s"), message, hint)
