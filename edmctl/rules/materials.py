"""Rules of materials: what nothing is known of, and a virtual machine that is told otherwise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.forecasts.erosion import of_tool, of_work
from edmctl.process.materials import material, materials
from edmctl.profile.findings import Code, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from edmctl.forecasts.forecast import Job
    from edmctl.profile.model import Profile
    from edmctl.profile.profile_file import SimSettings

CURRENTS_A, ON_TIMES_US, VOLTAGES_V = (0.03, 1.0), (5.0, 300.0), (40.0, 100.0)
"""Where the laws of the process were compared with what is known (docs/virtual-machine.md)."""
ROUNDING = 1e-6
CONTRADICTS = 1.5
"""A factor of `[sim]` that is so many times that of the material, or as much less, is another material's."""


def known_materials(job: Job) -> Iterator[Finding]:
    """Rule 34: something is known of how the materials erode."""
    tool, work = material(job.profile.tool.material), material(job.profile.work.material)
    if tool is None or tool.wear is None:
        known = ", ".join(symbol for symbol, found in materials().items() if found.wear is not None)
        yield _unknown("tool", job.profile.tool.material, "wear.expected_ratio", known)
    if work is None or work.removal is None:
        known = ", ".join(symbol for symbol, found in materials().items() if found.removal is not None)
        yield _unknown("work", job.profile.work.material, "work.removal_um3_per_uj", known)


def _unknown(table: str, name: str, stated: str, known: str) -> Finding:
    return Finding(
        Code.UNKNOWN_MATERIAL,
        (table, "material"),
        f"nothing is known of how {name} erodes as {table}: what is not stated is taken from copper, and the "
        "virtual machine erodes it like copper",
        f"state {stated}; known are {known}",
    )


def within_the_laws(job: Job) -> Iterator[Finding]:
    """Rule 36: forecasts and the virtual machine were made for such pulses."""
    pulse = job.profile.pulse
    for key, value, unit, (low, high) in (
        ("current_a", pulse.current_a, "A", CURRENTS_A),
        ("duty", pulse.on_time_us, "µs of on-time", ON_TIMES_US),
        ("open_voltage_v", pulse.open_voltage_v, "V", VOLTAGES_V),
    ):
        if not low * (1.0 - ROUNDING) <= value <= high * (1.0 + ROUNDING):
            yield Finding(
                Code.BEYOND_LAWS,
                ("pulse", key),
                f"{value:.4g} {unit} lies outside {low:g} to {high:g}, where the laws of the process were "
                "looked at; "
                "forecasts and the virtual machine go on by the same formulas, and nobody knows how far",
                "rely on touches, not on forecasts or virtual runs",
            )


def sim_agrees(profile: Profile, sim: SimSettings) -> Iterator[Finding]:
    """Rule 35: the virtual machine has the materials of the profile."""
    pairs = (
        ("work_removal", sim.work_removal, of_work(profile).factor, profile.work.material),
        ("tool_wear", sim.tool_wear, of_tool(profile).factor, profile.tool.material),
    )
    for key, given, expected, name in pairs:
        if given is None or expected / CONTRADICTS <= given <= expected * CONTRADICTS:
            continue
        yield Finding(
            Code.SIM_CONTRADICTS,
            ("sim", key),
            f"sim.{key} = {given:g} is not that of {name}, {expected:g}: the virtual machine has another material "
            "than forecasts and the host go by",
            "leave it out, or name the material that it is",
        )
