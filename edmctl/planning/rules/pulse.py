"""Cross-field rules of the generator, the voltage reference and the materials."""

from __future__ import annotations

from operator import gt, le, lt

from edmctl.failures import Code
from edmctl.planning.erosion import (
    REFERENCE_MARGIN,
    REFERENCE_MAX,
    expected_gap,
    expected_side_gap_um,
    expected_wear_ratio,
    in_pulses,
    of_tool,
    of_work,
    usual_depth_um,
)
from edmctl.planning.forecast import Job
from edmctl.planning.rules.bound import Bound, Finding, Findings
from edmctl.process.discharge import pulse_energy_uj
from edmctl.process.erosion import LAW, material, materials
from edmctl.profile.model import Profile, Pulse, SimSettings

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
BOUNDS = (
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
