"""Cross-field rules of stroke, servo ramps and jumps, adaptive ones and their thresholds too."""

from __future__ import annotations

import math
from collections.abc import Iterator

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
    time_share_of_jumps,
)
from edmctl.profile.findings import PAD_MARGIN_UM, Code, Finding, rounded_down, rounded_up
from edmctl.profile.model import Profile

SLOPE_PER_FEED_MIN, SLOPE_PER_FEED_GOOD = 1.2, 3.0
OFFSET_MIN_UM = 45.0
"""Actuator model error near 0 V (35 µm) and error left by a jump (10 µm), Muralidhara et al. 2009, §2.2."""
JUMP_HEIGHT_FACTOR = 1.5
JUMP_SHARE_MAX = 0.3


def actuator_voltage(job: Job) -> Iterator[Finding]:
    """Rule 21: the voltage limit is within the actuator's."""
    volts, stroke_v = job.profile.limits.stroke_v_max, job.setup.actuator.stroke_v
    if volts > stroke_v:
        yield Finding(
            Code.ACTUATOR_VOLTAGE,
            ("limits", "stroke_v_max"),
            f"stroke_v_max {volts:g} V is above the actuator's {stroke_v:g} V",
            f"use at most {stroke_v:g} V",
        )


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
    if profile.path is not None and profile.target.kind == "depth":
        wear_um = depth_and_wear_um(profile)[1]
        yield Finding(
            Code.STROKE,
            ("target", "depth_um"),
            f"a channel {profile.target.depth_um:g} µm deep is out of reach: with {wear_um:.0f} µm of tool wear "
            f"over its length it needs {needs}",
            f"make it less deep or shorter, use a tool that wears less{raising}",
        )
    elif profile.target.kind == "depth":
        yield Finding(
            Code.STROKE,
            ("target", "depth_um"),
            f"depth {profile.target.depth_um:g} µm is out of reach: at wear ratio {ratio:g} it needs {needs}",
            f"at most {math.floor(max(reach_um, 0.0) / (1.0 + ratio))} µm deep{raising}",
        )
    else:
        yield Finding(
            Code.STROKE,
            ("target", "feed_um"),
            f"feed {profile.target.feed_um:g} µm is out of reach: it needs {needs}",
            f"at most {rounded_down(max(reach_um, 0.0))} µm{raising}",
        )


def through_stroke(job: Job) -> Iterator[Finding]:
    """Rule 10: a through hole has stroke for the sheet, the wear and the worn tip.

    Where the target is a depth or a feed nobody waits for the breakthrough, and rule 2 sees to the stroke.
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
    yield Finding(
        Code.THROUGH_STROKE,
        ("work", "thickness_um"),
        f"a hole through {thickness_um:g} µm needs offset {profile.approach.offset_um:g} + reserve "
        f"{STROKE_RESERVE_UM:g} + {thickness_um:g} x {1 + ratio:g} + {tip_um:g} for the worn tip = "
        f"{needed_um:.0f} µm of stroke; {profile.limits.stroke_v_max:g} V give {available_um:.0f} µm",
        f"at most {math.floor(thickest_um)} µm thick, or drill a blind hole",
    )


def slope_against_feed(job: Job) -> Iterator[Finding]:
    """Rule 3: the servo ramp outruns the erosion."""
    slope, feed = job.profile.servo.forward_um_s, job.forecast.feed_rate_um_s
    if slope >= SLOPE_PER_FEED_GOOD * feed:
        return
    refused = slope < SLOPE_PER_FEED_MIN * feed
    consequence = "the servo cannot follow the erosion" if refused else "the job loses time"
    yield Finding(
        Code.SLOPE_BELOW_FEED if refused else Code.SLOPE_NEAR_FEED,
        ("servo", "forward_um_s"),
        f"forward ramp {slope:g} µm/s is {slope / feed:.1f} times the forecast feed {feed:.2f} µm/s: "
        f"{consequence}",
        f"use at least {rounded_up(SLOPE_PER_FEED_GOOD * feed)} µm/s",
    )


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


def ramp_order(job: Job) -> Iterator[Finding]:
    """Rule 5: retraction is not slower than the advance asks for."""
    servo = job.profile.servo
    if servo.back_um_s < 0.5 * servo.forward_um_s:
        yield Finding(
            Code.RAMP_ORDER,
            ("servo", "back_um_s"),
            f"back ramp {servo.back_um_s:g} µm/s is below half the forward ramp {servo.forward_um_s:g} µm/s",
            f"use at least {0.5 * servo.forward_um_s:g} µm/s",
        )
    if servo.short_back_um_s < servo.back_um_s:
        yield Finding(
            Code.RAMP_ORDER,
            ("servo", "short_back_um_s"),
            f"retraction from a short, {servo.short_back_um_s:g} µm/s, is slower than the back ramp "
            f"{servo.back_um_s:g} µm/s",
            f"use at least {servo.back_um_s:g} µm/s; 50 µm/s is usual",
        )


def offset(job: Job) -> Iterator[Finding]:
    """Rule 6: home is clear of the work whatever the actuator's error there."""
    offset_um = job.profile.approach.offset_um
    if offset_um < OFFSET_MIN_UM:
        yield Finding(
            Code.OFFSET,
            ("approach", "offset_um"),
            f"offset {offset_um:g} µm is below {OFFSET_MIN_UM:g} µm: near 0 V the actuator's place is known "
            "to 35 µm only, and a jump leaves up to 10 µm",
            f"set the tool at least {OFFSET_MIN_UM:g} µm above the work; 50 µm is usual",
        )


def approach_travel(job: Job) -> Iterator[Finding]:
    """Rule 18: the approach may travel as far as the surface."""
    approach = job.profile.approach
    if approach.max_travel_um <= approach.offset_um:
        yield Finding(
            Code.APPROACH_TRAVEL,
            ("approach", "max_travel_um"),
            f"the approach gives up after {approach.max_travel_um:g} µm, but the work is "
            f"{approach.offset_um:g} µm away",
            f"use {approach.offset_um + 30.0:g} µm or more",
        )


def pad_distance(job: Job) -> Iterator[Finding]:
    """Rule 22: the reference pad, as wide as the tool, keeps clear of the hole."""
    profile = job.profile
    if profile.sites or profile.path is not None:
        return
    apart_um, radius_um, gap_um = (
        profile.measure.site_dx_um,
        profile.tool.diameter_um / 2,
        profile.work.side_gap_um,
    )
    least_um = radius_um + radius_um + gap_um + PAD_MARGIN_UM
    if apart_um < least_um:
        yield Finding(
            Code.PAD_DISTANCE,
            ("measure", "site_dx_um"),
            f"the reference pad is {apart_um:g} µm beside the hole and overlaps it or its rim: tool radius "
            f"{radius_um:g} + hole radius {radius_um + gap_um:g} + margin {PAD_MARGIN_UM:g} = {least_um:g} µm",
            f"use at least {rounded_up(least_um)} µm",
        )


def jump(job: Job) -> Iterator[Finding]:
    """Rule 7: jumps flush, fit above home, and leave time to machine.

    Adaptive jumps go only as far up as the tool is down.
    """
    j = job.profile.jump
    if j.mode == "off":
        return
    yield from _jump_height(job.profile)
    share = time_share_of_jumps(job.profile)
    if share > JUMP_SHARE_MAX:
        yield Finding(
            Code.JUMP,
            ("jump", "period_s"),
            f"jumping takes {100 * share:.0f} % of the time (2 x {j.height_um:g} µm / "
            f"{j.speed_um_s:g} µm/s + {j.dwell_ms:g} ms, every {j.period_s:g} s); "
            f"at most {100 * JUMP_SHARE_MAX:.0f} %",
            f"use a period of at least {rounded_up(share * j.period_s / JUMP_SHARE_MAX)} s, or a faster jump",
        )


def _jump_height(profile: Profile) -> Iterator[Finding]:
    j, (depth_um, wear_um) = profile.jump, depth_and_wear_um(profile)
    wear_um = hole(profile).feed_um - depth_um if profile.path is None else wear_um
    least_um = JUMP_HEIGHT_FACTOR * least_jump_um(
        depth_um, profile.tool.diameter_um, profile.work.side_gap_um
    )
    deepest_um = profile.approach.offset_um + depth_um + wear_um
    if j.height_um > deepest_um and j.mode == "fixed":
        yield Finding(
            Code.JUMP,
            ("jump", "height_um"),
            f"jump height {j.height_um:g} µm is more than the tool's way down, {deepest_um:.0f} µm at the "
            "end: it cannot retract below 0 V",
            f"use at most {rounded_down(deepest_um)} µm; {rounded_up(least_um)} µm are enough to flush",
        )
    elif j.height_um < least_um:
        yield Finding(
            Code.JUMP_TOO_LOW,
            ("jump", "height_um"),
            f"jump height {j.height_um:g} µm hardly flushes: at {depth_um:.0f} µm depth and a side gap of "
            f"{profile.work.side_gap_um:g} µm it takes {least_um:.0f} µm",
            f"use {rounded_up(least_um)} µm or more",
        )


def adaptive_period(job: Job) -> Iterator[Finding]:
    """Rules 7 and 24: the shortest period is the shorter one, and still leaves time to machine."""
    jump = job.profile.jump
    if jump.mode != "adaptive":
        return
    if jump.period_min_s > jump.period_s:
        yield Finding(
            Code.ADAPTIVE,
            ("jump", "period_min_s"),
            f"the shortest jump period, {jump.period_min_s:g} s, is longer than period_s {jump.period_s:g} s",
            f"use at most {jump.period_s:g} s; 1.5 s is usual",
        )
    took_s = jump_duration_s(job.profile)
    share = took_s / jump.period_min_s
    if share > JUMP_SHARE_MAX:
        yield Finding(
            Code.JUMP,
            ("jump", "period_min_s"),
            f"at the shortest period jumping takes {100 * share:.0f} % of the time ({took_s:.2g} s every "
            f"{jump.period_min_s:g} s); at most {100 * JUMP_SHARE_MAX:.0f} %",
            f"use at least {rounded_up(took_s / JUMP_SHARE_MAX)} s, or a faster jump",
        )


def adaptive_thresholds(job: Job) -> Iterator[Finding]:
    """Rule 24: what the supervisor lowers lies below what it starts from, what it raises above."""
    adaptive, stopping = job.profile.adaptive, job.profile.limits.arc_ratio
    if adaptive.seek_reference and adaptive.arc_target is not None and adaptive.arc_target >= stopping:
        yield Finding(
            Code.ADAPTIVE,
            ("adaptive", "arc_target"),
            f"arc_target {adaptive.arc_target:g} is not below limits.arc_ratio {stopping:g}, which stops the job",
            f"use less than {stopping:g}, or raise limits.arc_ratio",
        )
    if job.profile.jump.mode != "adaptive":
        return
    adaptive, servo, pulse = job.profile.adaptive, job.profile.servo, job.profile.pulse
    for kind, low, high in (
        ("arc", adaptive.arc_low, adaptive.arc_high),
        ("short", adaptive.short_low, adaptive.short_high),
    ):
        if low >= high:
            yield Finding(
                Code.ADAPTIVE,
                ("adaptive", f"{kind}_low"),
                f"{kind}_low {low:g} is not below {kind}_high {high:g}: jumps would be made rarer and more frequent "
                "by turns",
                f"use less than {high:g}",
            )
    if adaptive.reference_max < servo.reference:
        yield Finding(
            Code.ADAPTIVE,
            ("adaptive", "reference_max"),
            f"reference_max {adaptive.reference_max:g} is below the servo reference {servo.reference:g} that it is "
            "raised from",
            f"use {servo.reference:g} or more",
        )
    if adaptive.duty_min > pulse.duty:
        yield Finding(
            Code.ADAPTIVE,
            ("adaptive", "duty_min"),
            f"duty_min {adaptive.duty_min:g} is above the duty {pulse.duty:g} that it is lowered from",
            f"use {pulse.duty:g} or less",
        )
