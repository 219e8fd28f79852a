"""Cross-field rules of target, measurement and limits."""

from __future__ import annotations

import math
from operator import ge, gt

from edmctl.failures import Code
from edmctl.planning.channel import Channel
from edmctl.planning.forecast import Job, depth_and_wear_um
from edmctl.planning.rules.bound import Bound, Finding, Findings, rounded_up

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
