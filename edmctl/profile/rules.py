"""The cross-field rules: what is wrong with a profile whose every value is fine by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.process.working_gap import usual_gap_um
from edmctl.profile.adaptive_rules import adaptive_period, adaptive_thresholds
from edmctl.profile.channel_rules import channel_depth, layer, path_keys, walls
from edmctl.profile.codes import Code
from edmctl.profile.findings import Finding, Job
from edmctl.profile.forecast import forecast
from edmctl.profile.motion_rules import (
    actuator_voltage,
    approach_travel,
    jump,
    offset,
    pad_distance,
    ramp_order,
    servo_swing,
    slope_against_feed,
    stroke,
    through_stroke,
)
from edmctl.profile.partial_profile import lacks_value, without
from edmctl.profile.place_rules import (
    array_stroke,
    array_wear,
    clear_of_each_other,
    depths_of_places,
    names,
    sites_or_path,
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
    depth_beyond_tolerance,
    depth_shown,
    feed_without_remeasuring,
    through_target,
    tolerance,
    tool_wear,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from edmctl.profile.model import Profile
    from edmctl.profile.places import Place
    from edmctl.profile.setup import Setup

RULES: tuple[Callable[[Job], Iterable[Finding]], ...] = (
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
    pad_distance,
    through_target,
    adaptive_period,
    adaptive_thresholds,
    channel_depth,
    sites_or_path,
    depths_of_places,
    names,
    walls,
    clear_of_each_other,
    array_wear,
    array_stroke,
    layer,
    depth_shown,
    depth_beyond_tolerance,
)
"""Every rule, in order of its number. Rule 12 (one touch speed for Z1, Z2 and Z3) has no key to break it."""

TIME_LIMIT_FORECASTS = 3.0


def with_time_limit(profile: Profile, setup: Setup, places: tuple[Place, ...] = ()) -> Profile:
    """Fill in the time limit where none is given, from the forecast."""
    limits = profile.limits
    if "max_time_s" in limits.model_fields_set:
        return profile
    time_s = TIME_LIMIT_FORECASTS * forecast(profile, setup, places).time_s
    return profile.model_copy(update={"limits": limits.model_copy(update={"max_time_s": time_s})})


def with_expected_gap(profile: Profile) -> Profile:
    """Fill in the working gap to expect where none is given, from the open voltage."""
    measure = profile.measure
    if "expected_gap_um" in measure.model_fields_set:
        return profile
    gap_um = usual_gap_um(profile.pulse.open_voltage_v)
    return profile.model_copy(update={"measure": measure.model_copy(update={"expected_gap_um": gap_um})})


def in_share_only(profile: Profile) -> Profile:
    """Turn a reference in volts into the share that it is, so that the profile states it once."""
    if profile.servo.reference_v is None:
        return profile
    servo = profile.servo.model_copy(update={"reference": _share(profile), "reference_v": None})
    return profile.model_copy(update={"servo": servo})


def violations(profile: Profile, setup: Setup, places: tuple[Place, ...] = ()) -> list[Finding]:
    """Every violated rule, warnings included, in order.

    Rules that need a value which a draft lacks (see `edmctl.profile.partial_profile`) are left out.
    """
    once = _held(reference_stated_once, Job(profile, setup))
    shaped = _held(path_keys, Job(profile, setup))
    known = without(profile, ("servo", "reference")) if once else _with_share(profile)
    job = Job(without(known, ("path",)) if shaped else known, setup, places)
    return [*once, *shaped, *(finding for rule in RULES for finding in _held(rule, job))]


def reference_stated_once(job: Job) -> Iterable[Finding]:
    """Rule 16: the servo reference is given as a share or in volts, not twice and not never."""
    servo = job.profile.servo
    share, volts = servo.reference, servo.reference_v
    given = servo.model_fields_set & {"reference", "reference_v"}
    if len(given) == 2:
        message = f"the servo reference is given twice: reference {share:g} and reference_v {volts:g} V"
        yield Finding(Code.REFERENCE_ONCE, ("servo", "reference_v"), message, "remove one of the two")
    elif not given:
        hint = "add reference = 0.80 to [servo]"
        yield Finding(Code.REFERENCE_ONCE, ("servo",), "servo.reference is missing", hint)


def _held(rule: Callable[[Job], Iterable[Finding]], job: Job) -> list[Finding]:
    """Findings of a rule; none where it asks for a value that could not be read."""
    try:
        return list(rule(job))
    except AttributeError as error:
        if lacks_value(error):
            return []
        raise


def _with_share(profile: Profile) -> Profile:
    """The profile with its reference as a share; without one where that cannot be told."""
    try:
        if profile.servo.reference_v is None:
            return profile
        servo = profile.servo.model_copy(update={"reference": _share(profile)})
    except AttributeError as error:
        if lacks_value(error):
            return without(profile, ("servo", "reference"))
        raise
    return profile.model_copy(update={"servo": servo})


def _share(profile: Profile) -> float:
    assert profile.servo.reference_v is not None
    return profile.servo.reference_v / profile.pulse.duty_voltage_v
