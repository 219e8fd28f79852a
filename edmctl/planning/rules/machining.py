"""Cross-field rules of generator, materials, stroke, servo and jumps."""

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
    REFERENCE_MARGIN,
    REFERENCE_MAX,
    expected_gap,
    expected_side_gap_um,
    expected_wear_ratio,
    hole,
    in_pulses,
    jump_duration_s,
    least_jump_um,
    of_tool,
    of_work,
    servo_swing,
    usual_depth_um,
)
from edmctl.planning.rules.bound import Bound, Finding, Findings, rounded_down, rounded_up
from edmctl.process.erosion import LAW, material, materials, pulse_energy_uj
from edmctl.profile.model import Profile, Pulse, SimSettings
from edmctl.profile.places import Place
from edmctl.profile.tables import KeyPath

ROUNDING = 1e-9  # a reference written as the very limit passes, though 0.55 + 0.05 is not 0.60 in binary
VOLTAGE_ROOM_V = 5.0
"""Least difference between open and discharge voltage that leaves the servo something to regulate."""
ENERGY_MIN_UJ, ENERGY_MAX_UJ = 0.1, 2000.0
LEAST_ENERGY_UJ = 1.1 * LAW.threshold_uj
"""Discharges ignite with some delay: a pulse that just reaches the threshold removes nothing."""
FINE_TOOL_UM, FINE_TOOL_ENERGY_UJ = 100.0, 200.0
ON_TIME_MIN_US, OFF_TIME_MIN_US = 5.0, 20.0
FILTER_PERIODS = 20.0  # pulses that the low-pass must average at least
DISCHARGE_MARGIN_US = 10.0

ROOM_FOR_REFERENCE = Bound(
    Code.REFERENCE_WINDOW,
    "pulse.open_voltage_v",
    gt,
    lambda job: job.profile.pulse.discharge_voltage_v + VOLTAGE_ROOM_V,
).says(
    "open voltage {value:g} V leaves no room above the discharge voltage {pulse.discharge_voltage_v:g} V: the mean "
    "gap voltage cannot tell a spark from an open gap",
    "use more than {limit:g} V",
)
"""Rule 1: otherwise no pulse can be expected to ignite."""
PULSE_BOUNDS = (
    Bound(
        Code.PULSE_TIMES, "pulse.frequency_hz", le, lambda job: 1e6 * job.profile.pulse.duty / ON_TIME_MIN_US
    ).says(
        "on-time {pulse.on_time_us:.3g} µs at {value:g} Hz and duty {pulse.duty:g} is below "
        f"{ON_TIME_MIN_US:g} µs",
        "use at most {most} Hz, or a larger duty",
    ),
    Bound(
        Code.PULSE_TIMES,
        "pulse.frequency_hz",
        le,
        lambda job: 1e6 * (1.0 - job.profile.pulse.duty) / OFF_TIME_MIN_US,
    ).says(
        "off-time {pulse.off_time_us:.3g} µs at {value:g} Hz and duty {pulse.duty:g} is below "
        f"{OFF_TIME_MIN_US:g} µs: the channel does not de-ionise and burns on as an arc",
        "use at most {most} Hz, or a smaller duty",
    ),
    Bound(
        Code.FILTER, "servo.filter_hz", le, lambda job: job.profile.pulse.frequency_hz / FILTER_PERIODS
    ).says(
        "filter corner {value:g} Hz is above {limit:g} Hz (pulse frequency {pulse.frequency_hz:g} Hz / "
        f"{FILTER_PERIODS:g}): single pulses move the tool",
        "use at most {limit:g} Hz; 20 Hz is usual",
    ),
    Bound(
        Code.DISCHARGE_TIME,
        "pulse.discharge_us",
        lt,
        lambda job: job.profile.pulse.on_time_us - DISCHARGE_MARGIN_US,
        when=lambda profile: profile.pulse.mode == "isopulse" and profile.pulse.discharge_us is not None,
    ).says(
        f"discharge time {{value:g}} µs is not below on-time - {DISCHARGE_MARGIN_US:g} µs = {{limit:.4g}} µs",
        "use less than {most} µs",
    ),
)


def discharge_time(job: Job) -> Findings:
    """Rule 15: a discharge time is set in isopulse mode, and only there."""
    pulse, code = job.profile.pulse, Code.DISCHARGE_TIME
    if pulse.mode == "isopulse" and pulse.discharge_us is None:
        hint = f"add it, at least {DISCHARGE_MARGIN_US:g} µs below the on-time of {pulse.on_time_us:.4g} µs"
        yield Finding(code, "pulse.mode", "isopulse needs pulse.discharge_us, the burning time", hint)
    elif pulse.mode != "isopulse" and pulse.discharge_us is not None:
        message = f"discharge_us {pulse.discharge_us:g} has no meaning in {pulse.mode} mode"
        yield Finding(code, "pulse.discharge_us", message, 'remove it, or set mode = "isopulse"')


def reference_stated_once(job: Job) -> Findings:
    """Rule 16: the servo reference is given as a share or in volts, not twice and not never."""
    servo = job.profile.servo
    given = servo.model_fields_set & {"reference", "reference_v"}
    if len(given) == 2:
        both = f"reference {servo.reference:g} and reference_v {servo.reference_v:g} V"
        message = f"the servo reference is given twice: {both}"
        yield Finding(Code.REFERENCE_ONCE, "servo.reference_v", message, "remove one of the two")
    elif not given and not job.profile.adaptive.seek_reference:
        hint = "add reference = 0.80 to [servo], or seek_reference = true to [adaptive]"
        yield Finding(Code.REFERENCE_ONCE, "servo", "servo.reference is missing", hint)


def reference_window(job: Job) -> Findings:
    """Rule 1: the reference lies between an all-sparking and an all-open gap."""
    pulse, servo = job.profile.pulse, job.profile.servo
    low, unit = pulse.rho + REFERENCE_MARGIN, pulse.duty_voltage_v
    if low - ROUNDING <= servo.reference <= REFERENCE_MAX + ROUNDING:
        return
    key, given = "servo.reference", f"{servo.reference:g}"
    window = choice = f"{low:.2f} to {REFERENCE_MAX:.2f}"
    if servo.reference_v is not None:
        key, given = "servo.reference_v", f"{servo.reference_v:g} V (level {servo.reference:.3f})"
        choice = f"{low * unit:.2f} to {REFERENCE_MAX * unit:.2f} V"
    reason = "hardly a pulse ignites there"
    if servo.reference < low:
        reason = f"a gap that sparks at every pulse reads {pulse.rho:.2f}, so the servo would ask for shorts"
    message = f"servo reference {given} is outside {window}: {reason}"
    hint = f"choose {choice}; 0.80 is usual, 0.70 is fast, 0.88 finishes"
    yield Finding(Code.REFERENCE_WINDOW, key, message, hint)


def _energy_uj(pulse: Pulse) -> float:
    return pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.burning_time_us)


def pulse_energy(job: Job) -> Findings:
    """Rule 8: the pulse energy suits micro-EDM and the tool."""
    pulse, diameter_um = job.profile.pulse, job.profile.tool.diameter_um
    energy_uj, problem = _energy_uj(pulse), ""
    if not ENERGY_MIN_UJ <= energy_uj <= ENERGY_MAX_UJ:
        problem = f"is outside {ENERGY_MIN_UJ:g} to {ENERGY_MAX_UJ:g} µJ"
    elif diameter_um < FINE_TOOL_UM and energy_uj > FINE_TOOL_ENERGY_UJ:
        fine = f"below {FINE_TOOL_UM:g} µm at most {FINE_TOOL_ENERGY_UJ:g} µJ"
        problem = f"is high for a tool of {diameter_um:g} µm: {fine}"
    if problem:
        message = (
            f"pulse energy {pulse.discharge_voltage_v:g} V x {pulse.current_a:g} A x {pulse.burning_time_us:.4g} µs "
            f"= {energy_uj:.4g} µJ {problem}"
        )
        hint = "lower the current, or the duty, or raise the frequency"
        if energy_uj < ENERGY_MIN_UJ:
            hint = "raise the current or the duty"
        yield Finding(Code.PULSE_ENERGY, "pulse.current_a", message, hint)


def does_nothing(job: Job) -> Findings:
    """Rules 1 and 38: every pulse can ignite and has the energy that it takes to remove anything."""
    yield from ROOM_FOR_REFERENCE(job)
    regimes = {f"regime {one.name}: ": in_pulses(job.profile, one).pulse for one in job.profile.regimes}
    for number, (of, pulse) in enumerate({"": job.profile.pulse, **regimes}.items(), start=-1):
        if (energy_uj := _energy_uj(pulse)) < LEAST_ENERGY_UJ:
            message = (
                f"{of}a pulse of {energy_uj:.3g} µJ removes nothing: by the laws of the process it takes "
                f"{LEAST_ENERGY_UJ:g} µJ"
            )
            hint = "raise the current or the time that a discharge burns"
            yield Finding(Code.NO_REMOVAL, ("regimes", number) if of else "pulse.current_a", message, hint)


CURRENTS_A, ON_TIMES_US, VOLTAGES_V = (0.03, 1.0), (5.0, 300.0), (40.0, 100.0)
"""Where the laws of the process were compared with what is known (docs/virtual-machine.md)."""
LAW_ROUNDING = 1e-6
DOUBTFUL, CONTRADICTS = 2.0, 1.5
"""A value, or a factor of `[sim]`, that differs so much from that of the material may be another material's."""


def known_materials(job: Job) -> Findings:
    """Rule 34: something is known of how the materials erode."""
    for table, name, figure, key in (
        ("tool", job.profile.tool.material, "wear", "wear.expected_ratio"),
        ("work", job.profile.work.material, "removal", "work.removal_um3_per_uj"),
    ):
        known = [one for one in materials().values() if getattr(one, figure) is not None]
        if material(name) not in known:
            message = (
                f"nothing is known of how {name} erodes as {table}: what is not stated is taken from copper, and "
                "the virtual machine erodes it like copper"
            )
            hint = f"state {key}; known are {', '.join(one.symbol for one in known)}"
            yield Finding(Code.UNKNOWN_MATERIAL, f"{table}.material", message, hint)


def within_the_laws(job: Job) -> Findings:
    """Rule 36: forecasts and the virtual machine were made for such pulses."""
    pulse = job.profile.pulse
    for key, value, unit, (low, high) in (
        ("current_a", pulse.current_a, "A", CURRENTS_A),
        ("duty", pulse.on_time_us, "µs of on-time", ON_TIMES_US),
        ("open_voltage_v", pulse.open_voltage_v, "V", VOLTAGES_V),
    ):
        if not low * (1.0 - LAW_ROUNDING) <= value <= high * (1.0 + LAW_ROUNDING):
            message = (
                f"{value:.4g} {unit} lies outside {low:g} to {high:g}, where the laws of the process were checked; "
                "forecasts and the virtual machine extrapolate"
            )
            hint = "rely on touches, not on forecasts or virtual runs"
            yield Finding(Code.BEYOND_LAWS, f"pulse.{key}", message, hint)


def stated_agrees(job: Job) -> Findings:
    """Rule 39: removal and wear that are stated are those of the materials and pulses that are named."""
    profile, depth_um = job.profile, usual_depth_um(job.profile)
    wear_ratio = expected_wear_ratio(profile, depth_um, expected_side_gap_um(profile))
    removal = expected_gap(profile, depth_um).removal_um3_per_uj
    for table, key, expected in (
        ("wear", "expected_ratio", wear_ratio),
        ("work", "removal_um3_per_uj", removal),
    ):
        given = getattr(getattr(profile, table), key)
        is_stated = key in getattr(profile, table).model_fields_set
        if is_stated and not expected / DOUBTFUL <= given <= expected * DOUBTFUL:
            message = (
                f"{table}.{key} is set to {given:.3g}; {expected:.3g} is expected for {profile.tool.material} on "
                f"{profile.work.material}, {profile.pulse.polarity}, with {profile.pulse.current_a:g} A for "
                f"{profile.pulse.on_time_us:.3g} µs"
            )
            hint = "leave it out, or keep it where it was measured with these"
            yield Finding(Code.STATED_CONTRADICTS, f"{table}.{key}", message, hint)


def sim_agrees(profile: Profile, sim: SimSettings) -> Findings:
    """Rule 35: the virtual machine has the materials of the profile."""
    discharge_v = profile.pulse.discharge_voltage_v
    if abs(discharge_v - sim.discharge_v) > LAW_ROUNDING:
        message = (
            f"discharges burn at {discharge_v:g} V by the profile, at sim.discharge_v = {sim.discharge_v:g} V on "
            "the virtual machine"
        )
        hint = "set sim.discharge_v too, or leave it out"
        yield Finding(Code.SIM_CONTRADICTS, "pulse.discharge_voltage_v", message, hint)
    for key, given, expected, name in (
        ("work_removal", sim.work_removal, of_work(profile).factor, profile.work.material),
        ("tool_wear", sim.tool_wear, of_tool(profile).factor, profile.tool.material),
    ):
        if given is not None and not expected / CONTRADICTS <= given <= expected * CONTRADICTS:
            message = f"sim.{key} = {given:g} is not that of {name}, {expected:g}, which forecasts assume"
            hint = "leave it out, or name the material that it is"
            yield Finding(Code.SIM_CONTRADICTS, f"sim.{key}", message, hint)


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
    """Rules 2, 10 and 30: offset, wear by the holes before, feed and a reserve fit into the stroke; no coarse Z."""
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
