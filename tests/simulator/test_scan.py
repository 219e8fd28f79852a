"""Scanning: what a tool that follows lines leaves in the work."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from edmctl.link import messages as m
from edmctl.simulator import BenchConfig, DischargeConstants, SensorConstants, plant
from edmctl.simulator.saving import bench_state, restored_bench
from tests.simulator.conftest import Rig, RigMaker

DUTY_V = 12.0
REFERENCE_V = 0.8 * DUTY_V
NO_SENSOR_ERROR = SensorConstants(
    gain_sd=0.0, nonlinearity_um=0.0, drift_sd_um_s=0.0, walk_um=0.0, tilt_sd_mrad=0.0
)
SMALL = BenchConfig(
    tool_diameter_um=80.0,
    tool_wear=0.0,
    offset_um=15.0,
    discharge=DischargeConstants(scatter=0.4),
    sensors=NO_SENSOR_ERROR,
)
LENGTH_UM = 150.0
SPEED_UM_S = 80.0


def over_the_work(r: Rig) -> float:
    """Arm, go over the work and find the face by touch; its displacement."""
    r.arm()
    r.to_pad()
    r.session.request(m.TouchOff(20.0, 5.0, 2.0, 60.0, 5.0, 0.2, 1))
    face_um = r.wait(m.EventCode.TOUCH, 30.0).displacement_um
    r.wait(m.EventCode.TOUCH_DONE, 5.0)
    return face_um


def scan(r: Rig, z_um: float, passes: int) -> None:
    """Go to and fro along y = 0 with the tool held at `z_um`."""
    r.session.request(m.ScanStart(REFERENCE_V, z_um, 500.0))
    r.session.pump(2.0)
    for i in range(passes):
        x_um = LENGTH_UM if i % 2 == 0 else 0.0
        r.session.request(m.PathMove(x_um, 0.0, SPEED_UM_S, z_um, int(i == passes - 1)))
    r.wait(m.EventCode.PATH_DONE, 120.0)


def middle_um(r: Rig) -> np.ndarray:
    """Depths of the cells along the axis of the channel, without its ends."""
    x_um, y_um, depth_um = r.bench.truth_map()
    row = depth_um[int(np.argmin(abs(y_um)))]
    inside = (x_um > 10.0) & (x_um < LENGTH_UM - 10.0)
    found: np.ndarray = row[inside]
    return found


def test_passes_to_and_fro_leave_a_flat_floor_a_gap_below_the_held_tool(rig: RigMaker) -> None:
    r = rig(SMALL, seed=5)
    face_um = over_the_work(r)
    for layer_um in (2.0, 4.0):
        scan(r, face_um + layer_um - 3.0, passes=6)
    floor_um = middle_um(r)
    assert floor_um.std() < 0.1
    held_um = face_um + 4.0 - 3.0
    gap_um = floor_um.mean() + face_um - held_um
    assert 2.0 < gap_um < 6.0
    assert r.bench.truth() == ()


def test_a_scan_loses_no_volume_between_the_sparks_and_the_map(
    rig: RigMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The wear of a tool that wears in proportion to the work counts what the discharges took.
    by_time = plant._by_burning_time

    def tool_like_work(*args: Any, **kwargs: Any) -> tuple[tuple[float, ...], ...]:
        work, _, memory = by_time(*args, **kwargs)
        return work, work, memory

    monkeypatch.setattr(plant, "_by_burning_time", tool_like_work)
    r = rig(SMALL, seed=6)
    r.bench.plant.unit.side_base = r.bench.plant.unit.side_debris = 0.0
    unit = r.bench.plant.unit
    unit.tool_factor, unit.per_redeposition, unit.arc_tool = 1e-4, 0.0, unit.arc_work
    r.bench.plant.unit.arc_base = r.bench.plant.unit.arc_debris = 0.0
    face_um = over_the_work(r)
    scan(r, face_um - 1.0, passes=4)
    worn_um3 = r.bench.tool_wear_um * r.bench.plant.unit.tool_area_um2
    _, _, depth_um = r.bench.truth_map()
    cell_um2 = r.bench.plant.config.cell_um**2
    assert depth_um.sum() * cell_um2 == pytest.approx(worn_um3 / 1e-4, rel=1e-3)


def test_the_map_and_the_channel_in_it_survive_saving(rig: RigMaker) -> None:
    r = rig(SMALL, seed=7)
    face_um = over_the_work(r)
    scan(r, face_um - 1.0, passes=2)
    r.session.request(m.Disarm())
    r.wait(m.EventCode.MOVE_DONE, 5.0)
    again = restored_bench(bench_state(r.bench))
    for ours, theirs in zip(r.bench.truth_map(), again.truth_map(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert again.truth_map()[2].max() > 1.0
    assert again.truth() == ()
    assert again.plant.state.depth_um == r.bench.plant.state.depth_um > 0.0


def test_looking_at_the_truth_in_mid_scan_changes_nothing(rig: RigMaker) -> None:
    maps = []
    for looks in (False, True):
        r = rig(SMALL, seed=8)
        face_um = over_the_work(r)
        r.session.request(m.ScanStart(REFERENCE_V, face_um, 500.0))
        r.session.request(m.PathMove(LENGTH_UM, 0.0, 40.0, face_um, 1))
        for _ in range(10):
            r.session.pump(0.1)
            if looks:
                assert r.bench.truth_map()[2].max() >= 0.0
                bench_state(r.bench)
        r.wait(m.EventCode.PATH_DONE, 60.0)
        maps.append(r.bench.truth_map()[2])
    np.testing.assert_array_equal(maps[0], maps[1])


def test_a_tool_that_is_driven_into_a_wall_shorts_and_waits(rig: RigMaker) -> None:
    r = rig(SMALL, seed=9)
    over_the_work(r)
    r.start_sparking(max_time_s=25.0)
    r.wait(m.EventCode.TIME_UP, 30.0)
    depth_um = r.bench.truth()[0].depth_um
    assert depth_um > 8.0
    z_um = r.session.request(m.GetStatus()).displacement_um
    r.session.request(m.ScanStart(REFERENCE_V, z_um, 60.0))
    r.session.request(m.PathMove(LENGTH_UM, 0.0, SPEED_UM_S, z_um, 1))
    r.session.pump(LENGTH_UM / SPEED_UM_S)
    status = r.session.request(m.GetStatus())
    assert status.state == m.State.MACHINING
    assert 0.0 < status.x_um < 0.8 * LENGTH_UM
    assert status.displacement_um < z_um - 2.0


def test_stages_are_a_little_off_at_the_end_of_every_line(rig: RigMaker) -> None:
    r = rig(SMALL, seed=10)
    over_the_work(r)
    r.session.request(m.ScanStart(REFERENCE_V, 0.0, 60.0))
    off_um = []
    for i in range(12):
        r.session.request(m.PathMove(3.0 * (i + 1), 0.0, 100.0, 0.0, int(i == 11)))
        r.session.pump(0.1)
        status = r.session.request(m.GetStatus())
        assert (status.x_um, status.y_um) == pytest.approx((3.0 * (i + 1), 0.0))
        off_um.append(r.bench.plant.position_um - (status.x_um, status.y_um))
    assert 0.1 < np.std(off_um) < 1.5
