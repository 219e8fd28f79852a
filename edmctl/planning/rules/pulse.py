"""Cross-field rules of the generator and the voltage reference."""

from __future__ import annotations

from collections.abc import Iterator

from edmctl.planning.forecast import Job
from edmctl.planning.regimes import in_pulses
from edmctl.process.discharge import pulse_energy_uj
from edmctl.process.erosion import LAW
from edmctl.profile.findings import REFERENCE_MARGIN, REFERENCE_MAX, Code, Finding, rounded_down
from edmctl.profile.model import Profile

ROUNDING = 1e-9
"""A reference written as the very limit passes, though 0.55 + 0.05 is not 0.60 in binary."""
VOLTAGE_ROOM_V = 5.0
"""Least difference between open and discharge voltage that leaves the servo something to regulate."""
ENERGY_MIN_UJ, ENERGY_MAX_UJ = 0.1, 2000.0
LEAST_ENERGY_UJ = 1.1 * LAW.threshold_uj
"""Discharges ignite with some delay: a pulse that just reaches the threshold removes nothing."""
FINE_TOOL_UM, FINE_TOOL_ENERGY_UJ = 100.0, 200.0
ON_TIME_MIN_US, OFF_TIME_MIN_US = 5.0, 20.0
FILTER_PERIODS = 20.0
"""Pulses that the low-pass must average at least."""
DISCHARGE_MARGIN_US = 10.0


def room_for_reference(profile: Profile) -> Iterator[Finding]:
    """Rule 1: the open voltage is above the discharge voltage; otherwise no pulse can be expected to ignite."""
    pulse = profile.pulse
    if pulse.open_voltage_v <= pulse.discharge_voltage_v + VOLTAGE_ROOM_V:
        yield Finding(
            Code.REFERENCE_WINDOW,
            ("pulse", "open_voltage_v"),
            f"open voltage {pulse.open_voltage_v:g} V leaves no room above the discharge voltage "
            f"{pulse.discharge_voltage_v:g} V: the mean gap voltage cannot tell a spark from an open gap",
            f"use more than {pulse.discharge_voltage_v + VOLTAGE_ROOM_V:g} V",
        )


def reference_window(job: Job) -> Iterator[Finding]:
    """Rule 1: the reference lies between an all-sparking and an all-open gap."""
    if wrong := list(room_for_reference(job.profile)):
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
    yield Finding(
        Code.REFERENCE_WINDOW,
        ("servo", "reference_v" if volts else "reference"),
        f"servo reference {shown} is outside {window}: {reason}",
        f"choose {in_volts if volts else window}; 0.80 is usual, 0.70 is fast, 0.88 finishes",
    )


def pulse_energy(job: Job) -> Iterator[Finding]:
    """Rule 8: the pulse energy suits micro-EDM and the tool."""
    pulse, tool = job.profile.pulse, job.profile.tool
    energy_uj = pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.burning_time_us)
    made_of = (
        f"{pulse.discharge_voltage_v:g} V x {pulse.current_a:g} A x {pulse.burning_time_us:.4g} µs "
        f"= {energy_uj:.4g} µJ"
    )
    lower = "lower the current, or the duty, or raise the frequency"
    if not ENERGY_MIN_UJ <= energy_uj <= ENERGY_MAX_UJ:
        yield Finding(
            Code.PULSE_ENERGY,
            ("pulse", "current_a"),
            f"pulse energy {made_of} is outside {ENERGY_MIN_UJ:g} to {ENERGY_MAX_UJ:g} µJ",
            lower if energy_uj > ENERGY_MAX_UJ else "raise the current or the duty",
        )
    elif tool.diameter_um < FINE_TOOL_UM and energy_uj > FINE_TOOL_ENERGY_UJ:
        yield Finding(
            Code.PULSE_ENERGY,
            ("pulse", "current_a"),
            f"pulse energy {made_of} is high for a tool of {tool.diameter_um:g} µm "
            f"(below {FINE_TOOL_UM:g} µm: at most {FINE_TOOL_ENERGY_UJ:g} µJ)",
            lower,
        )


def does_nothing(profile: Profile) -> Iterator[Finding]:
    """Rules 1 and 38, without which nothing can be expected of the pulses."""
    yield from room_for_reference(profile)
    yield from removes_nothing(profile)


def removes_nothing(profile: Profile) -> Iterator[Finding]:
    """Rule 38: a pulse has the energy that it takes to remove anything."""
    for number, regime in enumerate((None, *profile.regimes), start=-1):
        pulse, of = profile.pulse, ""
        path: tuple[str | int, ...] = ("pulse", "current_a")
        if regime is not None:
            pulse, path, of = in_pulses(profile, regime).pulse, ("regimes", number), f"regime {regime.name}: "
        energy_uj = pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.burning_time_us)
        if energy_uj < LEAST_ENERGY_UJ:
            yield Finding(
                Code.NO_REMOVAL,
                path,
                f"{of}a pulse of {energy_uj:.3g} µJ removes nothing: by the laws of the process it takes "
                f"{LEAST_ENERGY_UJ:g} µJ",
                "raise the current or the time that a discharge burns",
            )


def pulse_times(job: Job) -> Iterator[Finding]:
    """Rule 9: on-time long enough to ignite, off-time long enough to de-ionise."""
    pulse = job.profile.pulse
    setting = f"at {pulse.frequency_hz:g} Hz and duty {pulse.duty:g}"
    if pulse.on_time_us < ON_TIME_MIN_US:
        yield Finding(
            Code.PULSE_TIMES,
            ("pulse", "frequency_hz"),
            f"on-time {pulse.on_time_us:.3g} µs {setting} is below {ON_TIME_MIN_US:g} µs",
            f"use at most {rounded_down(1e6 * pulse.duty / ON_TIME_MIN_US)} Hz, or a larger duty",
        )
    if pulse.off_time_us < OFF_TIME_MIN_US:
        yield Finding(
            Code.PULSE_TIMES,
            ("pulse", "frequency_hz"),
            f"off-time {pulse.off_time_us:.3g} µs {setting} is below {OFF_TIME_MIN_US:g} µs: "
            "the channel does not de-ionise and burns on as an arc",
            f"use at most {rounded_down(1e6 * (1.0 - pulse.duty) / OFF_TIME_MIN_US)} Hz, or a smaller duty",
        )


def filter_corner(job: Job) -> Iterator[Finding]:
    """Rule 13: the low-pass averages enough pulses."""
    pulse, servo = job.profile.pulse, job.profile.servo
    limit_hz = pulse.frequency_hz / FILTER_PERIODS
    if servo.filter_hz > limit_hz:
        yield Finding(
            Code.FILTER,
            ("servo", "filter_hz"),
            f"filter corner {servo.filter_hz:g} Hz is above {limit_hz:g} Hz "
            f"(pulse frequency {pulse.frequency_hz:g} Hz / {FILTER_PERIODS:g}): single pulses move the tool",
            f"use at most {limit_hz:g} Hz; 20 Hz is usual",
        )


def discharge_time(job: Job) -> Iterator[Finding]:
    """Rule 15: a set discharge time goes with isopulse, and fits into the on-time."""
    pulse = job.profile.pulse
    limit_us = pulse.on_time_us - DISCHARGE_MARGIN_US
    if pulse.mode == "isopulse" and pulse.discharge_us is None:
        yield Finding(
            Code.DISCHARGE_TIME,
            ("pulse", "mode"),
            "isopulse needs the burning time of a discharge, and pulse.discharge_us is not given",
            f"add discharge_us, below {limit_us:.4g} µs, to [pulse]",
        )
    elif pulse.mode != "isopulse" and pulse.discharge_us is not None:
        yield Finding(
            Code.DISCHARGE_TIME,
            ("pulse", "discharge_us"),
            f"discharge_us {pulse.discharge_us:g} has no meaning in {pulse.mode} mode",
            'remove it, or set mode = "isopulse"',
        )
    elif pulse.discharge_us is not None and pulse.discharge_us >= limit_us:
        yield Finding(
            Code.DISCHARGE_TIME,
            ("pulse", "discharge_us"),
            f"discharge time {pulse.discharge_us:g} µs is not below on-time - {DISCHARGE_MARGIN_US:g} µs "
            f"= {limit_us:.4g} µs",
            f"use less than {rounded_down(limit_us)} µs",
        )
