"""The dirty gap: arcs, bridges, narrowing, removal and wear, flushing, and what a retraction draws in."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.core.library import library
from edmctl.link.messages import PulseClass
from edmctl.process.erosion import removal_um3_per_uj
from edmctl.simulator import BenchConfig, DischargeConstants
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_records import TICK_NS, TICK_S
from tests.simulator import struck_pulses
from tests.tiers import tiers

D = DischargeConstants()
ON_TIME_US, OFF_TIME_US = 130.435, 304.348


@dataclass
class Struck:
    """Pulses struck at a gap and debris fraction held fixed."""

    classes: NDArray[np.uint8]
    burning_us: NDArray[np.float64]
    depth_um: float
    wear_um: float
    mean_v: float
    plant: Plant


def strike(
    fraction: float,
    gap_um: float,
    pulses: int,
    constants: DischargeConstants = D,
    *,
    keep_carbon: bool = False,
    off_time_us: float = OFF_TIME_US,
) -> Struck:
    """Strike pulses in the same dirty gap again and again; depth, wear and debris start from zero each time."""
    plant = Plant(BenchConfig(discharge=constants), 3)
    plant.set_generator(ON_TIME_US, off_time_us, 40.0, 0.12, 0.0)
    unit, state = plant.unit, plant.state
    taken = []
    count, depth, wear, voltage = 0, 0.0, 0.0, 0.0
    library().renew_clearing(unit.place, state.place)
    while count < pulses:
        state.depth_um = state.wear_um = 0.0
        state.carbon *= keep_carbon
        state.debris_um3 = fraction * unit.tool_area_um2 * max(gap_um, 0.3)
        state.true_z_um = state.surface_um - gap_um
        # One pulse a call, so that debris and gap are the same for each.
        plant.readings.tick = state.next_pulse_ns // TICK_NS
        state.next_pulse_ns = (plant.readings.tick + 1) * TICK_NS - 1
        sum_v, struck = struck_pulses.strike(plant)
        assert len(struck) == 1
        taken.append(struck)
        count, voltage = count + 1, voltage + sum_v
        depth, wear = depth + state.depth_um, wear + state.wear_um
    records = np.concatenate(taken)
    return Struck(records["pulse_class"], records["discharge_us"], depth, wear, voltage / count, plant)


def of(gap: dict[str, float] | None = None, **constants: Any) -> DischargeConstants:
    """Constants of which these are others."""
    return replace(D, gap=replace(D.gap, **(gap or {})), **constants)


FORGETS = {"deionisation_us": 0.0}
"""A channel that is gone at once, so that nothing but debris makes arcs."""


def arcs_expected(fraction: float, delay_us: NDArray[np.float64], *, after: bool, after_arc: bool) -> float:
    """Mean chance that discharges of these delays arc."""
    if not after:
        return D.gap.arc_base
    dense = min(1.0, (fraction / D.gap.arc_debris) ** 2 * (9.0 if after_arc else 1.0))
    pause = 1.0 / (1.0 + OFF_TIME_US / D.gap.arc_pause_us)
    fades_us = D.gap.arc_delay_us * (2.0 if after_arc else 1.0)
    return D.gap.arc_base + dense * pause * float(np.exp(-delay_us / fades_us).mean())


@pytest.mark.parametrize("fraction", tiers(slow=(0.1,), full=(0.03,)))
def test_discharges_arc_as_debris_and_what_came_before_say(fraction: float) -> None:
    constants = of({**FORGETS, "bridge_base": 0.0}, roughness_um=0.0)
    classes = strike(fraction, 2.2, 40_000, constants=constants, keep_carbon=False).classes
    narrowed_um = 2.2 * (1.0 - D.gap.debris_gap_factor * fraction)
    tau_us = D.gap.tau_reference_us * (narrowed_um / D.gap.gap_reference_um) ** D.gap.gap_exponent
    draws_us = D.formative_us - tau_us * np.log(1.0 - np.random.default_rng(1).random(100_000))
    delays_us = draws_us[draws_us < ON_TIME_US]
    ignited, before = np.isin(classes[1:], (PulseClass.NORMAL, PulseClass.ARC)), classes[:-1]
    for name, follows in (
        ("open", before == PulseClass.OPEN),
        ("normal", before == PulseClass.NORMAL),
        ("arc", before == PulseClass.ARC),
    ):
        of_these = classes[1:][ignited & follows]
        expected = arcs_expected(fraction, delays_us, after=name != "open", after_arc=name == "arc")
        sd = math.sqrt(expected * (1.0 - expected) / of_these.size)
        assert of_these.size > 20, name
        assert (of_these == PulseClass.ARC).mean() == pytest.approx(expected, abs=4.0 * sd), name


@pytest.mark.slow
def test_a_channel_that_is_still_conducting_ignites_again_at_once() -> None:
    for off_time_us in (20.0, 60.0):
        plant_constants = of({"bridge_base": 0.0, "arc_debris": 1e9, "arc_base": 0.0}, roughness_um=0.0)
        struck = strike(0.05, 1.2, 8_000, constants=plant_constants, off_time_us=off_time_us)
        before, now = struck.classes[:-1], struck.classes[1:]
        for kind, factor in ((PulseClass.NORMAL, 1.0), (PulseClass.ARC, D.gap.deionisation_after_arc)):
            memory_us = D.gap.deionisation_us * (1.0 + 0.05 * D.gap.deionisation_debris) * factor
            expected = math.exp(-off_time_us / memory_us)
            of_these = now[before == kind]
            if of_these.size > 100:
                sd = math.sqrt(expected * (1.0 - expected) / of_these.size)
                # A discharge that ignited late leaves a little less: its energy counts by a power of 0.3.
                assert (of_these == PulseClass.ARC).mean() == pytest.approx(expected, abs=4.0 * sd + 0.02)


@pytest.mark.slow
def test_a_bridge_forms_as_often_as_a_chain_of_particles() -> None:
    for fraction, gap_um in ((0.3, 1.0), (0.2, 1.6), (0.5, 2.5)):
        constants = of({"arc_base": 0.0}, bridge_clear=1.0, roughness_um=0.0)
        struck = strike(fraction, gap_um, 30_000, constants=constants)
        particles = gap_um / D.gap.particle_um - 0.5
        expected = min(0.5, D.gap.bridge_base * fraction**particles)
        sd = math.sqrt(expected / struck.classes.size)
        # A bridge that burns off leaves the next pulse to form another, with the same chance.
        assert np.count_nonzero(struck.classes == PulseClass.SHORT) / struck.classes.size == pytest.approx(
            expected, abs=5.0 * sd + 0.02 * expected
        )


@pytest.mark.slow
def test_debris_narrows_the_gap() -> None:
    constants = of({"arc_base": 0.0, "arc_debris": 1e9, "bridge_base": 0.0, **FORGETS})
    clean = strike(0.0, 3.0 * (1.0 - D.gap.debris_gap_factor * 0.1), 20_000, constants)
    dirty = strike(0.1, 3.0, 20_000, constants)
    assert dirty.mean_v == pytest.approx(clean.mean_v, rel=0.01)


@pytest.mark.slow
def test_removal_and_wear_follow_the_laws_of_a_pulse() -> None:
    struck = strike(0.0, 1.2, 12_000, constants=of({"arc_base": 0.0, **FORGETS}))
    plant, law = struck.plant, D.erosion
    burning_us = struck.burning_us[struck.classes == PulseClass.NORMAL]
    assert burning_us.size > 8_000
    molten_uj = 22.0 * 0.12 * burning_us - law.threshold_uj
    laws = np.array([removal_um3_per_uj(law, us, 0.12, tool_negative=True) for us in burning_us.tolist()])
    work_um3, tool_um3 = (1.0 - D.gap.side_base) * molten_uj @ laws
    assert struck.depth_um / plant.state.per_hole_area == pytest.approx(work_um3, rel=0.02)
    assert struck.wear_um / plant.unit.per_tool_area == pytest.approx(tool_um3, rel=0.02)


def test_debris_costs_work_and_no_tool() -> None:
    clean, dirty = (
        strike(
            c,
            1.2 / (1.0 - 1.5 * c),
            8_000,
            constants=of(
                {"arc_base": 0.0, "arc_debris": 1e9, "bridge_base": 0.0, "side_base": 0.0, **FORGETS}
            ),
        )
        for c in (0.0, D.gap.redeposition)
    )
    assert dirty.depth_um / clean.depth_um == pytest.approx(0.5, rel=0.03)
    assert dirty.wear_um / clean.wear_um == pytest.approx(1.0, rel=0.03)


def test_an_arc_removes_little_and_wears_as_much() -> None:
    burnt = of({"arc_base": 1.0, "side_base": 0.0, **FORGETS})
    struck = strike(0.0, 1.2, 8_000, constants=burnt)
    arcs = np.count_nonzero(struck.classes == PulseClass.ARC)
    assert arcs > 6_000
    energy_uj = 17.0 * 23.0 / 150.0 * ON_TIME_US - D.erosion.threshold_uj
    work, tool = (
        per_uj * energy_uj * arcs * 17.0 / 22.0
        for per_uj in removal_um3_per_uj(D.erosion, ON_TIME_US, 0.12, tool_negative=True)
    )
    assert struck.depth_um / struck.plant.state.per_hole_area == pytest.approx(
        D.gap.arc_work * work, rel=0.02
    )
    assert struck.wear_um / struck.plant.unit.per_tool_area == pytest.approx(D.gap.arc_tool * tool, rel=0.02)


def test_twenty_arcs_in_a_row_begin_to_build_carbon() -> None:
    struck = strike(0.0, 1.5, 60, constants=of({"arc_base": 1.0, **FORGETS}), keep_carbon=True)
    arcs = np.count_nonzero(struck.classes == PulseClass.ARC)
    assert struck.plant.state.carbon == pytest.approx(arcs - 20, abs=1)


def test_debris_leaves_with_the_flush_time_of_tool_and_depth() -> None:
    for diameter_um, depth_um in ((270.0, 0.0), (150.0, 0.0), (270.0, 189.0)):
        plant = Plant(BenchConfig(tool_diameter_um=diameter_um), 1)
        plant.state.depth_um = depth_um
        plant.state.true_z_um = plant.state.surface_um + depth_um - plant.unit.working_gap_um
        library().renew_clearing(plant.unit.place, plant.state.place)
        flush_s = -TICK_S / math.log(plant.state.tick_clearing)
        expected_s = 0.5 * (diameter_um / 270.0) ** 2 * (1.0 + (depth_um / (1.1 * diameter_um)) ** 2)
        assert flush_s == pytest.approx(expected_s, rel=1e-9)
        period_s = -math.log(plant.state.clearing) * flush_s
        assert period_s == pytest.approx(plant.unit.pulse_period_ns * 1e-9, rel=1e-9)


def test_opening_the_gap_draws_oil_in_however_the_tool_moves() -> None:
    plant = Plant(BenchConfig(), 1)
    plant.stage_lands(0, 0.0)
    unit, state = plant.unit, plant.state
    state.depth_um = 100.0
    for step_um in (60.0, 1.0):
        state.debris_um3, state.carbon, state.opening_um = 1000.0, 60.0, 0.0
        for lifted_um in np.arange(step_um, 60.0 + 0.5 * step_um, step_um):
            library().pump(unit.place, state.place, lifted_um)
        refill_um3 = unit.annulus_area_um2 * 100.0 + 3.0 * unit.tool_area_um2
        expected = 1000.0 * math.exp(-unit.tool_area_um2 * 60.0 / refill_um3)
        assert state.debris_um3 == pytest.approx(expected, rel=1e-9)
        assert state.carbon == 0.0
