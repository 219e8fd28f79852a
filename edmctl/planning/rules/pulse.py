"""Cross-field rules of the generator, the voltage reference and the materials."""

from __future__ import annotations

from collections.abc import Iterator
from operator import gt, le, lt

from edmctl.failures import Code
from edmctl.planning.erosion import (
    expected_gap,
    expected_side_gap_um,
    expected_wear_ratio,
    in_pulses,
    of_tool,
    of_work,
    usual_depth_um,
)
from edmctl.planning.forecast import Job
from edmctl.planning.rules.bound import Bound, Conflict
from edmctl.process.discharge import pulse_energy_uj
from edmctl.process.erosion import LAW, material, materials
from edmctl.profile.findings import REFERENCE_MARGIN, REFERENCE_MAX, Finding
from edmctl.profile.model import Profile, SimSettings

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
PULSE_TIMES = (
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
)
"""Rule 9: on-time long enough to ignite, off-time long enough to de-ionise."""
FILTER_CORNER = Bound(
    Code.FILTER, "servo.filter_hz", le, lambda job: job.profile.pulse.frequency_hz / FILTER_PERIODS
).says(
    "filter corner {value:g} Hz is above {limit:g} Hz (pulse frequency {pulse.frequency_hz:g} Hz / "
    f"{FILTER_PERIODS:g}): single pulses move the tool",
    "use at most {limit:g} Hz; 20 Hz is usual",
)
"""Rule 13: the low-pass averages enough pulses."""
DISCHARGE_TIME = (
    Conflict(
        Code.DISCHARGE_TIME,
        "pulse.mode",
        lambda profile: profile.pulse.mode == "isopulse" and profile.pulse.discharge_us is None,
    ).says(
        "isopulse needs the burning time of a discharge, and pulse.discharge_us is not given",
        f"add discharge_us, at least {DISCHARGE_MARGIN_US:g} µs below the on-time of {{pulse.on_time_us:.4g}} µs",
    ),
    Conflict(
        Code.DISCHARGE_TIME,
        "pulse.discharge_us",
        lambda profile: profile.pulse.mode != "isopulse" and profile.pulse.discharge_us is not None,
    ).says(
        "discharge_us {pulse.discharge_us:g} has no meaning in {pulse.mode} mode",
        'remove it, or set mode = "isopulse"',
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
"""Rule 15: a set discharge time goes with isopulse, and fits into the on-time."""


def reference_window(job: Job) -> Iterator[Finding]:
    """Rule 1: the reference lies between an all-sparking and an all-open gap."""
    if wrong := list(ROOM_FOR_REFERENCE(job)):
        yield from wrong
        return
    pulse, servo = job.profile.pulse, job.profile.servo
    low, unit = pulse.rho + REFERENCE_MARGIN, pulse.duty_voltage_v
    if low - ROUNDING <= servo.reference <= REFERENCE_MAX + ROUNDING:
        return
    volts = servo.reference_v is not None
    shown = f"{servo.reference_v:g} V (level {servo.reference:.3f})" if volts else f"{servo.reference:g}"
    window = f"{low:.2f} to {REFERENCE_MAX:.2f}"
    in_volts = f"{low * unit:.2f} to {REFERENCE_MAX * unit:.2f} V"
    reason = (
        f"a gap that sparks at every pulse reads {pulse.rho:.2f}, so the servo would ask for shorts"
        if servo.reference < low
        else "hardly a pulse ignites there"
    )
    message = f"servo reference {shown} is outside {window}: {reason}"
    hint = f"choose {in_volts if volts else window}; 0.80 is usual, 0.70 is fast, 0.88 finishes"
    yield Finding(Code.REFERENCE_WINDOW, ("servo", "reference_v" if volts else "reference"), message, hint)


def pulse_energy(job: Job) -> Iterator[Finding]:
    """Rule 8: the pulse energy suits micro-EDM and the tool."""
    pulse, tool = job.profile.pulse, job.profile.tool
    energy_uj = pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.burning_time_us)
    made_of = (
        f"{pulse.discharge_voltage_v:g} V x {pulse.current_a:g} A x {pulse.burning_time_us:.4g} µs "
        f"= {energy_uj:.4g} µJ"
    )
    problem, hint = "", "lower the current, or the duty, or raise the frequency"
    if not ENERGY_MIN_UJ <= energy_uj <= ENERGY_MAX_UJ:
        problem = f"is outside {ENERGY_MIN_UJ:g} to {ENERGY_MAX_UJ:g} µJ"
        hint = hint if energy_uj > ENERGY_MAX_UJ else "raise the current or the duty"
    elif tool.diameter_um < FINE_TOOL_UM and energy_uj > FINE_TOOL_ENERGY_UJ:
        problem = (
            f"is high for a tool of {tool.diameter_um:g} µm (below {FINE_TOOL_UM:g} µm: at most "
            f"{FINE_TOOL_ENERGY_UJ:g} µJ)"
        )
    if problem:
        yield Finding(Code.PULSE_ENERGY, ("pulse", "current_a"), f"pulse energy {made_of} {problem}", hint)


def does_nothing(job: Job) -> Iterator[Finding]:
    """Rules 1 and 38, without which nothing can be expected of the pulses."""
    yield from ROOM_FOR_REFERENCE(job)
    yield from removes_nothing(job.profile)


def removes_nothing(profile: Profile) -> Iterator[Finding]:
    """Rule 38: a pulse has the energy that it takes to remove anything."""
    for number, regime in enumerate((None, *profile.regimes), start=-1):
        pulse, of = profile.pulse, ""
        path: tuple[str | int, ...] = ("pulse", "current_a")
        if regime is not None:
            pulse, path, of = in_pulses(profile, regime).pulse, ("regimes", number), f"regime {regime.name}: "
        energy_uj = pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.burning_time_us)
        if energy_uj < LEAST_ENERGY_UJ:
            by_law = f"by the laws of the process it takes {LEAST_ENERGY_UJ:g} µJ"
            message = f"{of}a pulse of {energy_uj:.3g} µJ removes nothing: {by_law}"
            hint = "raise the current or the time that a discharge burns"
            yield Finding(Code.NO_REMOVAL, path, message, hint)


CURRENTS_A, ON_TIMES_US, VOLTAGES_V = (0.03, 1.0), (5.0, 300.0), (40.0, 100.0)
"""Where the laws of the process were compared with what is known (docs/virtual-machine.md)."""
LAW_ROUNDING = 1e-6
DOUBTFUL = 2.0
"""What is stated and is so many times what is expected, or as much less, may be that of other materials."""
CONTRADICTS = 1.5
"""A factor of `[sim]` that is so many times that of the material, or as much less, is another material's."""


def known_materials(job: Job) -> Iterator[Finding]:
    """Rule 34: something is known of how the materials erode."""
    for table, name, figure, key in (
        ("tool", job.profile.tool.material, "wear", "wear.expected_ratio"),
        ("work", job.profile.work.material, "removal", "work.removal_um3_per_uj"),
    ):
        known = [found for found in materials().values() if getattr(found, figure) is not None]
        if material(name) in known:
            continue
        message = (
            f"nothing is known of how {name} erodes as {table}: what is not stated is taken from copper, and the "
            "virtual machine erodes it like copper"
        )
        hint = f"state {key}; known are {', '.join(found.symbol for found in known)}"
        yield Finding(Code.UNKNOWN_MATERIAL, (table, "material"), message, hint)


def within_the_laws(job: Job) -> Iterator[Finding]:
    """Rule 36: forecasts and the virtual machine were made for such pulses."""
    pulse = job.profile.pulse
    for key, value, unit, (low, high) in (
        ("current_a", pulse.current_a, "A", CURRENTS_A),
        ("duty", pulse.on_time_us, "µs of on-time", ON_TIMES_US),
        ("open_voltage_v", pulse.open_voltage_v, "V", VOLTAGES_V),
    ):
        if not low * (1.0 - LAW_ROUNDING) <= value <= high * (1.0 + LAW_ROUNDING):
            message = (
                f"{value:.4g} {unit} lies outside {low:g} to {high:g}, where the laws of the process were looked "
                "at; forecasts and the virtual machine go on by the same formulas, and nobody knows how far"
            )
            hint = "rely on touches, not on forecasts or virtual runs"
            yield Finding(Code.BEYOND_LAWS, ("pulse", key), message, hint)


def stated_agrees(profile: Profile) -> Iterator[Finding]:
    """Rule 39: removal and wear that are stated are those of the materials and pulses that are named."""
    depth_um = usual_depth_um(profile)
    gap = expected_gap(profile, depth_um)
    of = (
        f"{profile.tool.material} on {profile.work.material}, {profile.pulse.polarity}, with "
        f"{profile.pulse.current_a:g} A for {profile.pulse.on_time_us:.3g} µs"
    )
    stated = {}
    if "expected_ratio" in profile.wear.model_fields_set:
        ratio = expected_wear_ratio(profile, depth_um, expected_side_gap_um(profile))
        stated["wear", "expected_ratio"] = profile.wear.expected_ratio, ratio
    if "removal_um3_per_uj" in profile.work.model_fields_set:
        stated["work", "removal_um3_per_uj"] = profile.work.removal_um3_per_uj, gap.removal_um3_per_uj
    for path, (given, expected) in stated.items():
        if not expected / DOUBTFUL <= given <= expected * DOUBTFUL:
            message = f"{'.'.join(path)} = {given:.3g} is stated, but {of} let expect {expected:.3g}"
            hint = "leave it out, or keep it where it was measured with these"
            yield Finding(Code.STATED_CONTRADICTS, path, message, hint)


def sim_agrees(profile: Profile, sim: SimSettings) -> Iterator[Finding]:
    """Rule 35: the virtual machine has the materials of the profile."""
    pairs = (
        ("work_removal", sim.work_removal, of_work(profile).factor, profile.work.material),
        ("tool_wear", sim.tool_wear, of_tool(profile).factor, profile.tool.material),
    )
    discharge_v = profile.pulse.discharge_voltage_v
    if abs(discharge_v - sim.discharge_v) > LAW_ROUNDING:
        stated = f"at sim.discharge_v = {sim.discharge_v:g} V on the virtual machine"
        message = f"discharges burn at {discharge_v:g} V by the profile, {stated}"
        hint = "set sim.discharge_v too, or leave it out"
        yield Finding(Code.SIM_CONTRADICTS, ("pulse", "discharge_voltage_v"), message, hint)
    for key, given, expected, name in pairs:
        if given is None or expected / CONTRADICTS <= given <= expected * CONTRADICTS:
            continue
        other = "the virtual machine has another material than forecasts and the host go by"
        message = f"sim.{key} = {given:g} is not that of {name}, {expected:g}: {other}"
        hint = "leave it out, or name the material that it is"
        yield Finding(Code.SIM_CONTRADICTS, ("sim", key), message, hint)
