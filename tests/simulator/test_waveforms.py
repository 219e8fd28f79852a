"""What the virtual controller keeps of the gap about a fault: the pulses that telemetry told, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.session import Session
from edmctl.simulator import BenchConfig
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.saving import bench_state, restored_bench
from tests.simulator.conftest import Rig, RigMaker

NEAR = BenchConfig(offset_um=20.0)
ON_US, OFF_US = 130.435, 304.348
PERIOD_US = ON_US + OFF_US
RECORD = m.WaveformReadReply.record_dtype()
TOLD = m.Pulses.record_dtype()


@dataclass(frozen=True)
class Waveforms:
    """A snapshot: time of its first sample, volts and amperes a microsecond apart."""

    t0_us: int
    v: NDArray[np.float64]
    a: NDArray[np.float64]


def read(session: Session) -> Waveforms:
    """Every sample."""
    data, total, t0_us = b"", 1, 0
    while len(data) < RECORD.itemsize * total:
        page = session.request(m.WaveformRead(len(data) // RECORD.itemsize))
        assert page.period_ns == 1000
        total, t0_us, data = page.total, page.t0_us, data + page.records
    assert session.request(m.WaveformRead(total)).n == 0
    rows = np.frombuffer(data, RECORD)
    return Waveforms(t0_us, rows["gap_v"] * 0.01, rows["current_a"] * 0.001)


def cutting(rig: RigMaker, log: m.PulseLog = m.PulseLog.FULL, seed: int = 1) -> Rig:
    """A rig in the middle of a cut."""
    r = rig(NEAR, seed=seed).arm().to_pad()
    r.session.request(m.TlmStart(1000, 14, log))
    r.start_sparking()
    r.session.pump(1.5)
    return r


def stopped(r: Rig, injection: str = "ESTOP@0") -> Waveforms:
    """What is kept after something went wrong."""
    r.bench.inject(parse_injection(injection))
    r.wait_fault(5.0)
    r.session.pump(0.1)
    return read(r.session)


def told_pulses(r: Rig) -> tuple[NDArray[np.float64], NDArray[np.void]]:
    """Start times in µs and records of all pulses that telemetry told."""
    starts = [p.t0_us + 1e-3 * p.period_ns * np.arange(p.n) for p in r.pulses]
    return np.concatenate(starts), np.frombuffer(b"".join(p.records for p in r.pulses), TOLD)


def test_the_samples_are_the_same_whatever_telemetry_tells_and_without_it_too(rig: RigMaker) -> None:
    full, off = (stopped(cutting(rig, log)) for log in (m.PulseLog.FULL, m.PulseLog.OFF))
    assert np.array_equal(full.v, off.v)
    assert np.array_equal(full.a, off.a)
    other = stopped(cutting(rig, seed=2))
    assert other.v[:1000].tolist() != full.v[:1000].tolist()


def test_drawing_takes_no_random_number_from_the_machine(rig: RigMaker) -> None:
    r = cutting(rig)
    stopped(r)
    controller = r.bench.controller
    before = bench_state(r.bench)
    controller.waveforms._records = b""
    read(r.session)
    after = bench_state(r.bench)
    assert before["plant"]["random"]["_noise"] == after["plant"]["random"]["_noise"]
    assert before["plant"]["stage_noise"] == after["plant"]["stage_noise"]


def test_a_cut_that_stopped_just_before_the_fault_leaves_the_pulses_that_there_were(rig: RigMaker) -> None:
    r = cutting(rig)
    r.session.request(m.ServoStop())
    r.session.pump(0.01)
    r.bench.controller.raise_fault(FaultCode.DOOR)
    r.session.pump(0.1)
    kept = read(r.session)
    before_us = r.faults[0].t_us - kept.t0_us
    starts_us, _ = told_pulses(r)
    assert before_us <= 64 * PERIOD_US
    assert (starts_us >= kept.t0_us - 1.5).sum() == pytest.approx(64 - 10_000 / PERIOD_US, abs=4)
    assert np.abs(kept.a[before_us - 9_000 :]).max() < 0.005


def test_another_setting_of_the_generator_begins_anew(rig: RigMaker) -> None:
    r = cutting(rig)
    r.session.request(m.ServoStop())
    r.session.request(m.PulseConfig(10.0, 30.0, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0))
    r.bench.controller.raise_fault(FaultCode.DOOR)
    r.session.pump(0.1)
    assert r.session.request(m.WaveformRead(0)).total == 0


@pytest.mark.parametrize(("injection", "reads_v"), [("GAP_SENSOR_HIGH@0", 40.0), ("GAP_SENSOR_LOW@0", 0.0)])
def test_a_stuck_gap_sensor_is_seen_in_the_voltage(rig: RigMaker, injection: str, reads_v: float) -> None:
    r = cutting(rig)
    kept = stopped(r, injection)
    fault = r.faults[0].t_us - kept.t0_us
    assert r.faults[0].code == FaultCode.GAP_SENSOR
    assert np.abs(kept.v[fault - 5000 :] - reads_v).max() < 0.02


def test_a_leaking_generator_is_seen_between_the_pulses(rig: RigMaker) -> None:
    r = cutting(rig)
    kept = stopped(r, "GENERATOR_LEAK@0")
    fault = r.faults[0].t_us - kept.t0_us
    assert r.faults[0].code == FaultCode.GEN_FAULT
    before = kept.a[fault - 1000 : fault]
    assert ((before > 0.045) & (before < 0.055)).sum() > 100
    assert np.abs(kept.a[: fault - 2000][kept.v[: fault - 2000] < 0.5]).max() < 0.04


def test_too_much_current_shows_from_when_it_flowed(rig: RigMaker) -> None:
    kept = stopped(cutting(rig), "OVER_CURRENT@0")
    assert kept.a[-10_000:].max() > 0.3
    assert kept.a[: len(kept.a) // 2].max() < 0.27


def test_a_fault_that_outlives_the_power_keeps_its_waveforms(rig: RigMaker) -> None:
    r = cutting(rig)
    kept = stopped(r, "DOOR@0")
    again = restored_bench(bench_state(r.bench))
    session = Session(again.transport, Random(3))
    session.open()
    restored = read(session)
    assert (restored.t0_us, restored.v.tolist()) == (kept.t0_us, kept.v.tolist())
    assert restored.a.tolist() == kept.a.tolist()
    session.request(m.ClearFault(FaultCode.DOOR))
    assert session.request(m.WaveformRead(0)).total == 0
