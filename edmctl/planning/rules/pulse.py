"""Cross-field rules of the generator and the voltage reference."""

from __future__ import annotations

from collections.abc import Iterator
from operator import gt, le, lt

from edmctl.failures import Code
from edmctl.planning.forecast import Job
from edmctl.planning.regimes import in_pulses
from edmctl.planning.rules.bound import Bound, Conflict
from edmctl.process.discharge import pulse_energy_uj
from edmctl.process.erosion import LAW
from edmctl.profile.findings import REFERENCE_MARGIN, REFERENCE_MAX, Finding
from edmctl.profile.model import Profile

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
            yield Finding(
                Code.NO_REMOVAL,
                path,
                f"{of}a pulse of {energy_uj:.3g} µJ removes nothing: by the laws of the process it takes "
                f"{LEAST_ENERGY_UJ:g} µJ",
                "raise the current or the time that a discharge burns",
            )
