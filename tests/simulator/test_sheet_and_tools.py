"""A sheet that gives way, and tools that are changed."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from edmctl.core.library import library
from edmctl.link import messages as m
from edmctl.simulator import BenchConfig, SensorConstants
from edmctl.simulator.plant_records import TICK_S
from edmctl.simulator.saving import bench_state, restored_bench
from tests.simulator.conftest import Rig, RigMaker

FOIL = BenchConfig(
    tool_diameter_um=80.0,
    tool_wear=0.15,
    offset_um=12.0,
    thickness_um=12.0,
    sensors=SensorConstants(tilt_sd_mrad=0.0),
)
LATE = {"open_lost_um": 200.0, "open_lost_s": 1000.0}


def cut(r: Rig, duration_s: float) -> None:
    """Approach and let the servo cut for so long."""
    r.start_sparking()
    r.session.pump(duration_s)


def open_share(r: Rig, over_s: float) -> float:
    """Share of open pulses in the coming time."""
    first = len(r.samples)
    r.session.pump(over_s)
    del r.samples[:first]
    counts = [r.column(f"n_{kind}").sum() for kind in ("open", "normal", "arc", "short")]
    return float(counts[0] / sum(counts))


@pytest.fixture
def through(rig: RigMaker) -> Rig:
    """A rig in the middle of a cut that has just gone through its foil."""
    r = rig(FOIL, seed=3).arm(LATE).to_pad()
    r.session.request(m.TlmStart(1000, 10, m.PulseLog.OFF))
    cut(r, 2.0)
    r.before = open_share(r, 1.0)  # type: ignore[attr-defined]
    assert r.session.pump_until(lambda: math.isinf(r.bench.plant.state.rarity), 100.0)
    return r


def test_behind_a_foil_every_pulse_is_open_and_the_truth_says_through(through: Rig) -> None:
    assert through.before < 0.9  # type: ignore[attr-defined]
    assert open_share(through, 1.0) == 1.0
    (hole,) = through.bench.truth()
    assert (hole.depth_um, hole.through) == (FOIL.thickness_um, True)
    assert through.bench.truth_map()[2].max() == FOIL.thickness_um


def test_a_through_hole_gives_no_contact_and_debris_falls_out(through: Rig) -> None:
    through.session.pump(0.5)
    assert through.bench.plant.state.debris_um3 < 1.0
    through.session.request(m.ServoStop())
    through.session.request(m.PiezoSet(0.0, 300.0))
    through.wait(m.EventCode.MOVE_DONE, 5.0)
    through.session.request(m.TouchOff(50.0, 5.0, 20.0, 60.0, 5.0, 0.1, 1))
    assert through.wait_fault(60.0).code == 2005


def test_debris_leaves_faster_the_more_of_the_face_is_open_below(rig: RigMaker) -> None:
    plant = rig(FOIL).bench.plant
    rates = []
    for rarity in (1.0, 2.0, math.inf):
        plant.state.rarity = rarity
        library().renew_clearing(plant.unit.place, plant.state.place)
        rates.append(-math.log(plant.state.tick_clearing) / TICK_S)
    assert rates[1] - rates[0] == pytest.approx(25.0)
    assert rates[2] - rates[0] == pytest.approx(50.0)


def test_a_rounded_tool_opens_a_foil_bit_by_bit(rig: RigMaker) -> None:
    r = rig(replace(FOIL, tip_rounding_um=6.0), seed=4).arm(LATE).to_pad()
    cut(r, 0.5)
    rarities = [1.0]

    def is_through() -> bool:
        rarities.append(float(r.bench.plant.state.rarity))
        return math.isinf(rarities[-1])

    assert r.session.pump_until(is_through, 200.0)
    partly = [rarity for rarity in rarities if 1.0 < rarity < math.inf]
    assert len(partly) > 10
    assert rarities == sorted(rarities)
    (hole,) = r.bench.truth()
    assert hole.through
    assert hole.depth_um == FOIL.thickness_um


def test_a_through_hole_is_kept(through: Rig) -> None:
    again = restored_bench(bench_state(through.bench))
    assert again.truth() == through.bench.truth()
    assert again.truth()[0].through
    assert again.plant.state.surface_um == through.bench.plant.state.surface_um > 1e5


def test_a_hole_beside_a_hole_meets_the_wall_between_them(rig: RigMaker) -> None:
    r = rig(replace(FOIL, thickness_um=math.inf), seed=5).arm(LATE).to_pad()
    cut(r, 8.0)
    r.session.request(m.Disarm())
    r.wait(m.EventCode.MOVE_DONE, 5.0)
    depth_um = r.bench.truth()[0].depth_um
    plant = r.bench.plant
    surface_um = plant.state.surface_um
    for away_um, found_um in ((0.0, depth_um), (60.0, 0.0), (200.0, 0.0)):
        plant.stage_lands(0, away_um)
        assert plant.state.depth_um == found_um
        assert plant.state.surface_um == surface_um
    plant.stage_lands(0, 60.0)
    assert plant.state.per_hole_area > 1.2 * plant.unit.per_disc_area


def test_a_tool_that_is_put_back_has_its_wear_and_the_work_stays(rig: RigMaker) -> None:
    r = rig(replace(FOIL, thickness_um=math.inf, tool_label="a"), seed=6).arm(LATE).to_pad()
    cut(r, 10.0)
    r.session.request(m.Disarm())
    r.wait(m.EventCode.MOVE_DONE, 5.0)
    bench, worn_um, holes = r.bench, r.bench.tool_wear_um, r.bench.truth()
    assert worn_um > 0.0
    bench.fit_tool("a", 80.0, 0.05, 0.0)
    assert bench.tool_wear_um == worn_um
    bench.fit_tool("b", 120.0, 0.3, 0.0)
    assert (bench.tool_label, bench.tool_wear_um) == ("b", 0.0)
    assert bench.plant.unit.tool_area_um2 == pytest.approx(math.pi * 60.0**2)
    assert bench.plant.state.depth_um == 0.0  # it does not fit into the hole of the smaller tool
    assert bench.truth() == holes
    bench = restored_bench(bench_state(bench))
    assert bench.tool_label == "b"
    bench.fit_tool("a", 80.0, 0.05, 0.0)
    assert (bench.tool_label, bench.tool_wear_um) == ("a", worn_um)
    assert bench.plant.state.depth_um == holes[0].depth_um
    bench.fit_tool("b", 120.0, 0.3, 2.0)
    assert bench.tool_wear_um == 0.0
