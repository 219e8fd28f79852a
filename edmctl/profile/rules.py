"""The cross-field rules: what is wrong with a profile whose every value is fine by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.profile.codes import Code
from edmctl.profile.findings import Finding, Job
from edmctl.profile.forecast import forecast
from edmctl.profile.motion_rules import (
    actuator_voltage,
    approach_travel,
    jump,
    offset,
    ramp_order,
    servo_swing,
    slope_against_feed,
    stroke,
    through_stroke,
)
from edmctl.profile.pulse_rules import (
    discharge_time,
    filter_corner,
    pulse_energy,
    pulse_times,
    reference_window,
)
from edmctl.profile.target_rules import (
    blind_depth,
    feed_without_remeasuring,
    time_limit,
    tolerance,
    tool_wear,
)

if TYPE_CHECKING:
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup

RULES = (
    reference_window,
    stroke,
    slope_against_feed,
    servo_swing,
    ramp_order,
    offset,
    jump,
    pulse_energy,
    pulse_times,
    through_stroke,
    tolerance,
    filter_corner,
    feed_without_remeasuring,
    discharge_time,
    tool_wear,
    approach_travel,
    blind_depth,
    actuator_voltage,
)
"""Every rule, in order of its number. Rule 12 (one touch speed for Z1, Z2 and Z3) has no key to break it."""

TIME_LIMIT_FORECASTS = 3.0


def complete(profile: Profile, setup: Setup) -> Profile:
    """Fill in what follows from other values: the reference given in volts, the time limit not given."""
    servo, limits = profile.servo, profile.limits
    if servo.reference_v is not None:
        servo = servo.model_copy(update={"reference": servo.reference_v / profile.pulse.duty_voltage_v})
        profile = profile.model_copy(update={"servo": servo})
    if "max_time_s" not in limits.model_fields_set:
        time_s = TIME_LIMIT_FORECASTS * forecast(profile, setup).time_s
        limits = limits.model_copy(update={"max_time_s": time_s})
        profile = profile.model_copy(update={"limits": limits})
    return profile


def in_share_only(profile: Profile) -> Profile:
    """Drop the reference in volts once its share is known, so that the profile states it once."""
    if profile.servo.reference_v is None:
        return profile
    return profile.model_copy(update={"servo": profile.servo.model_copy(update={"reference_v": None})})


def reference_stated_once(profile: Profile) -> list[Finding]:
    """Rule 16: the servo reference is given as a share or in volts, not twice and not never."""
    given = profile.servo.model_fields_set & {"reference", "reference_v"}
    if len(given) == 1:
        return []
    if given:
        message = (
            f"the servo reference is given twice: reference {profile.servo.reference:g} and "
            f"reference_v {profile.servo.reference_v:g} V"
        )
        return [Finding(Code.REFERENCE_ONCE, ("servo", "reference_v"), message, "remove one of the two")]
    hint = "add reference = 0.80 to [servo]"
    return [Finding(Code.REFERENCE_ONCE, ("servo",), "servo.reference is missing", hint)]


def violations(profile: Profile, setup: Setup) -> list[Finding]:
    """Every violated rule of a completed profile, warnings included; time only of a job that can run."""
    job = Job(profile, setup, forecast(profile, setup))
    findings = [finding for rule in RULES for finding in rule(job)]
    if all(finding.is_warning for finding in findings):
        findings += time_limit(job)
    return findings
