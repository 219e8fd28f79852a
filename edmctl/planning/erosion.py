"""What materials and pulses let expect of removal, wear, gaps and roughness, where a profile does not state it."""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass, replace
from edmctl.process.discharge import hole_area_um2, pulse_energy_uj, tool_area_um2
from edmctl.process.erosion import GAP_LAW, material, roughness_ra_um, side_gap_um
from edmctl.process.steady_gap import GapRecipe, SteadyGap, steady_gap
from edmctl.profile.findings import REFERENCE_MARGIN, REFERENCE_MAX
from edmctl.profile.model import Profile

LAW_U_REL = 0.10
"""Relative standard uncertainty of the laws themselves, where everything else is known [assumed]."""
ARC_ROOM = 0.6  # share of the arcs that stop a job: an adaptive reference keeps no more
LEAST_ARCS = 0.01  # a clean gap has so many: fewer cannot be kept
LEVELS = 40
USUAL_FEED_PER_DEPTH = 1.3
MEAN_DEPTH_SHARE = 1.0 / math.sqrt(3.0)
"""Share of a hole's depth at which its flushing is what it is on average: it goes with the square of the depth."""


@dataclass(frozen=True, slots=True)
class Erodes:
    """Erosion over that of copper, and its relative standard uncertainty."""

    factor: float
    u_rel: float


UNKNOWN = Erodes(1.0, 0.5)  # a material that nothing is known of: as copper, or anything


def of_tool(profile: Profile) -> Erodes:
    """How the tool wears."""
    found = material(profile.tool.material)
    return UNKNOWN if found is None or found.wear is None else Erodes(found.wear, found.u_rel)


def of_work(profile: Profile) -> Erodes:
    """How the work is removed."""
    found = material(profile.work.material)
    return UNKNOWN if found is None or found.removal is None else Erodes(found.removal, found.u_rel)


def gap_recipe(profile: Profile, depth_um: float) -> GapRecipe:
    """Return what of a profile the gap depends on."""
    pulse = profile.pulse
    return GapRecipe(
        on_time_us=pulse.on_time_us,
        off_time_us=pulse.off_time_us,
        open_voltage_v=pulse.open_voltage_v,
        current_a=pulse.current_a,
        level_s=profile.servo.reference,
        diameter_um=profile.tool.diameter_um,
        discharge_voltage_v=pulse.discharge_voltage_v,
        longest_us=pulse.burning_time_us,
        tool_negative=pulse.polarity == "tool-negative",
        work_removal=of_work(profile).factor,
        tool_wear=of_tool(profile).factor,
        jump_clearing_hz=_jump_clearing_hz(profile, depth_um),
    )


def _jump_clearing_hz(profile: Profile, depth_um: float) -> float:
    """Return how often jumps replace the oil in the gap: each dilutes the gap and its annulus."""
    jump = profile.jump
    if jump.mode == "off":
        return 0.0
    tool_um2 = tool_area_um2(profile.tool.diameter_um)
    annulus_um2 = hole_area_um2(profile.tool.diameter_um, expected_side_gap_um(profile)) - tool_um2
    strokes = tool_um2 * jump.height_um / (annulus_um2 * depth_um + 3.0 * tool_um2)
    return -math.expm1(-strokes) / jump.period_s


def expected_gap(profile: Profile, depth_um: float) -> SteadyGap:
    """The gap's state on average down to a depth."""
    return steady_gap(gap_recipe(profile, depth_um), MEAN_DEPTH_SHARE * depth_um)


def expected_side_gap_um(profile: Profile) -> float:
    """Gap between tool and wall."""
    pulse = profile.pulse
    full_uj = pulse_energy_uj(pulse.discharge_voltage_v, pulse.current_a, pulse.burning_time_us)
    return side_gap_um(GAP_LAW, pulse.open_voltage_v, full_uj)


def expected_ra_um(profile: Profile, depth_um: float) -> float:
    """Roughness Ra of the floor."""
    gap = expected_gap(profile, depth_um)
    return roughness_ra_um(gap.crater_um3, gap.arc_share / gap.spark_share)


def expected_wear_ratio(profile: Profile, depth_um: float, side_um: float) -> float:
    """Length of the tool lost per depth."""
    diameter_um = profile.tool.diameter_um
    areas = hole_area_um2(diameter_um, side_um) / tool_area_um2(diameter_um)
    return expected_gap(profile, depth_um).wear_ratio * areas


def with_expected_erosion(profile: Profile) -> Profile:
    """Return a copy with unstated removal, wear and gaps as expected of materials and pulses."""
    depth_um = usual_depth_um(profile)
    gap = expected_gap(profile, depth_um)
    work_u_rel = math.hypot(LAW_U_REL, of_work(profile).u_rel)
    filled = _filled(
        profile,
        "work",
        removal_um3_per_uj=gap.removal_um3_per_uj,
        removal_u_rel=work_u_rel,
        side_gap_um=expected_side_gap_um(profile),
    )
    if "expected_ratio" not in profile.wear.model_fields_set:
        ratio = expected_wear_ratio(profile, depth_um, filled.work.side_gap_um)
        ratio_u_rel = math.hypot(work_u_rel, of_tool(profile).u_rel)
        filled = _filled(filled, "wear", expected_ratio=ratio, ratio_u_rel=ratio_u_rel)
    return _filled(filled, "measure", expected_gap_um=gap.gap_um)


def _filled(profile: Profile, table: str, **values: float) -> Profile:
    given = getattr(profile, table).model_fields_set
    return profile.having(table, **{key: value for key, value in values.items() if key not in given})


def with_sought_reference(profile: Profile) -> Profile:
    """Fill in where an adaptive reference begins, and the arcs that it keeps: those of the most removal expected.

    The reference of the most removal depends on flushing and depth, but its share of arcs hardly does: keeping that
    share costs at most 4 % of the removal if the oil clears four times faster or slower (decision 0043).
    """
    pulse, most_arcs = profile.pulse, ARC_ROOM * profile.limits.arc_ratio
    depth_um = usual_depth_um(profile)
    recipe = gap_recipe(profile, depth_um)
    low = pulse.rho + REFERENCE_MARGIN
    high = max(low, min(REFERENCE_MAX, profile.adaptive.reference_max))
    levels = [low + i * (high - low) / LEVELS for i in range(LEVELS + 1)]
    gaps = [steady_gap(replace(recipe, level_s=level), MEAN_DEPTH_SHARE * depth_um) for level in levels]
    calm = [i for i, gap in enumerate(gaps) if gap.arc_share <= most_arcs] or [LEVELS]
    best = max(calm, key=lambda i: gaps[i].removal_um3_s)
    filled = profile.having("servo", reference=round(levels[best], 3))
    if profile.adaptive.arc_target is not None:
        return filled
    arcs = max(gaps[best].arc_share + gaps[best].short_share, LEAST_ARCS)
    return filled.having("adaptive", arc_target=round(arcs, 4))


def usual_depth_um(profile: Profile) -> float:
    """About how deep the job goes: what the removal that a profile states is an average of."""
    target = profile.target
    if target.kind == "through":
        return profile.work.thickness_um
    return target.depth_um if target.kind == "depth" else target.feed_um / USUAL_FEED_PER_DEPTH
