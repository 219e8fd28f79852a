"""Cross-field rules of adaptive jumps and of the supervisor's thresholds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.profile.codes import Code
from edmctl.profile.findings import Finding, Job, rounded_up
from edmctl.profile.motion_rules import JUMP_SHARE_MAX
from edmctl.profile.rates import jump_duration_s

if TYPE_CHECKING:
    from collections.abc import Iterator


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
