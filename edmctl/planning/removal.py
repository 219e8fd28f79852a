"""What materials and pulses remove and wear, how fast, and how the tool moves over the gap meanwhile.

That motion is the limit cycle of the relay servo, and electrode jumps that flush. A relay that flips an
integrator's slope after a dead time L makes a triangle of half-amplitude slope x L and period 4 L (exact for an
ideal integrator).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import NamedTuple

from edmctl.dataclasses import dataclass, replace
from edmctl.process.erosion import (
    GAP_LAW,
    SURFACE_UM,
    hole_area_um2,
    material,
    pulse_energy_uj,
    roughness_ra_um,
    side_gap_um,
    tool_area_um2,
)
from edmctl.process.steady_gap import GapRecipe, SteadyGap, steady_gap
from edmctl.profile.model import Profile, Regime
from edmctl.profile.setup import Setup

LAW_U_REL = 0.10
"""Relative standard uncertainty of the laws themselves, where everything else is known [assumed]."""
ARC_ROOM = 0.6  # share of the arcs that stop a job: an adaptive reference keeps no more
LEAST_ARCS = 0.01  # a clean gap has so many: fewer cannot be kept
LEVELS = 40
REFERENCE_MARGIN, REFERENCE_MAX = 0.05, 0.95
"""Least servo reference above the level of a gap that sparks at every pulse, and the highest."""
USUAL_FEED_PER_DEPTH = 1.3
MEAN_DEPTH_SHARE = 1.0 / math.sqrt(3.0)
"""Share of a hole's depth at which its flushing is what it is on average: it goes with the square of the depth."""


class Erodes(NamedTuple):
    """Erosion over that of copper, and its relative standard uncertainty; by default of an unknown material."""

    factor: float = 1.0
    u_rel: float = 0.5


def of_tool(profile: Profile) -> Erodes:
    """How the tool wears."""
    known = material(profile.tool.material)
    return Erodes() if known is None or known.wear is None else Erodes(known.wear, known.u_rel)


def of_work(profile: Profile) -> Erodes:
    """How the work is removed."""
    known = material(profile.work.material)
    return Erodes() if known is None or known.removal is None else Erodes(known.removal, known.u_rel)


def gap_recipe(profile: Profile, depth_um: float) -> GapRecipe:
    """Return what of a profile the gap depends on; each jump dilutes the oil in the gap and its annulus."""
    pulse, jump, diameter_um = profile.pulse, profile.jump, profile.tool.diameter_um
    jump_clearing_hz = 0.0
    if jump.mode != "off":
        tool_um2 = tool_area_um2(diameter_um)
        annulus_um2 = hole_area_um2(diameter_um, expected_side_gap_um(profile)) - tool_um2
        strokes = tool_um2 * jump.height_um / (annulus_um2 * depth_um + 3.0 * tool_um2)
        jump_clearing_hz = -math.expm1(-strokes) / jump.period_s
    return GapRecipe(
        on_time_us=pulse.on_time_us,
        off_time_us=pulse.off_time_us,
        open_voltage_v=pulse.open_voltage_v,
        current_a=pulse.current_a,
        level_s=profile.servo.reference,
        diameter_um=diameter_um,
        discharge_voltage_v=pulse.discharge_voltage_v,
        longest_us=pulse.burning_time_us,
        tool_negative=pulse.polarity == "tool-negative",
        work_removal=of_work(profile).factor,
        tool_wear=of_tool(profile).factor,
        jump_clearing_hz=jump_clearing_hz,
    )


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
    gap, side_um = expected_gap(profile, depth_um), expected_side_gap_um(profile)
    work_u_rel = math.hypot(LAW_U_REL, of_work(profile).u_rel)
    work = {"removal_um3_per_uj": gap.removal_um3_per_uj, "removal_u_rel": work_u_rel, "side_gap_um": side_um}
    filled = _filled(_filled(profile, "work", work), "measure", {"expected_gap_um": gap.gap_um})
    if "expected_ratio" not in profile.wear.model_fields_set:
        ratio = expected_wear_ratio(profile, depth_um, filled.work.side_gap_um)
        ratio_u_rel = math.hypot(work_u_rel, of_tool(profile).u_rel)
        filled = _filled(filled, "wear", {"expected_ratio": ratio, "ratio_u_rel": ratio_u_rel})
    return filled


def _filled(profile: Profile, table: str, values: Mapping[str, float]) -> Profile:
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


STAGE_TOLERANCE = 0.03
"""A regime that is not the last ends within this share of its end: the next one takes the rest."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """One regime: its name, from which depth to which it goes, and the profile that it is cut with."""

    name: str
    from_um: float
    to_um: float
    profile: Profile

    @property
    def depth_um(self) -> float:
        """Its share of the depth."""
        return self.to_um - self.from_um

    @property
    def wear_um(self) -> float:
        """What the tool loses in it, as expected."""
        return self.depth_um * self.profile.wear.expected_ratio


def recipes_of(profile: Profile, depth_um: float | None = None) -> list[Recipe]:
    """Return the recipes that a hole goes through; the profile itself where it has no regimes.

    `profile` has removal, wear and gap of its own pulses filled in; those of a regime go with them as the laws of
    the process have it. `depth_um` is that of the hole, by default the target's.
    """
    if not profile.regimes or profile.target.kind != "depth":
        return [Recipe("", 0.0, usual_depth_um(profile), profile)]
    whole_um = usual_depth_um(profile) if depth_um is None else depth_um
    recipes, from_um = list[Recipe](), 0.0
    for regime, end in zip(profile.regimes, accumulate(one.share for one in profile.regimes), strict=True):
        is_last = regime is profile.regimes[-1]
        to_um = whole_um if is_last else whole_um * end
        tolerance_um = max(profile.target.tolerance_um, 0.0 if is_last else STAGE_TOLERANCE * to_um)
        own = in_regime(profile, regime).having("target", depth_um=to_um, tolerance_um=tolerance_um)
        if own.wear.remeasure == "sparing" and not is_last:  # the next regime starts from a touched bottom
            own = own.having("wear", remeasure="auto")
        recipes.append(Recipe(regime.name, from_um, to_um, own))
        from_um = to_um
    return recipes


def ra_of_regimes_um(recipes: Sequence[Recipe]) -> float:
    """Roughness Ra of the floor after these regimes: a floor shows the craters of its last µm (`SURFACE_UM`)."""
    end_um, craters, arcs, whole = recipes[-1].to_um, 0.0, 0.0, 0.0
    for recipe in recipes:
        to, since = (math.exp((um - end_um) / SURFACE_UM) for um in (recipe.to_um, recipe.from_um))
        share, gap = to - since, expected_gap(recipe.profile, recipe.to_um)
        craters += share * gap.crater_um3
        arcs += share * gap.arc_share / gap.spark_share
        whole += share
    return roughness_ra_um(craters / whole, arcs / whole)


def with_regimes(profile: Profile) -> Profile:
    """Fill in what regimes leave to the profile, so that each is complete."""
    if not profile.regimes:
        return profile
    pulse = profile.pulse
    whole: dict[str, float | None] = {
        "current_a": pulse.current_a,
        "frequency_hz": pulse.frequency_hz,
        "duty": pulse.duty,
        "reference": None if profile.adaptive.seek_reference else profile.servo.reference,
    }
    filled = [
        regime.model_copy(update={key: getattr(regime, key) or value for key, value in whole.items()})
        for regime in profile.regimes
    ]
    return profile.model_copy(update={"regimes": filled})


def in_pulses(profile: Profile, regime: Regime) -> Profile:
    """The profile with the pulses of a regime alone."""
    given = regime.model_dump(include={"current_a", "frequency_hz", "duty"}, exclude_none=True)
    return profile.having("pulse", **given)


def in_regime(profile: Profile, regime: Regime) -> Profile:
    """The profile with the pulses and the reference of a regime, and the values expected with them."""
    other = in_pulses(profile, regime)
    if regime.reference is not None:
        other = other.having("servo", reference=regime.reference)
    elif profile.adaptive.seek_reference:
        other = with_sought_reference(other)
    depth_um = usual_depth_um(profile)
    here, there = expected_gap(profile, depth_um), expected_gap(other, depth_um)
    work, wear, measure = profile.work, profile.wear, profile.measure
    removal = work.removal_um3_per_uj * there.removal_um3_per_uj / here.removal_um3_per_uj
    side_um = work.side_gap_um * expected_side_gap_um(other) / expected_side_gap_um(profile)
    ratio = wear.expected_ratio * there.wear_ratio / here.wear_ratio
    gap_um = measure.expected_gap_um * there.gap_um / here.gap_um
    other = other.having("work", removal_um3_per_uj=removal, side_gap_um=side_um)
    return other.having("wear", expected_ratio=ratio).having("measure", expected_gap_um=gap_um)


SIDE_DISCHARGE_SHARE = 0.05
"""Discharges that burn at the wall of the hole: 3 % in a clean gap, more with debris."""
CATCHING_UP = 1.6
"""An approach that has to be faster than the feed is so much faster: the first sparks burn in clean oil."""
LEAST_MACHINING_SHARE = 0.1
"""However much it jumps; a recipe that jumps more than 0.3 of the time is refused anyway."""
PAD_MARGIN_UM = 50.0  # surface that remains between a hole and the reference pad, for the burr and the stages
WALL_UM = 20.0  # wall between two holes or two sides of a channel
HALF_AMPLITUDE_DESIGN_UM = 0.5
"""Swing (half-amplitude) below which shorts do not rise: 0.15 of the working gap, from a simulated sweep."""
HALF_AMPLITUDE_LIMIT_UM = 1.0
"""Swing beyond which shorts rise steeply: 0.3 of the working gap, from the same sweep."""


@dataclass(frozen=True, slots=True)
class Hole:
    """One hole at the expected ratio of wear; `completion_um` is fed on after a breakthrough."""

    depth_um: float
    wear_um: float
    completion_um: float = 0.0

    @property
    def feed_um(self) -> float:
        """How far the tool feeds below the surface, wear and all."""
        return self.depth_um + self.wear_um + self.completion_um


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """The steady swing of the relay loop."""

    loop_delay_s: float
    half_amplitude_um: float
    period_s: float


def hole(profile: Profile, depth_um: float = math.nan) -> Hole:
    """The hole of the profile's target, or one of this depth instead."""
    ratio, target = profile.wear.expected_ratio, profile.target
    completion_um = 0.0
    if target.kind == "through":
        depth_um, completion_um = profile.work.thickness_um, completion(profile)
    elif math.isnan(depth_um):
        depth_um = target.depth_um if target.kind == "depth" else target.feed_um / (1.0 + ratio)
    if profile.regimes:
        return Hole(depth_um, math.fsum(one.wear_um for one in recipes_of(profile)))
    return Hole(depth_um, ratio * depth_um, completion_um)


def completion(profile: Profile) -> float:
    """Feed after a breakthrough, µm: as the target says, or until the rounded tip of the worn tool is through."""
    given = getattr(profile.target, "completion_um", None)
    return profile.tool.diameter_um / 2.0 if given is None else given


def removal_um3_s(profile: Profile, depth_um: float) -> float:
    """Work removed while sparking, µm³/s, on average down to a depth, at the removal per energy that is stated."""
    gap, mean = expected_gap(profile, depth_um), expected_gap(profile, usual_depth_um(profile))
    stated = profile.work.removal_um3_per_uj / mean.removal_um3_per_uj
    return stated * gap.removal_um3_s * (1.0 - gap.side_share)


def feed_rate_um_s(profile: Profile, depth_um: float) -> float:
    """Tool feed in a hole while sparking, µm/s."""
    section_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
    return removal_um3_s(profile, depth_um) / section_um2 * (1.0 + profile.wear.expected_ratio)


def approach_speed_um_s(profile: Profile) -> float:
    """Speed towards the spark gap: the profile's, or faster than what the first sparks remove, to catch up."""
    feed_um_s = feed_rate_um_s(profile, 0.0)
    if feed_um_s <= profile.approach.speed_um_s:
        return profile.approach.speed_um_s
    return min(CATCHING_UP * feed_um_s, profile.servo.forward_um_s)


def machining_share(profile: Profile) -> float:
    """Share of the machining time besides jumps; the cleaner gap makes up for the way back."""
    return max(1.0 - time_share_of_jumps(profile), LEAST_MACHINING_SHARE)


def time_share_of_jumps(profile: Profile) -> float:
    """Share of the machining time that jumps take; adaptive ones as if they kept to their period."""
    return 0.0 if profile.jump.mode == "off" else jump_duration_s(profile) / profile.jump.period_s


def jump_duration_s(profile: Profile) -> float:
    """Time of one jump, s."""
    jump = profile.jump
    return jump_time_s(jump.height_um, jump.speed_um_s, jump.dwell_s)


def jump_time_s(height_um: float, speed_um_s: float, dwell_s: float) -> float:
    """Time of one jump, up and down with a dwell at the top."""
    return 2.0 * height_um / speed_um_s + dwell_s


def servo_swing(profile: Profile, setup: Setup) -> LimitCycle:
    """The swing of the gap servo that follows from the dead time of its loop.

    That is half a period of hold, the latency, the low-pass and the actuator's lag. Lags count fully, so the swing
    is over-predicted when they dominate.
    """
    controller, servo = setup.controller, profile.servo
    hold_s = (0.5 + controller.latency) * controller.servo_period_s
    delay_s = hold_s + 1.0 / (2.0 * math.pi * servo.filter_hz) + controller.actuator_lag_s
    return LimitCycle(delay_s, servo.forward_um_s * delay_s, 4.0 * delay_s)


def least_jump_um(depth_um: float, diameter_um: float, side_gap_um: float) -> float:
    """Least useful jump height, µm: annulus volume at that depth over the tool's face, `4 s z / d * (1 + s / d)`."""
    return 4.0 * side_gap_um * depth_um / diameter_um * (1.0 + side_gap_um / diameter_um)
