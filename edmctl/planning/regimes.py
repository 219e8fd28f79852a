"""The regimes of a hole, from roughing to finishing: each is a recipe of its own down to its share of the depth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate

from edmctl.dataclasses import dataclass
from edmctl.planning.erosion import expected_gap, expected_side_gap_um, usual_depth_um, with_sought_reference
from edmctl.process.erosion import SURFACE_UM, roughness_ra_um
from edmctl.profile.model import Profile, Regime

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
    ends = [*accumulate(regime.share for regime in profile.regimes)]
    found, from_um = [], 0.0
    for regime, end in zip(profile.regimes, ends, strict=True):
        is_last = regime is profile.regimes[-1]
        to_um = whole_um if is_last else whole_um * end
        tolerance_um = max(profile.target.tolerance_um, 0.0 if is_last else STAGE_TOLERANCE * to_um)
        own = in_regime(profile, regime).having("target", depth_um=to_um, tolerance_um=tolerance_um)
        if own.wear.remeasure == "sparing" and not is_last:  # the next regime starts from a touched bottom
            own = own.having("wear", remeasure="auto")
        found.append(Recipe(regime.name, from_um, to_um, own))
        from_um = to_um
    return found


def ra_of_regimes_um(recipes: Sequence[Recipe]) -> float:
    """Roughness Ra of the floor that these regimes leave, one after the other.

    A thin last one leaves some of the craters before it: a floor shows those of its last µm (`SURFACE_UM`).
    """
    end_um, craters, arcs, whole = recipes[-1].to_um, 0.0, 0.0, 0.0
    for recipe in recipes:
        left = math.exp((recipe.to_um - end_um) / SURFACE_UM) - math.exp(
            (recipe.from_um - end_um) / SURFACE_UM
        )
        gap = expected_gap(recipe.profile, recipe.to_um)
        craters += left * gap.crater_um3
        arcs += left * gap.arc_share / gap.spark_share
        whole += left
    return roughness_ra_um(craters / whole, arcs / whole)


def with_regimes(profile: Profile) -> Profile:
    """Fill in what regimes leave to the profile, so that each stands for itself."""
    pulse, reference = profile.pulse, profile.servo.reference
    if profile.adaptive.seek_reference:
        reference = math.nan
    filled = [
        regime.model_copy(
            update={
                "current_a": regime.current_a or pulse.current_a,
                "frequency_hz": regime.frequency_hz or pulse.frequency_hz,
                "duty": regime.duty or pulse.duty,
                "reference": regime.reference or (None if math.isnan(reference) else reference),
            }
        )
        for regime in profile.regimes
    ]
    return profile.model_copy(update={"regimes": filled}) if filled else profile


def in_pulses(profile: Profile, regime: Regime) -> Profile:
    """The profile with the pulses of a regime alone."""
    keys = ("current_a", "frequency_hz", "duty")
    return profile.having(
        "pulse", **{key: value for key in keys if (value := getattr(regime, key)) is not None}
    )


def in_regime(profile: Profile, regime: Regime) -> Profile:
    """The profile with the pulses and the reference of a regime, and what they let expect."""
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
