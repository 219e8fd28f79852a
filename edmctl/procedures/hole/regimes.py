"""From one regime of a hole to the next, at a measuring stop: other pulses, and what they let expect.

Nothing that earlier pulses have taught holds for others: removal and wear are learned anew, from the bottom and the
tool as they were touched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.planning.measuring import estimate_of
from edmctl.planning.regimes import Recipe, recipes_of
from edmctl.procedures.job_state import RegimeBegun
from edmctl.procedures.run import JobRun
from edmctl.procedures.settings import pulse_settings
from edmctl.process.discharge import first_gap_u_um
from edmctl.process.live_erosion import LEAST_RATIO, ErosionEstimate
from edmctl.process.touches import DepthAndWear

if TYPE_CHECKING:
    from edmctl.procedures.hole.hole import JobKnowledge, OpenHole
    from edmctl.profile.model import Profile


def take_recipe(run: JobRun, number: int) -> None:
    """Go by the recipe of this regime from now on; nothing where the job has none."""
    if not run.job.profile.regimes:
        return
    recipe = recipes_of(run.job.profile)[number]
    run.regime.number, run.regime.name, run.regime.profile = number, recipe.name, recipe.profile
    run.watch.set_duty_voltage(recipe.profile.pulse.duty_voltage_v)


def next_regime(run: JobRun, hole: OpenHole, knowledge: JobKnowledge, found: DepthAndWear) -> Recipe | None:
    """Begin the regime that the depth asks for after this one; None where this was the last."""
    recipes = recipes_of(run.job.profile)
    number = run.regime.number + 1
    if number >= len(recipes):
        return None
    factors = _learned(run.profile, knowledge.estimate)
    while number + 1 < len(recipes) and found.depth_um >= recipes[number].to_um:
        number += 1
    take_recipe(run, number)
    recipe = recipes[number]
    run.machine.set_pulses(pulse_settings(recipe.profile))
    hole.target = run.target_at(hole.site)
    hole.estimate = knowledge.estimate = estimate_of(_believed(recipe.profile, *factors))
    hole.regime = RegimeBegun(found.depth_um, found.wear_um, hole.sums.total, hole.stops)
    knowledge.gap_um = recipe.profile.measure.expected_gap_um
    knowledge.gap_u_um = first_gap_u_um(recipe.profile.pulse.open_voltage_v)
    return recipe


def _learned(profile: Profile, estimate: ErosionEstimate) -> tuple[float, float]:
    """How many times as much as believed the pulses until now removed, and wore the tool: the materials stay."""
    if estimate.fits == 0 or estimate.contradicted:
        return 1.0, 1.0
    believed = estimate_of(profile)
    return (
        estimate.removal_um3_per_uj / believed.removal_um3_per_uj,
        estimate.wear_ratio / max(believed.wear_ratio, LEAST_RATIO),
    )


def _believed(profile: Profile, removal: float, ratio: float) -> Profile:
    """The recipe with so many times its removal and wear."""
    work, wear = profile.work, profile.wear
    return profile.model_copy(
        update={
            "work": work.model_copy(update={"removal_um3_per_uj": removal * work.removal_um3_per_uj}),
            "wear": wear.model_copy(update={"expected_ratio": ratio * wear.expected_ratio}),
        }
    )


def regime_text(recipe: Recipe) -> str:
    """What a regime is, in words."""
    pulse = recipe.profile.pulse
    return (
        f"Regime {recipe.name}: to {recipe.to_um:.1f} µm with {pulse.current_a:g} A for {pulse.on_time_us:.3g} µs, "
        f"{pulse.off_time_us:.3g} µs off, servo reference {recipe.profile.servo.reference:g}."
    )
