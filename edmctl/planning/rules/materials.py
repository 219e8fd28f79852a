"""Rules of materials: what nothing is known of, and a virtual machine that is told otherwise."""

from __future__ import annotations

from collections.abc import Iterator

from edmctl.failures import Code
from edmctl.planning.erosion import (
    expected_gap,
    expected_side_gap_um,
    expected_wear_ratio,
    of_tool,
    of_work,
    usual_depth_um,
)
from edmctl.planning.forecast import Job
from edmctl.process.erosion import material, materials
from edmctl.profile.findings import Finding
from edmctl.profile.model import Profile, SimSettings

CURRENTS_A, ON_TIMES_US, VOLTAGES_V = (0.03, 1.0), (5.0, 300.0), (40.0, 100.0)
"""Where the laws of the process were compared with what is known (docs/virtual-machine.md)."""
ROUNDING = 1e-6
DOUBTFUL = 2.0
"""What is stated and is so many times what is expected, or as much less, may be that of other materials."""
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
            yield Finding(
                Code.STATED_CONTRADICTS,
                path,
                f"{'.'.join(path)} = {given:.3g} is stated, but {of} let expect {expected:.3g}",
                "leave it out, or keep it where it was measured with these",
            )


def sim_agrees(profile: Profile, sim: SimSettings) -> Iterator[Finding]:
    """Rule 35: the virtual machine has the materials of the profile."""
    pairs = (
        ("work_removal", sim.work_removal, of_work(profile).factor, profile.work.material),
        ("tool_wear", sim.tool_wear, of_tool(profile).factor, profile.tool.material),
    )
    discharge_v = profile.pulse.discharge_voltage_v
    if abs(discharge_v - sim.discharge_v) > ROUNDING:
        yield Finding(
            Code.SIM_CONTRADICTS,
            ("pulse", "discharge_voltage_v"),
            f"discharges burn at {discharge_v:g} V by the profile, at sim.discharge_v = {sim.discharge_v:g} V on "
            "the virtual machine",
            "set sim.discharge_v too, or leave it out",
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
