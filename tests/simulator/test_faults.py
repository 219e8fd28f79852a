"""Every fault that the controller detects: brought about, named, in time, safe, latched, repaired, cleared."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from edmctl.link import messages as m
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.session import CommandRefused
from edmctl.simulator import BenchConfig
from edmctl.simulator.injection import parse_injection
from tests.simulator.conftest import Rig, RigMaker

TOUCH = m.TouchOff(20.0, 40.0, 5.0, 90.0, 5.0, 0.1, 1)
NEAR = BenchConfig(offset_um=20.0)
OTHER_WAYS = {"DIELECTRIC_FLOW": 4003, "DIELECTRIC_HOT": 4003, "OVER_CURRENT": 3004, "GAP_SENSOR_LOW": 3003}
"""Injections that are not their fault's usual one."""


def usual() -> list[tuple[str, int]]:
    return [(row.inject, row.code) for row in FAULTS.values() if row.who == "controller"]


def run_job(r: Rig) -> None:
    """Arm, ramp, go to the pad, touch, approach and cut, until a fault comes."""
    steps: tuple[Callable[[], object], ...] = (
        lambda: r.session.request(m.PiezoSet(20.0, 100.0)),
        lambda: r.wait(m.EventCode.MOVE_DONE, 5.0),
        lambda: r.session.request(m.PiezoSet(0.0, 100.0)),
        lambda: r.wait(m.EventCode.MOVE_DONE, 5.0),
        r.to_pad,
        lambda: r.session.request(TOUCH),
        lambda: r.wait(m.EventCode.TOUCH_DONE, 60.0),
        lambda: r.session.request(m.PiezoSet(0.0, 100.0)),
        lambda: r.wait(m.EventCode.MOVE_DONE, 5.0),
        lambda: r.start_sparking(),
        lambda: r.session.pump_until(lambda: bool(r.faults), 60.0),
    )
    for step in steps:
        try:
            step()
        except (AssertionError, CommandRefused):
            assert r.faults, "the job ended without a fault"
        if r.faults:
            return
        r.session.pump(0.01)


def pulses_off_s(r: Rig, since_tick: int) -> float:
    """Time from a tick, or from the first pulses where those come later, to the last ones; telemetry at 1 kHz."""
    r.session.pump(0.05)
    flags = r.column("flags").astype(int)
    (first,) = {t.t0_us for t in r.samples[:1]}
    ticks = first // 1000 + np.arange(flags.size)
    on = ticks[(flags & m.TlmFlags.PULSES_ON) > 0]
    if not on.size:
        return 0.0
    return max(0, int(on[-1]) - max(since_tick, int(on[0]))) * 1e-3


@pytest.mark.parametrize(
    ("inject", "code"), usual() + list(OTHER_WAYS.items()), ids=[i for i, _ in usual()] + list(OTHER_WAYS)
)
def test_a_fault_is_named_in_time_safe_latched_and_cleared(rig: RigMaker, inject: str, code: int) -> None:
    row = FAULTS[code]
    r = rig(NEAR)
    line_fault = code == FaultCode.LINE_NOISE
    params = {"piezo_max_v": 24.0} if code == FaultCode.TRAVEL_LIMIT else {}
    r.arm(params)
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    r.session.request(m.Disarm())
    r.wait(m.EventCode.MOVE_DONE, 5.0)
    injection = parse_injection(inject)
    r.bench.inject(injection)
    crc = r.bench.controller.seen.param_crc
    r.session.request(m.Arm(crc))
    r.session.request(m.PulseEnable(1))
    if code == FaultCode.HOST_SILENT:
        silent_host(r)
    elif line_fault:
        noisy_host(r)
    else:
        run_job(r)
    controller, plant = r.bench.controller, r.bench.plant
    assert controller.fault == code
    assert plant.drive.pulses_on == 0
    applied = [tick for done, tick in controller.injector.applied if done == injection]
    r.bench.line.silent = False
    if row.code not in WAITS:
        assert pulses_off_s(r, applied[0]) <= row.pulses_off_s + 1e-9
    controller.advance(1500)
    assert (plant.drive.actuator_v, plant.drive.pulses_on) == (0.0, 0)
    assert controller.state is (m.State.ESTOP if code == FaultCode.ESTOP else m.State.FAULT)
    assert r.session.request(m.GetStatus()).x_um == pytest.approx(plant.reported[0], abs=0.01)
    for forbidden in (m.Arm(crc), m.PiezoSet(10.0, 10.0), m.ClearFault(9999), m.PulseEnable(1), m.Disarm()):
        with pytest.raises(CommandRefused):
            r.session.request(forbidden)
    assert controller.fault == code
    r.bench.clear_injections()
    r.session.request(m.ClearFault(code))
    clean_cut(r, params)


WAITS = {
    FaultCode.HOST_SILENT,
    FaultCode.TRAVEL_LIMIT,
    FaultCode.NO_SPARK,
    FaultCode.LINE_NOISE,
    FaultCode.STAGE_LIMIT,
}
"""Faults whose cause is not the injection itself; their time is tested by itself."""


def silent_host(r: Rig) -> None:
    """Let sparks flow; then the line swallows what the host says."""
    r.to_pad()
    r.start_sparking()
    r.session.pump(0.9)
    controller = r.bench.controller
    while not controller.injector.applied:
        controller.host_heard()
        controller.advance(1)
    ((_, since),) = controller.injector.applied
    while r.bench.plant.drive.pulses_on == 1:
        r.bench.transport.write(b"\x00anything\x00")
        controller.advance(1)
    assert (controller.tick - since) * 1e-3 <= FAULTS[FaultCode.HOST_SILENT].pulses_off_s


def noisy_host(r: Rig) -> None:
    """Let sparks flow; then frames arrive damaged, as the line carries them."""
    r.to_pad()
    r.start_sparking()
    controller = r.bench.controller
    while not controller.injector.applied:
        r.session.pump(0.001)
    assert r.bench.line.noise > 0.0
    for n in range(9):
        controller.receive(b"\x00damaged %d\x00" % n)
    assert controller.fault == 0
    controller.receive(b"\x00damaged again\x00")
    assert r.bench.plant.drive.pulses_on == 0


def clean_cut(r: Rig, params: dict[str, float]) -> None:
    """A new session machines for a second, with nothing latched."""
    r.faults.clear()
    r.session.open()
    r.arm(params)
    r.session.request(m.StageMove(m.Axis.X, 500_000, 50_000_000))
    r.wait(m.EventCode.STAGE_DONE, 10.0)
    r.start_sparking(max_time_s=1.0)
    r.wait(m.EventCode.TIME_UP, 10.0)
    assert r.bench.truth()


def test_travel_limit_no_spark_and_stage_limit_keep_their_time(rig: RigMaker) -> None:
    r = rig(NEAR).arm({"piezo_max_v": 22.0}).to_pad()
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    r.start_sparking()
    r.bench.inject(parse_injection("TRAVEL_LIMIT"))
    assert r.wait_fault(300.0).code == FaultCode.TRAVEL_LIMIT
    r.session.pump(0.05)
    flags = r.column("flags").astype(int)
    at_limit = (flags & m.TlmFlags.AT_LIMIT) > 0
    since = int(np.flatnonzero(~at_limit[: np.flatnonzero(at_limit)[-1]])[-1]) + 1
    on = np.flatnonzero(flags & m.TlmFlags.PULSES_ON)
    assert (int(on[-1]) - since) * 1e-3 <= FAULTS[FaultCode.TRAVEL_LIMIT].pulses_off_s

    r = rig(NEAR).arm().to_pad().start_sparking()
    r.session.pump(1.0)
    r.bench.inject(parse_injection("NO_SPARK@0"))
    start = r.bench.controller.tick
    assert r.wait_fault(20.0).code == FaultCode.NO_SPARK
    assert (r.faults[0].t_us / 1000 - start) * 1e-3 <= FAULTS[FaultCode.NO_SPARK].pulses_off_s

    r = rig(NEAR).arm()
    r.session.request(m.StageMove(m.Axis.X, 0, 1_000_000))
    r.session.pump(1.0)
    due_s = r.bench.controller.tick * 1e-3 + 0.123
    r.bench.inject(parse_injection(f"STAGE_LIMIT@{due_s:.3f}"))
    fault = r.wait_fault(1.0)
    assert fault.code == FaultCode.STAGE_LIMIT
    assert fault.t_us * 1e-6 - due_s <= 0.005
    assert r.bench.plant.reported[0] == pytest.approx(-5000.0 + 1000.0 * 1.123, abs=5.0)


def test_an_idle_machine_obeys_the_emergency_stop_and_nothing_else(rig: RigMaker) -> None:
    r = rig()
    r.bench.inject(parse_injection("DOOR@0"))
    r.session.pump(0.3)
    assert r.session.hello.state == m.State.IDLE
    assert r.session.request(m.GetStatus()).interlocks == m.Interlocks.DOOR
    r.bench.inject(parse_injection("ESTOP@0"))
    r.session.pump(0.3)
    assert r.bench.controller.state is m.State.ESTOP


@pytest.mark.parametrize("cause", ["WATCHDOG", "BROWN_OUT", "POWER_LOSS"])
def test_a_reset_in_a_cut_ends_safe_and_without_a_session(rig: RigMaker, cause: str) -> None:
    r = rig(NEAR)
    boots: list[m.Boot] = []
    r.session.subscribe(m.Boot, boots.append)
    r.arm()
    r.to_pad()
    r.start_sparking()
    r.bench.inject(parse_injection(cause))
    controller, plant = r.bench.controller, r.bench.plant
    while not controller.injector.applied:
        controller.host_heard()
        controller.advance(10)
    assert plant.drive.pulses_on == 0
    assert controller.boot_count == 2
    assert controller.time_us < 20_000
    controller.advance(1500)
    assert plant.drive.actuator_v == 0.0
    expected = 0 if cause == "POWER_LOSS" else FaultCode.RESET
    assert controller.fault == expected
    assert controller.state is (m.State.FAULT if expected else m.State.IDLE)
    assert controller.seen.param_crc == m.param_crc({})
    if expected:
        r.session.open()
        r.session.request(m.ClearFault(expected))
    clean_cut(r, {})


def test_the_line_unplugged_and_noise_are_left_to_whoever_carries_the_bytes(rig: RigMaker) -> None:
    r = rig()
    r.bench.inject(parse_injection("UNPLUG@0"))
    r.bench.inject(parse_injection("LINE_NOISE@0"))
    r.bench.controller.advance(2)
    assert (r.bench.line.unplugged, r.bench.line.noise) == (True, 0.5)
    r.bench.clear_injections()
    assert (r.bench.line.unplugged, r.bench.line.noise) == (False, 0.0)


def test_faults_of_the_host_are_brought_about_too(rig: RigMaker) -> None:
    r = rig(NEAR)
    plant = r.bench.plant
    before = (plant.unit.numbers(), plant.state.walk_um)
    for name in ("Z_MISMATCH", "STALL", "SETUP"):
        r.bench.inject(parse_injection(f"{FAULTS[FaultCode[name]].inject}@0"))
    now_s = r.bench.controller.tick * 1e-3
    r.bench.controller.advance(10_000)
    drift = r.bench.controller.loop.displacement_um - plant.state.true_z_um
    assert drift == pytest.approx(5.0 * (10.0 - now_s), abs=2.0)
    assert plant.unit.threshold_uj > 1e6
    assert plant.unit.tool_factor == pytest.approx(5.0 * before[0]["tool_factor"])
    r.bench.clear_injections()
    assert plant.unit.numbers() == before[0]
    assert plant.state.walk_um == before[1]


def test_an_arc_ends_with_the_pulse_that_makes_its_run_full(rig: RigMaker) -> None:
    """At 1 kHz every millisecond has one pulse."""
    r = rig()
    r.bench.inject(parse_injection("CARBON@sparks+2"))
    r.arm({"arc_run": 20})
    r.session.request(m.PulseConfig(300.0, 700.0, 40.0, 0.12, m.PulseMode.ISOFREQUENCY, 0.0))
    r.to_pad()
    r.session.request(m.TlmStart(1000, 14, m.PulseLog.OFF))
    r.start_sparking()
    assert r.wait_fault(10.0).code == FaultCode.ARC_BURN
    r.session.pump(0.2)
    arcs = r.column("n_arc")
    last = np.flatnonzero(arcs)[-1]
    assert arcs[last - 19 : last + 1].sum() == 20.0
    assert arcs[last - 20] == 0.0
