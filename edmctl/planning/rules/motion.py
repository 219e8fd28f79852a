"""Cross-field rules of stroke, servo ramps and jumps, adaptive ones and their thresholds too."""

from __future__ import annotations

import math
from collections.abc import Iterator
from operator import ge, gt, le, lt

from edmctl.failures import Code
from edmctl.planning.forecast import (
    STROKE_RESERVE_UM,
    Job,
    depth_and_wear_um,
    stroke_available_um,
    stroke_um,
)
from edmctl.planning.removal import (
    HALF_AMPLITUDE_DESIGN_UM,
    HALF_AMPLITUDE_LIMIT_UM,
    completion,
    hole,
    jump_duration_s,
    least_jump_um,
    servo_swing,
)
from edmctl.planning.rules.bound import Bound
from edmctl.profile.findings import PAD_MARGIN_UM, Finding, rounded_down, rounded_up
from edmctl.profile.model import Profile

SLOPE_PER_FEED_MIN, SLOPE_PER_FEED_GOOD = 1.2, 3.0
OFFSET_MIN_UM = 45.0
"""Actuator model error near 0 V (35 µm) and error left by a jump (10 µm), Muralidhara et al. 2009, §2.2."""
JUMP_HEIGHT_FACTOR = 1.5
JUMP_SHARE_MAX = 0.3

ACTUATOR_VOLTAGE = Bound(
    Code.ACTUATOR_VOLTAGE, "limits.stroke_v_max", le, lambda job: job.setup.actuator.stroke_v
).says("stroke_v_max {value:g} V is above the actuator's {limit:g} V", "use at most {limit:g} V")
RAMP_ORDER = (
    Bound(Code.RAMP_ORDER, "servo.back_um_s", ge, lambda job: 0.5 * job.profile.servo.forward_um_s).says(
        "back ramp {value:g} µm/s is below half the forward ramp {servo.forward_um_s:g} µm/s",
        "use at least {limit:g} µm/s",
    ),
    Bound(Code.RAMP_ORDER, "servo.short_back_um_s", ge, "servo.back_um_s").says(
        "retraction from a short, {value:g} µm/s, is slower than the back ramp {limit:g} µm/s",
        "use at least {limit:g} µm/s; 50 µm/s is usual",
    ),
)
OFFSET = Bound(Code.OFFSET, "approach.offset_um", ge, OFFSET_MIN_UM).says(
    "offset {value:g} µm is below {limit:g} µm: near 0 V the actuator's place is known to 35 µm only, and a jump "
    "leaves up to 10 µm",
    "set the tool at least {limit:g} µm above the work; 50 µm is usual",
)
APPROACH_TRAVEL = Bound(Code.APPROACH_TRAVEL, "approach.max_travel_um", gt, "approach.offset_um").says(
    "the approach gives up after {value:g} µm, but the work is {limit:g} µm away",
    "use more than {limit:g} µm; 120 µm is usual",
)
PAD_DISTANCE = Bound(
    Code.PAD_DISTANCE,
    "measure.site_dx_um",
    ge,
    lambda job: job.profile.tool.diameter_um + job.profile.work.side_gap_um + PAD_MARGIN_UM,
    when=lambda profile: not profile.sites and profile.path is None,
).says(
    "the reference pad is {value:g} µm beside the hole and overlaps it or its rim: tool diameter "
    f"{{tool.diameter_um:g}} + side gap {{work.side_gap_um:g}} + margin {PAD_MARGIN_UM:g} = {{limit:g}} µm",
    "use at least {least} µm",
)
"""Rule 22: the pad is as wide as the tool."""


def _is_adaptive(profile: Profile) -> bool:
    return profile.jump.mode == "adaptive"


def _seeks_arcs(profile: Profile) -> bool:
    return profile.adaptive.seek_reference and profile.adaptive.arc_target is not None


ADAPTIVE = (
    Bound(Code.ADAPTIVE, "jump.period_min_s", le, "jump.period_s", when=_is_adaptive).says(
        "the shortest jump period, {value:g} s, is longer than period_s {limit:g} s",
        "use at most {limit:g} s; 1.5 s is usual",
    ),
    Bound(Code.ADAPTIVE, "adaptive.arc_target", lt, "limits.arc_ratio", when=_seeks_arcs).says(
        "arc_target {value:g} is not below limits.arc_ratio {limit:g}, which stops the job",
        "use less than {limit:g}, or raise limits.arc_ratio",
    ),
    *(
        Bound(Code.ADAPTIVE, f"adaptive.{kind}_low", lt, f"adaptive.{kind}_high", when=_is_adaptive).says(
            f"{kind}_low {{value:g}} is not below {kind}_high {{limit:g}}: jumps would be made rarer and more "
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
"""Rule 24: what the supervisor lowers begins above its limit, what it raises below."""


def stroke(job: Job) -> Iterator[Finding]:
    """Rule 2: the target is within the stroke; rule 10 for a way through, and for each of several places."""
    profile = job.profile
    if profile.target.kind == "through" or profile.sites:
        return
    needed_um, available_um = stroke_um(profile), stroke_available_um(profile, job.setup)
    if needed_um <= available_um:
        return
    ratio, offset_um = profile.wear.expected_ratio, profile.approach.offset_um
    reach_um = available_um - offset_um - STROKE_RESERVE_UM
    wanted_v = needed_um / job.setup.actuator.gain_um_per_v
    needs = (
        f"offset {offset_um:g} + feed {sum(depth_and_wear_um(profile)):.0f} + reserve {STROKE_RESERVE_UM:g} "
        f"= {needed_um:.0f} µm of stroke, but {profile.limits.stroke_v_max:g} V give {available_um:.0f} µm"
    )
    raising = (
        f", or raise limits.stroke_v_max to {math.ceil(wanted_v)} V"
        if wanted_v <= job.setup.actuator.stroke_v
        else f"; even {job.setup.actuator.stroke_v:g} V are not enough"
    )
    key = "depth_um"
    if profile.path is not None and profile.target.kind == "depth":
        wear_um = depth_and_wear_um(profile)[1]
        target = f"a channel {profile.target.depth_um:g} µm deep"
        by = f"with {wear_um:.0f} µm of tool wear over its length "
        hint = "make it less deep or shorter, use a tool that wears less"
    elif profile.target.kind == "depth":
        target, by = f"depth {profile.target.depth_um:g} µm", f"at wear ratio {ratio:g} "
        hint = f"at most {math.floor(max(reach_um, 0.0) / (1.0 + ratio))} µm deep"
    else:
        key, target, by = "feed_um", f"feed {profile.target.feed_um:g} µm", ""
        hint = f"at most {rounded_down(max(reach_um, 0.0))} µm"
    message = f"{target} is out of reach: {by}it needs {needs}"
    yield Finding(Code.STROKE, ("target", key), message, f"{hint}{raising}")


def through_stroke(job: Job) -> Iterator[Finding]:
    """Rule 10: a through hole has stroke for the sheet, the wear and the worn tip.

    Where the target is a depth or a feed the job does not wait for the breakthrough, and rule 2 sees to the stroke.
    """
    profile, available_um = job.profile, stroke_available_um(job.profile, job.setup)
    if profile.target.kind != "through" or profile.work.kind != "through":
        return
    thickness_um, ratio, tip_um = profile.work.thickness_um, profile.wear.expected_ratio, completion(profile)
    beside_um = profile.approach.offset_um + STROKE_RESERVE_UM
    thickest_um = max(available_um - tip_um - beside_um, 0.0) / (1.0 + ratio)
    needed_um = thickness_um * (1.0 + ratio) + tip_um + beside_um
    if needed_um <= available_um:
        return
    message = (
        f"a hole through {thickness_um:g} µm needs offset {profile.approach.offset_um:g} + reserve "
        f"{STROKE_RESERVE_UM:g} + {thickness_um:g} x {1 + ratio:g} + {tip_um:g} for the worn tip = "
        f"{needed_um:.0f} µm of stroke; {profile.limits.stroke_v_max:g} V give {available_um:.0f} µm"
    )
    hint = f"at most {math.floor(thickest_um)} µm thick, or drill a blind hole"
    yield Finding(Code.THROUGH_STROKE, ("work", "thickness_um"), message, hint)


def slope_against_feed(job: Job) -> Iterator[Finding]:
    """Rule 3: the servo ramp outruns the erosion."""
    slope, feed = job.profile.servo.forward_um_s, job.forecast.feed_rate_um_s
    if slope >= SLOPE_PER_FEED_GOOD * feed:
        return
    refused = slope < SLOPE_PER_FEED_MIN * feed
    consequence = "the servo cannot follow the erosion" if refused else "the job loses time"
    code = Code.SLOPE_BELOW_FEED if refused else Code.SLOPE_NEAR_FEED
    times = f"{slope / feed:.1f} times the forecast feed {feed:.2f} µm/s"
    message = f"forward ramp {slope:g} µm/s is {times}: {consequence}"
    hint = f"use at least {rounded_up(SLOPE_PER_FEED_GOOD * feed)} µm/s"
    yield Finding(code, ("servo", "forward_um_s"), message, hint)


def limit_cycle(job: Job) -> Iterator[Finding]:
    """Rule 4: the relay's limit cycle stays well inside the gap."""
    servo, controller = job.profile.servo, job.setup.controller
    swing = servo_swing(job.profile, job.setup)
    if servo.mode != "relay" or swing.half_amplitude_um <= HALF_AMPLITUDE_DESIGN_UM:
        return
    refused = swing.half_amplitude_um > HALF_AMPLITUDE_LIMIT_UM
    limit_um = HALF_AMPLITUDE_LIMIT_UM if refused else HALF_AMPLITUDE_DESIGN_UM
    yield Finding(
        Code.LIMIT_CYCLE if refused else Code.LIMIT_CYCLE_LARGE,
        ("servo", "forward_um_s"),
        f"the servo would swing ±{swing.half_amplitude_um:.2f} µm (period {swing.period_s:.2g} s): ramp "
        f"{servo.forward_um_s:g} µm/s x loop delay {1e3 * swing.loop_delay_s:.0f} ms, with a loop of "
        f"{1e-3 * controller.servo_period_us:g} ms; above {limit_um:g} µm the tool shorts",
        f"use at most {rounded_down(HALF_AMPLITUDE_DESIGN_UM / swing.loop_delay_s)} µm/s, a faster loop, "
        'or servo.mode = "pi"',
    )


def jump(job: Job) -> Iterator[Finding]:
    """Rule 7: jumps flush, fit above home, and leave time to machine. Adaptive ones retract as far as they can."""
    profile, j = job.profile, job.profile.jump
    if j.mode == "off":
        return
    depth_um, wear_um = depth_and_wear_um(profile)
    feed_um = depth_um + wear_um if profile.path is not None else hole(profile).feed_um
    deepest_um = profile.approach.offset_um + feed_um
    side_gap_um = profile.work.side_gap_um
    least_um = JUMP_HEIGHT_FACTOR * least_jump_um(depth_um, profile.tool.diameter_um, side_gap_um)
    height = f"jump height {j.height_um:g} µm"
    if j.height_um > deepest_um and j.mode == "fixed":
        way = f"the tool's way down, {deepest_um:.0f} µm at the end"
        message = f"{height} is more than {way}: it cannot retract below 0 V"
        hint = f"use at most {rounded_down(deepest_um)} µm; {rounded_up(least_um)} µm are enough to flush"
        yield Finding(Code.JUMP, ("jump", "height_um"), message, hint)
    elif j.height_um < least_um:
        where = f"at {depth_um:.0f} µm depth and a side gap of {side_gap_um:g} µm"
        message = f"{height} hardly flushes: {where} it takes {least_um:.0f} µm"
        hint = f"use {rounded_up(least_um)} µm or more"
        yield Finding(Code.JUMP_TOO_LOW, ("jump", "height_um"), message, hint)
    took_s = jump_duration_s(profile)
    made_of = f"2 x {j.height_um:g} µm / {j.speed_um_s:g} µm/s + {j.dwell_ms:g} ms"
    periods = [("period_s", j.period_s, "", made_of)]
    if j.mode == "adaptive":
        periods.append(("period_min_s", j.period_min_s, "at the shortest period ", f"{took_s:.2g} s"))
    for key, period_s, when, made_of in periods:
        share = took_s / period_s
        if share > JUMP_SHARE_MAX:
            time = f"{100 * share:.0f} % of the time ({made_of} every {period_s:g} s)"
            message = f"{when}jumping takes {time}; at most {100 * JUMP_SHARE_MAX:.0f} %"
            hint = f"use a period of at least {rounded_up(took_s / JUMP_SHARE_MAX)} s, or a faster jump"
            yield Finding(Code.JUMP, ("jump", key), message, hint)
