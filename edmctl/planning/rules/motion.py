"""Cross-field rules of stroke, servo ramps and jumps, adaptive ones and their thresholds too."""

from __future__ import annotations

import math
from operator import ge, gt, le, lt

from edmctl.failures import Code
from edmctl.planning.forecast import (
    STROKE_RESERVE_UM,
    Job,
    depth_and_wear_um,
    stroke_available_um,
    working_order,
)
from edmctl.planning.removal import (
    HALF_AMPLITUDE_DESIGN_UM,
    HALF_AMPLITUDE_LIMIT_UM,
    PAD_MARGIN_UM,
    hole,
    jump_duration_s,
    least_jump_um,
    servo_swing,
)
from edmctl.planning.rules.bound import Bound, Finding, Findings, rounded_down, rounded_up
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.profile.positions import KeyPath

SLOPE_PER_FEED_MIN, SLOPE_PER_FEED_GOOD = 1.2, 3.0
OFFSET_MIN_UM = 45.0
"""Actuator model error near 0 V (35 µm) and error left by a jump (10 µm), Muralidhara et al. 2009, §2.2."""
JUMP_HEIGHT_FACTOR = 1.5
JUMP_SHARE_MAX = 0.3


def _is_adaptive(profile: Profile) -> bool:
    return profile.jump.mode == "adaptive"


BOUNDS = (
    Bound(Code.ACTUATOR_VOLTAGE, "limits.stroke_v_max", le, lambda job: job.setup.actuator.stroke_v).says(
        "stroke_v_max {value:g} V is above the actuator's {limit:g} V", "use at most {limit:g} V"
    ),
    Bound(Code.RAMP_ORDER, "servo.back_um_s", ge, lambda job: 0.5 * job.profile.servo.forward_um_s).says(
        "back ramp {value:g} µm/s is below half the forward ramp {servo.forward_um_s:g} µm/s",
        "use at least {limit:g} µm/s",
    ),
    Bound(Code.RAMP_ORDER, "servo.short_back_um_s", ge, "servo.back_um_s").says(
        "retraction from a short, {value:g} µm/s, is slower than the back ramp {limit:g} µm/s",
        "use at least {limit:g} µm/s; 50 µm/s is usual",
    ),
    Bound(Code.OFFSET, "approach.offset_um", ge, OFFSET_MIN_UM).says(
        "offset {value:g} µm is below {limit:g} µm: near 0 V the actuator's place is known to 35 µm only, and a "
        "jump leaves up to 10 µm",
        "set the tool at least {limit:g} µm above the work; 50 µm is usual",
    ),
    Bound(Code.APPROACH_TRAVEL, "approach.max_travel_um", gt, "approach.offset_um").says(
        "the approach gives up after {value:g} µm, but the work is {limit:g} µm away",
        "use more than {limit:g} µm; 120 µm is usual",
    ),
    Bound(
        Code.PAD_DISTANCE,
        "measure.site_dx_um",
        ge,
        lambda job: job.profile.tool.diameter_um + job.profile.work.side_gap_um + PAD_MARGIN_UM,
        when=lambda profile: not profile.sites and profile.path is None,
    ).says(
        "the reference pad, as wide as the tool, is {value:g} µm beside the hole and overlaps it or its rim: "
        f"diameter {{tool.diameter_um:g}} + side gap {{work.side_gap_um:g}} + margin {PAD_MARGIN_UM:g} = "
        "{limit:g} µm",
        "use at least {least} µm",
    ),
    Bound(Code.ADAPTIVE, "jump.period_min_s", le, "jump.period_s", when=_is_adaptive).says(
        "the shortest jump period, {value:g} s, is longer than period_s {limit:g} s",
        "use at most {limit:g} s; 1.5 s is usual",
    ),
    Bound(
        Code.ADAPTIVE,
        "adaptive.arc_target",
        lt,
        "limits.arc_ratio",
        when=lambda profile: profile.adaptive.seek_reference and profile.adaptive.arc_target is not None,
    ).says(
        "arc_target {value:g} is not below limits.arc_ratio {limit:g}, which stops the job",
        "use less than {limit:g}, or raise limits.arc_ratio",
    ),
    *(
        Bound(Code.ADAPTIVE, f"adaptive.{kind}_low", lt, f"adaptive.{kind}_high", when=_is_adaptive).says(
            f"{kind}_low {{value:g}} is not below {kind}_high {{limit:g}}: jumps would become rarer and more "
            "frequent by turns",
            "use less than {limit:g}",
        )
        for kind in ("arc", "short")
    ),
    Bound(Code.ADAPTIVE, "adaptive.reference_max", ge, "servo.reference", when=_is_adaptive).says(
        "reference_max {value:g} is below the servo reference {limit:g} that it is raised from",
        "use {limit:g} or more",
    ),
    Bound(Code.ADAPTIVE, "adaptive.duty_min", le, "pulse.duty", when=_is_adaptive).says(
        "duty_min {value:g} is above the duty {limit:g} that it is lowered from", "use {limit:g} or less"
    ),
)


def stroke(job: Job) -> Findings:
    """Rules 2, 10 and 30: offset, wear by the holes before, feed and a reserve fit into the stroke.

    There is no coarse Z. A depth or feed through a sheet does not wait for the breakthrough.
    """
    profile, target, worn_um = job.profile, job.profile.target, 0.0
    offset_um, available_um = profile.approach.offset_um, stroke_available_um(profile, job.setup)
    ordered = working_order(profile, job.setup, job.places)
    holes: list[Place | None] = [*ordered] or [None]
    for place in holes:
        one = hole(profile, math.nan if place is None else place.depth_um)
        feed_um = sum(depth_and_wear_um(profile)) if profile.path else one.feed_um
        needed_um = offset_um + worn_um + feed_um + STROKE_RESERVE_UM
        if needed_um > available_um:
            break
        worn_um += one.wear_um
    else:
        return
    spare_um = max(available_um - offset_um - STROKE_RESERVE_UM - one.completion_um, 0.0)
    deepest_um = math.floor(spare_um / (1.0 + profile.wear.expected_ratio))
    code, where, number = Code.STROKE, None, holes.index(place)
    key: str | KeyPath = f"target.{target.kind}_um"
    if place is not None:
        code, key, where = Code.ARRAY_STROKE if number else code, ("sites", place.entry), place.where
        what = f"hole {number + 1} of {len(ordered)}, {place.name},"
        hint = (
            f"{number} fit: make the others another job, with the tool set anew"
            if number
            else "make it less deep"
        )
    elif profile.path is not None:
        what = f"a channel with {depth_and_wear_um(profile)[1]:.0f} µm of tool wear over its length"
        hint = "make it less deep or shorter, or use a tool that wears less"
    elif target.kind == "through":
        code, key = Code.THROUGH_STROKE, "work.thickness_um"
        what = f"a hole through {one.depth_um:g} µm, with {one.completion_um:g} for the worn tip,"
        hint = f"at most {deepest_um} µm thick"
    elif target.kind == "depth":
        what, hint = f"depth {target.depth_um:g} µm", f"at most {deepest_um} µm deep"
    else:
        what, hint = f"feed {target.feed_um:g} µm", f"at most {rounded_down(spare_um)} µm"
    least_v = math.ceil(needed_um / job.setup.actuator.gain_um_per_v)
    if least_v <= job.setup.actuator.stroke_v:
        hint += f"; or raise limits.stroke_v_max to {least_v} V"
    worn = f"tool wear so far {worn_um:.0f} + " if number else ""
    message = (
        f"{what} is out of reach: offset {offset_um:g} + {worn}feed {feed_um:.0f} + reserve {STROKE_RESERVE_UM:g} = "
        f"{needed_um:.0f} µm of stroke, but {profile.limits.stroke_v_max:g} V give {available_um:.0f} µm"
    )
    yield Finding(code, key, message, hint, where)


def slope_against_feed(job: Job) -> Findings:
    """Rule 3: the servo ramp outruns the erosion."""
    slope, feed = job.profile.servo.forward_um_s, job.forecast.feed_rate_um_s
    if slope >= SLOPE_PER_FEED_GOOD * feed:
        return
    code, consequence = Code.SLOPE_NEAR_FEED, "the job loses time"
    if slope < SLOPE_PER_FEED_MIN * feed:
        code, consequence = Code.SLOPE_BELOW_FEED, "the servo cannot follow the erosion"
    times = f"{slope / feed:.1f} times the forecast feed {feed:.2f} µm/s"
    message = f"forward ramp {slope:g} µm/s is {times}: {consequence}"
    hint = f"use at least {rounded_up(SLOPE_PER_FEED_GOOD * feed)} µm/s"
    yield Finding(code, "servo.forward_um_s", message, hint)


def limit_cycle(job: Job) -> Findings:
    """Rule 4: the relay's limit cycle stays well inside the gap."""
    servo, swing = job.profile.servo, servo_swing(job.profile, job.setup)
    if servo.mode != "relay" or swing.half_amplitude_um <= HALF_AMPLITUDE_DESIGN_UM:
        return
    code, limit_um = Code.LIMIT_CYCLE_LARGE, HALF_AMPLITUDE_DESIGN_UM
    if swing.half_amplitude_um > HALF_AMPLITUDE_LIMIT_UM:
        code, limit_um = Code.LIMIT_CYCLE, HALF_AMPLITUDE_LIMIT_UM
    message = (
        f"the servo would swing ±{swing.half_amplitude_um:.2f} µm (period {swing.period_s:.2g} s): ramp "
        f"{servo.forward_um_s:g} µm/s x loop delay {1e3 * swing.loop_delay_s:.0f} ms, with a loop of "
        f"{1e-3 * job.setup.controller.servo_period_us:g} ms; above {limit_um:g} µm the tool shorts"
    )
    slower = rounded_down(HALF_AMPLITUDE_DESIGN_UM / swing.loop_delay_s)
    hint = f'use at most {slower} µm/s, a faster loop, or servo.mode = "pi"'
    yield Finding(code, "servo.forward_um_s", message, hint)


def jump(job: Job) -> Findings:
    """Rule 7: jumps flush, fit above home, and leave time to machine. Adaptive ones retract as far as they can."""
    profile, j = job.profile, job.profile.jump
    if j.mode == "off":
        return
    depth_um, wear_um = depth_and_wear_um(profile)
    feed_um = depth_um + wear_um if profile.path is not None else hole(profile).feed_um
    deepest_um, side_gap_um = profile.approach.offset_um + feed_um, profile.work.side_gap_um
    least_um = JUMP_HEIGHT_FACTOR * least_jump_um(depth_um, profile.tool.diameter_um, side_gap_um)
    if j.height_um > deepest_um and j.mode == "fixed":
        message = (
            f"jump height {j.height_um:g} µm is more than the tool's way down, {deepest_um:.0f} µm at the end: it "
            "cannot retract below 0 V"
        )
        hint = f"use at most {rounded_down(deepest_um)} µm; {rounded_up(least_um)} µm are enough to flush"
        yield Finding(Code.JUMP, "jump.height_um", message, hint)
    elif j.height_um < least_um:
        message = (
            f"jump height {j.height_um:g} µm hardly flushes: at {depth_um:.0f} µm depth and a side gap of "
            f"{side_gap_um:g} µm it takes {least_um:.0f} µm"
        )
        yield Finding(Code.JUMP_TOO_LOW, "jump.height_um", message, f"use {rounded_up(least_um)} µm or more")
    took_s = jump_duration_s(profile)
    made_of = f"2 x {j.height_um:g} µm / {j.speed_um_s:g} µm/s + {j.dwell_ms:g} ms = {took_s:.2g} s"
    for key in ("period_s", "period_min_s") if j.mode == "adaptive" else ("period_s",):
        period_s: float = getattr(j, key)
        if took_s > JUMP_SHARE_MAX * period_s:
            share = f"{100 * took_s / period_s:.0f} % of the time ({made_of} every {period_s:g} s)"
            message = f"jumping takes {share}; at most {100 * JUMP_SHARE_MAX:.0f} %"
            hint = f"use a period of at least {rounded_up(took_s / JUMP_SHARE_MAX)} s, or a faster jump"
            yield Finding(Code.JUMP, f"jump.{key}", message, hint)
