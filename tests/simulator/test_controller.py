"""The virtual controller as a board would behave: states, touches, limits, watchdog, faults, safe state."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.link import messages as m
from edmctl.link.session import CommandRefused
from edmctl.simulator import BenchConfig
from tests.simulator.conftest import RigMaker

TOUCH = m.TouchOff(20.0, 40.0, 1.0, 90.0, 5.0, 0.3, 3)


def test_touches_find_the_surface_within_their_spread(rig: RigMaker) -> None:
    r = rig().arm().to_pad()
    r.session.request(TOUCH)
    r.wait(m.EventCode.TOUCH_DONE, 120.0)
    touches = [e for e in r.events if e.code == m.EventCode.TOUCH]
    assert [e.arg for e in touches] == [1, 2, 3]
    found = np.mean([e.displacement_um for e in touches])
    plant = r.bench.plant
    expected = plant.state.surface_um * plant.unit.sensor_gain
    assert found == pytest.approx(expected, abs=0.6)
    assert np.std([e.displacement_um for e in touches]) < 0.5


def test_command_sinks_while_hunting_and_the_sensor_stays(rig: RigMaker) -> None:
    """Creep would push the tool into the work; hunting takes the voltage back (Muralidhara et al. 2009, Fig. 9a)."""
    r = rig().arm().to_pad()
    r.session.request(m.TlmStart(10_000, 10, m.PulseLog.OFF))
    r.session.request(m.TouchOff(20.0, 0.0, 20.0, 90.0, 5.0, 20.0, 1))
    r.wait(m.EventCode.TOUCH_DONE, 120.0)
    contact_v = next(e.actuator_v for e in r.events if e.code == m.EventCode.TOUCH)
    v, z = r.column("actuator_v"), r.column("displacement_um")
    first = int(np.argmax(v > contact_v - 0.2))
    hunting = slice(first + 100, first + 1900)
    assert contact_v - v[hunting][-200:].mean() > 0.2
    assert np.ptp(z[hunting].reshape(-1, 100).mean(axis=1)) < 0.3


def test_no_ramp_is_faster_than_the_slew_limit_either_way(rig: RigMaker) -> None:
    r = rig().arm({"slew_limit_v_s": 50.0})
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    for target_v in (60.0, 20.0):
        r.session.request(m.PiezoSet(target_v, 500.0))
        r.wait(m.EventCode.MOVE_DONE, 5.0)
    v = r.column("actuator_v")
    steps_v = v[20:] - v[:-20]  # over 20 ms: telemetry has steps of its own
    assert steps_v.max() == pytest.approx(1.0, abs=0.05)
    assert steps_v.min() == pytest.approx(-1.0, abs=0.05)


def test_the_generator_is_not_rewired_in_a_cut(rig: RigMaker) -> None:
    r = rig().arm().to_pad().start_sparking()
    r.session.pump(1.0)
    r.session.request(m.Jump(20.0, 500.0, 0.5, 2.0))
    assert r.bench.plant.drive.pulses_on == 0
    with pytest.raises(CommandRefused) as refused:
        r.session.request(m.PulseConfig(130.0, 300.0, 100.0, 3.0, m.PulseMode.ISOFREQUENCY, 0.0))
    assert refused.value.status == m.Status.BAD_STATE


def test_a_cut_ends_at_its_depth_limit_with_the_hole_in_the_work(rig: RigMaker) -> None:
    r = rig().arm().to_pad()
    r.session.request(m.TlmStart(10_000, 10, m.PulseLog.FULL))
    r.start_sparking(z_limit_um=60.0)
    end = r.wait(m.EventCode.CUT_DONE, 300.0)
    assert end.displacement_um == pytest.approx(60.0, abs=0.8)
    (hole,) = r.bench.truth()
    plant = r.bench.plant
    gap = plant.state.surface_um + hole.depth_um + r.bench.tool_wear_um - plant.state.true_z_um
    assert 2.0 < gap < 5.0
    assert r.bench.tool_wear_um / hole.depth_um == pytest.approx(0.389, abs=0.03)


def test_same_seed_same_bytes_whatever_the_slices(rig: RigMaker) -> None:
    def run(slice_s: float) -> bytes:
        r = rig(BenchConfig(), seed=11).arm().to_pad()
        r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
        r.start_sparking(max_time_s=3.0)
        for _ in range(round(3.2 / slice_s)):
            r.session.pump(slice_s)
        return b"".join(t.records for t in r.samples)[: 16 * 2500]

    assert run(0.1) == run(0.037)


def test_isopulse_discharges_last_as_set(rig: RigMaker) -> None:
    r = rig().arm()
    r.session.request(m.PulseConfig(130.435, 304.348, 40.0, 0.12, m.PulseMode.ISOPULSE, 20.0))
    r.to_pad()
    r.session.request(m.TlmStart(10_000, 10, m.PulseLog.FULL))
    r.start_sparking(max_time_s=2.0)
    r.wait(m.EventCode.TIME_UP, 10.0)
    data = np.frombuffer(b"".join(p.records for p in r.pulses), m.Pulses.record_dtype())
    normal = data[data["pulse_class"] == m.PulseClass.NORMAL]
    assert normal["discharge_us"].max() == 200
    assert np.median(normal["discharge_us"]) == 200
