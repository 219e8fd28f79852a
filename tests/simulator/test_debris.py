"""The dirty gap: arcs, bridges, narrowing, removal and wear, flushing, and what a retraction draws in."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.simulator import BenchConfig, DischargeConstants
from edmctl.simulator import kernel as k
from edmctl.simulator.parameters import Parameters
from edmctl.simulator.plant import Plant
from tests.tiers import tiers

if TYPE_CHECKING:
    from numpy.typing import NDArray

D = DischargeConstants()
RECENT = np.zeros((k.RECENT, k.RECENT_COLUMNS))


@dataclass
class Struck:
    """Pulses struck at a gap and debris fraction held fixed."""

    classes: NDArray[np.uint8]
    energy_uj: NDArray[np.float64]
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
) -> Struck:
    """Strike pulses in the same dirty gap again and again; depth, wear and debris start from zero each time."""
    plant = Plant(BenchConfig(discharge=constants), 3)
    Parameters(plant)
    plant.set_generator(130.435, 304.348, 40.0, 0.12, 0.0)
    st, ist, par = plant.st, plant.ist, plant.par
    ist[k.PULSE_LOG] = k.LOG_FULL
    records = np.zeros(6 * 64, dtype=np.uint8)
    taken = []
    count, depth, wear, voltage = 0, 0.0, 0.0, 0.0
    k.renew_clearing(par, st, ist)
    while count < pulses:
        st[k.DEPTH] = st[k.WEAR] = 0.0
        st[k.CARBON] *= keep_carbon
        st[k.DEBRIS] = fraction * par[k.TOOL_AREA] * max(gap_um, 0.3)
        st[k.TRUE_Z] = st[k.SURFACE] - gap_um
        # One pulse a call, so that debris and gap are the same for each.
        ist[k.TICK] = ist[k.NEXT_PULSE] // k.TICK_NS
        ist[k.NEXT_PULSE] = (ist[k.TICK] + 1) * k.TICK_NS - 1
        ist[k.LOG_N] = 0
        plant.random.provide(ist, 4, 1)
        sum_v, n, _ = k.pulses_of_tick(
            par, st, ist, plant.random.pulse, plant.random.tables, records, records, RECENT
        )
        assert n == 1
        taken.append(records[:6].copy())
        count, voltage = count + n, voltage + sum_v
        depth, wear = depth + float(st[k.DEPTH]), wear + float(st[k.WEAR])
    log = np.concatenate(taken).view(
        [("cls", "u1"), ("delay", "<u2"), ("discharge", "<u2"), ("plateau", "u1")]
    )
    plateau = log["plateau"] * 0.5
    energy = np.where(log["cls"] % 3 == 0, 0.0, plateau * (40.0 - plateau) / 150.0 * log["discharge"] * 0.1)
    return Struck(log["cls"], energy, depth, wear, voltage / count, plant)


@pytest.mark.parametrize("fraction", tiers(slow=(0.1, 0.25, 0.4)))
def test_arcs_come_as_often_as_debris_says_also_right_after_a_bridge(fraction: float) -> None:
    # A gap of 1 µm makes bridges frequent; they hold until they burn off, because the gap does not grow.
    struck = strike(
        fraction, 1.0, 60_000, constants=replace(D, bridge_base=0.2, bridge_clear=0.3, roughness_um=0.0)
    )
    classes = struck.classes
    expected = D.arc_base + D.arc_debris * fraction**2
    ignited = np.isin(classes, (k.NORMAL, k.ARC))
    share = np.count_nonzero(classes == k.ARC) / np.count_nonzero(ignited)
    assert share == pytest.approx(expected, rel=0.05)
    after = ignited[1:] & (classes[:-1] == k.SHORT)
    sample = np.count_nonzero(after)
    assert sample > 20
    share_after = np.count_nonzero(classes[1:][after] == k.ARC) / sample
    assert share_after == pytest.approx(expected, abs=4.0 * math.sqrt(expected * (1.0 - expected) / sample))


def test_a_bridge_forms_as_often_as_debris_and_gap_say() -> None:
    constants = replace(D, bridge_clear=1.0, roughness_um=0.0)
    struck = strike(0.3, 1.0, 60_000, constants=constants)
    expected = D.bridge_base * (0.3 / D.bridge_debris) ** 3 * math.exp(-1.0 / D.bridge_gap_um)
    assert np.count_nonzero(struck.classes == k.SHORT) / struck.classes.size == pytest.approx(
        expected, rel=0.1
    )


def test_debris_narrows_the_gap() -> None:
    constants = replace(D, arc_debris=0.0, bridge_base=0.0)
    clean = strike(0.0, 3.0 * (1.0 - D.debris_gap_factor * 0.1), 20_000, constants)
    dirty = strike(0.1, 3.0, 20_000, constants)
    assert dirty.mean_v == pytest.approx(clean.mean_v, rel=0.01)


def test_removal_follows_energy_and_wear_follows_removal() -> None:
    struck = strike(0.0, 1.5, 30_000, constants=replace(D, arc_base=0.0))
    par = struck.plant.par
    removed = struck.depth_um / par[k.PER_HOLE_AREA]
    frontal = 1.0 - D.side_base
    assert removed / struck.energy_uj.sum() == pytest.approx(D.kappa_um3_per_uj * frontal, rel=0.02)
    worn = struck.wear_um / par[k.PER_TOOL_AREA]
    assert worn / removed == pytest.approx(0.337, rel=1e-6)


def test_an_arc_removes_a_third_and_wears_three_times_as_much() -> None:
    struck = strike(0.0, 1.5, 20_000, constants=replace(D, arc_base=1.0, side_base=0.0))
    par = struck.plant.par
    removed = struck.depth_um / par[k.PER_HOLE_AREA]
    assert removed / struck.energy_uj.sum() == pytest.approx(0.3 * D.kappa_um3_per_uj, rel=0.02)
    assert struck.wear_um / par[k.PER_TOOL_AREA] / removed == pytest.approx(3.0 * 0.337, rel=1e-6)


def test_twenty_arcs_in_a_row_begin_to_build_carbon() -> None:
    struck = strike(0.0, 1.5, 60, constants=replace(D, arc_base=1.0), keep_carbon=True)
    arcs = np.count_nonzero(struck.classes == k.ARC)
    assert struck.plant.st[k.CARBON] == pytest.approx(arcs - 20, abs=1)


def test_debris_leaves_with_the_flush_time_of_tool_and_depth() -> None:
    for diameter_um, depth_um in ((270.0, 0.0), (150.0, 0.0), (270.0, 189.0)):
        plant = Plant(BenchConfig(tool_diameter_um=diameter_um), 1)
        st = plant.st
        st[k.DEPTH] = depth_um
        k.renew_clearing(plant.par, st, plant.ist)
        flush_s = -k.TICK_S / math.log(st[k.TICK_CLEARING])
        expected_s = 0.5 * (diameter_um / 270.0) ** 2 * (1.0 + (depth_um / (0.7 * diameter_um)) ** 2)
        assert flush_s == pytest.approx(expected_s, rel=1e-9)
        period_s = -math.log(st[k.CLEARING]) * flush_s
        assert period_s == pytest.approx(plant.ist[k.PULSE_PERIOD] * 1e-9, rel=1e-9)


def test_opening_the_gap_draws_oil_in_however_the_tool_moves() -> None:
    plant = Plant(BenchConfig(), 1)
    plant.stage_lands(0, 0.0)
    st, par = plant.st, plant.par
    st[k.DEPTH] = 100.0
    for step_um in (60.0, 1.0):
        st[k.DEBRIS], st[k.CARBON], st[k.OPENING] = 1000.0, 60.0, 0.0
        bottom = st[k.SURFACE] + st[k.DEPTH] - k.FREE_GAP_UM
        for lifted in np.arange(step_um, 60.0 + 0.5 * step_um, step_um):
            st[k.TRUE_Z] = bottom - lifted
            k.pump_tick(par, st)
        expected = 1000.0 * math.exp(
            -par[k.TOOL_AREA] * 60.0 / (par[k.ANNULUS_AREA] * 100.0 + 3.0 * par[k.TOOL_AREA])
        )
        assert st[k.DEBRIS] == pytest.approx(expected, rel=1e-9)
        assert st[k.CARBON] == 0.0
