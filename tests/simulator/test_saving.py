"""A bench that was saved and restored is the bench whose power was cut: the same bytes from there on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from copy import deepcopy
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.session import Session
from edmctl.record.bench_file import read_bench, write_bench
from edmctl.simulator import (
    BenchConfig,
    DischargeConstants,
    SensorConstants,
    VirtualBench,
    open_bench,
)
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.plant import BLOCK
from edmctl.simulator.plant_records import Drive, Readings
from edmctl.simulator.saving import bench_state, restored_bench
from tests.simulator.conftest import Rig, RigMaker
from tests.tiers import tiers

NEAR = BenchConfig(offset_um=20.0, discharge=DischargeConstants(scatter=0.4))


def power_cycled(bench: VirtualBench) -> VirtualBench:
    """The bench itself after its power was cut at rest: its controller has what outlives that."""
    bench.controller.take_up(bench.controller.kept())
    bench.controller.reset(m.ResetCause.POWER_ON)
    bench.controller.link.take_output()
    return bench


def cut(rig: Rig) -> None:
    """Some sparks in the work with the tool turned, and back to 0 V and IDLE."""
    rig.arm()
    rig.session.request(m.StageMove(m.Axis.THETA, 30_000, 50_000_000))
    rig.wait(m.EventCode.STAGE_DONE, 5.0)
    rig.to_pad()
    rig.start_sparking()
    rig.session.pump(2.0)
    rig.session.request(m.ServoStop())
    rig.session.request(m.Disarm())
    rig.wait(m.EventCode.MOVE_DONE, 5.0)


def next_bytes(bench: VirtualBench) -> bytes:
    """All that a bench says in two touches and another cut in the same hole."""
    said, first_pulse = bytearray(), bench.controller.loop.pulse_no
    read = bench.transport.read

    def listening(timeout_s: float) -> bytes:
        data = read(timeout_s)
        said.extend(data)
        return data

    bench.transport.read = listening  # type: ignore[method-assign]
    session = Session(bench.transport, Random(2))
    touches = list[m.Event]()
    session.subscribe(m.Event, lambda e: touches.append(e) if e.code == m.EventCode.TOUCH else None)
    session.open()
    session.request(m.TlmStart(1000, 10, m.PulseLog.FULL))
    crc = m.param_crc({})
    session.request(m.CommitProfile(crc))
    session.request(m.GetStatus())
    # So fast that new random numbers are drawn on the way.
    session.request(m.PulseConfig(15.0, 35.0, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0))
    session.request(m.Arm(crc))
    session.request(m.PulseEnable(1))
    for y_nm in (100_000, 0):
        session.request(m.StageMove(m.Axis.Y, y_nm, 5_000_000))
        session.pump(0.2)
    session.request(m.TouchOff(20.0, 10.0, 5.0, 90.0, 5.0, 0.1, 2))
    session.pump(8.0)
    assert len(touches) == 2
    session.request(m.Approach(5.0, 120.0, 10.8))
    session.pump(8.0)
    session.request(m.ServoStart(9.6, 500.0, 100.0))
    session.pump(2.0)
    assert bench.controller.loop.pulse_no - first_pulse > BLOCK
    assert len(bench.truth()) == 1
    return bytes(said)


def test_a_run_after_saving_and_restoring_is_the_run_without(rig: RigMaker, tmp_path: Path) -> None:
    r = rig(NEAR, seed=7)
    cut(r)
    write_bench(tmp_path / "b.h5", bench_state(r.bench))
    again = restored_bench(read_bench(tmp_path / "b.h5"))
    assert again.truth() == r.bench.truth()
    assert again.plant.config == NEAR
    assert again.plant.theta_deg == r.bench.plant.theta_deg != 0.0
    assert next_bytes(again) == next_bytes(power_cycled(r.bench))


def test_saving_changes_nothing(rig: RigMaker) -> None:
    runs = []
    for saves in (0, 3):
        r = rig(NEAR, seed=8)
        cut(r)
        for _ in range(saves):
            bench_state(r.bench)
        runs.append(next_bytes(r.bench))
    assert runs[0] == runs[1]


def test_a_state_saved_again_is_the_same_state(rig: RigMaker) -> None:
    r = rig(NEAR, seed=9)
    cut(r)
    once = bench_state(restored_bench(bench_state(r.bench)))
    first, second = flat(once), flat(bench_state(restored_bench(once)))
    assert first.keys() == second.keys()
    differing = {name for name in first if not same(first[name], second[name])}
    assert differing == {"controller.kept.numbers.boot_count"}


def test_a_machine_saved_in_mid_cut_has_lost_its_power_and_retracted(rig: RigMaker) -> None:
    r = rig(NEAR, seed=1).arm().to_pad().start_sparking()
    r.session.pump(2.0)
    again = restored_bench(bench_state(r.bench))
    assert r.bench.controller.state is m.State.MACHINING
    assert (again.controller.state, again.controller.fault) == (m.State.IDLE, 0)
    assert again.controller.loop.command_v == 0.0
    assert again.controller.boot_count == r.bench.controller.boot_count + 1
    assert again.truth() == r.bench.truth()
    assert again.controller.link.take_output() == b""


@pytest.mark.parametrize(("name", "state"), [("ESTOP", m.State.ESTOP), ("DOOR", m.State.FAULT)])
def test_a_latched_fault_and_its_black_box_are_kept_and_what_was_broken_is_repaired(
    name: str, state: m.State, rig: RigMaker
) -> None:
    r = rig(NEAR, seed=1).arm()
    r.bench.inject(parse_injection(f"{name}@0.3"))
    fault = r.wait_fault(2.0)
    r.session.pump(1.0)
    again = restored_bench(bench_state(r.bench))
    assert (again.controller.state, again.controller.fault) == (state, fault.code)
    assert again.controller.seen.interlocks == 0
    assert r.bench.controller.seen.interlocks != 0
    session = Session(again.transport, Random(3))
    hello = session.open()
    assert (hello.fault, hello.reset_cause, hello.boot_count) == (fault.code, m.ResetCause.POWER_ON, 2)
    box = session.request(m.BlackboxRead(0))
    assert box == r.session.request(m.BlackboxRead(0))
    session.request(m.ClearFault(fault.code))
    assert again.controller.state is m.State.IDLE


def test_a_bench_without_a_sensor_and_a_long_serial_come_back() -> None:
    config = BenchConfig(sensors=SensorConstants(fitted=False))
    bench = open_bench(config, 2**63 - 1)
    again = restored_bench(bench_state(bench))
    assert (again.plant.serial, again.plant.config) == (bench.plant.serial, config)
    assert again.plant.config.sensors.fitted is False


@pytest.mark.parametrize(
    "spoil",
    [
        lambda state: state.pop("plant"),
        lambda state: state["plant"]["state"]["numbers"].pop("depth_um"),
        lambda state: state["plant"]["unit"].update(play_um_per_v=np.zeros(7)),
        lambda state: state["plant"].update(here=5),
        lambda state: state["plant"].update(stage_noise="{}"),
        lambda state: state["plant"].update(stage_noise=1),
        lambda state: state["config"].update(colour=1.0),
        lambda state: state["config"].update(dielectric_flow_lpm="x"),
        lambda state: state["config"].update(offset_um=10**400),
        lambda state: state["config"]["sensors"].update(noise_um=None),
        lambda state: state["controller"]["kept"]["numbers"].update(fault="none"),
        lambda state: state.update(config=1.0),
        lambda state: state["config"].update(cell_um=1e-6),
        lambda state: state["plant"].update(position_um=np.full(2, math.inf)),
        lambda state: state["plant"]["random"]["pulse"].fill(1.0),
        lambda state: state["plant"]["reported"].__setitem__(0, math.nan),
        lambda state: state["config"].update(thickness_um=math.nan),
        lambda state: state["controller"]["kept"]["numbers"].update(fault=12345),
    ],
)
def test_a_state_that_does_not_fit_is_refused_in_words(spoil: Callable[[Any], object]) -> None:
    state: Any = bench_state(open_bench(BenchConfig(), 1))
    spoil(state)
    with pytest.raises(RunFileError, match="does not fit this version") as caught:
        restored_bench(state)
    assert caught.value.code == "E9021"


HOSTILE = (math.nan, math.inf, -math.inf, 0, -1, 0.5, 65, 1 << 20, 1 << 59, -(1 << 62), 1 << 70, -1e300)
"""Numbers that files of no bench have."""


def gate_on(_: Readings, drive: Drive) -> None:
    """A controller whose pulses are on, whatever happens; stages move."""
    drive.pulses_on = drive.stage_moves = 1
    drive.actuator_v = 40.0


@pytest.mark.parametrize("part", ["unit", "state", "drive", "readings", "kept"])
@pytest.mark.parametrize("seed", tiers(1, slow=range(2, 12)))
def test_no_number_of_a_file_makes_the_library_read_or_write_elsewhere(part: str, seed: int) -> None:
    """Whatever one number is, the file is refused, or its machine lives."""
    random, bench = Random(seed), open_bench(NEAR, 1)
    bench.controller.raise_fault(FaultCode.DOOR)
    kept: Any = bench_state(bench)
    names = list((kept["controller"] if part == "kept" else kept["plant"])[part]["numbers"])
    for name in names:
        state = deepcopy(kept)
        owner = state["controller"] if part == "kept" else state["plant"]
        owner[part]["numbers"][name] = random.choice(HOSTILE)
        try:
            again = restored_bench(state)
        except RunFileError:
            continue
        session = Session(again.transport, Random(3))
        session.open()
        for request in (m.BlackboxRead(0), m.BlackboxRead(2000), m.WaveformRead(0), m.GetStatus()):
            session.request(request)
        again.plant.advance(gate_on, 130)


@pytest.mark.parametrize(
    ("part", "name", "number"),
    [
        ("state", "random_at", BLOCK + 1),
        ("state", "noise_at", -1),
        ("state", "previous_burning", 256.0),
        ("state", "previous_burning", math.nan),
        ("unit", "pulse_period_ns", 0),
        ("unit", "stray_pulses", 1 << 70),
        ("drive", "stage_line", 16),
        ("readings", "pulses", 65),
    ],
)
def test_a_place_outside_of_an_array_is_refused(part: str, name: str, number: float) -> None:
    state: Any = bench_state(open_bench(BenchConfig(), 1))
    state["plant"][part]["numbers"][name] = number
    with pytest.raises(RunFileError, match=name):
        restored_bench(state)


def test_waveforms_that_are_not_those_of_the_fault_are_refused(rig: RigMaker) -> None:
    r = rig(NEAR, seed=1).arm().to_pad().start_sparking()
    r.session.pump(1.0)
    r.bench.controller.raise_fault(FaultCode.DOOR)
    r.session.pump(0.5)
    state: Any = bench_state(r.bench)
    assert restored_bench(state).controller.waveforms.frozen is not None
    spoils: list[Callable[[Any], object]] = [
        lambda controller: controller.pop("waveform_times_ns"),
        lambda controller: controller["kept"]["numbers"].update(waves_end_ns=10**12),
        lambda controller: controller["waveform_pulses"].__setitem__((3, 0), math.nan),
        lambda controller: controller["waveform_times_ns"].__setitem__(1, 0),
    ]
    for spoil in spoils:
        spoiled = deepcopy(state)
        spoil(spoiled["controller"])
        with pytest.raises(RunFileError, match="waveform"):
            restored_bench(spoiled)


def flat(state: Mapping[str, object], prefix: str = "") -> dict[str, Any]:
    """Every leaf by its dotted name."""
    leaves: dict[str, Any] = {}
    for name, value in state.items():
        if isinstance(value, Mapping):
            leaves |= flat(value, f"{prefix}{name}.")
        else:
            leaves[prefix + name] = value
    return leaves


def same(one: Any, other: Any) -> bool:
    """Whether two leaves are equal; what is no number equals itself here."""
    return np.array_equal(one, other) or (one != one and other != other)
