"""Driving the record of a calibration."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from random import Random

import numpy as np
import pytest

from edmctl.actuator.waveforms import Leg
from edmctl.errors import Interrupted, LinkLost, MachineFault, RecordError
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.machine.interface import Axis, MachineState
from edmctl.machine.stop import StopRequest
from edmctl.machine.waits import VIRTUAL_SLICE_S
from edmctl.procedures import calibration as calibrating
from edmctl.procedures.calibration import (
    CalibrationPlan,
    MeasuredActuator,
    measure_actuator,
    plan_calibration,
)
from edmctl.profile.setup import Actuator, Controller, Sensor, Setup, Stage
from edmctl.results.progress import Phase, Progress
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.config import SensorConstants
from tests.procedures.conftest import Told, refused

SHORT = CalibrationPlan(
    (Leg(150.0, 2.0), Leg(0.0, 2.0), Leg(60.0, 0.06), Leg(60.0, 3.0), Leg(0.0, 0.5)), 5000
)


class Rig:
    def __init__(self, config: BenchConfig | None = None, setup: Setup | None = None) -> None:
        self.bench = open_bench(config or BenchConfig(), 1)
        self.session = Session(self.bench.transport, Random(1))
        self.session.open()
        self.stop = StopRequest()
        self.machine = LinkMachine(self.session, self.stop)
        self.setup = setup or Setup()
        self.told = Told()

    def measure(self, plan: CalibrationPlan = SHORT) -> MeasuredActuator:
        return measure_actuator(self.machine, self.setup, plan, self.told)

    def when_calibrating(self, act: Callable[[], None]) -> None:
        self.told.when[Phase.CALIBRATING] = act

    @property
    def applied_v(self) -> float:
        return self.bench.plant.drive.actuator_v


def test_the_plan_spans_the_stroke_and_ends_with_fast_swings_and_use() -> None:
    plan = plan_calibration(Setup())
    assert (plan.legs[0].u_v, plan.high_v) == (150.0, 150.0)
    assert sum(leg.duration_s for leg in plan.legs) == pytest.approx(296.2, abs=0.1)
    assert sum(leg.duration_s for leg in plan.fast) <= 15.0
    assert plan.duration_s == pytest.approx(391.3, abs=0.1)
    assert (plan.period_us, plan.fast_period_us) == (5000, 1000)
    assert plan.samples == pytest.approx(82_034, abs=20)
    assert min(leg.duration_s for leg in plan.fast) == pytest.approx(0.01)
    assert (plan.legs[-1].u_v, plan.fast[-1].u_v, plan.use[-1].u_v) == (0.0, 0.0, 0.0)


def test_the_plan_goes_by_the_setup_and_needs_a_sensor() -> None:
    setup = Setup(actuator=Actuator(stroke_v=100.0, slew_v_s=200.0))
    plan = plan_calibration(setup)
    assert plan.high_v == 100.0
    for legs in (plan.legs, plan.use):
        starts_v = [0.0, *(leg.u_v for leg in legs)]
        speeds = [abs(leg.u_v - v) / leg.duration_s for v, leg in zip(starts_v, legs, strict=False)]
        assert max(speeds) == pytest.approx(200.0)
    slow = plan_calibration(Setup(controller=Controller(telemetry_hz=100.0)))
    assert (slow.period_us, slow.fast_period_us) == (10_000, 10_000)
    with refused("E8034") as refusal:
        plan_calibration(Setup(sensor=Sensor(fitted=False)))
    assert "--from" in refusal.value.hint


def test_every_turning_point_and_hold_is_in_the_record() -> None:
    rig = Rig()
    measured = rig.measure()
    t_s, u_v, y_um = measured.record.t_s, measured.record.u_v, measured.record.y_um
    assert measured.lost_frames == 0
    assert t_s[0] == 0.0
    assert np.diff(t_s) == pytest.approx(np.full(len(t_s) - 1, 0.005))
    assert u_v.max() == 150.0
    assert (u_v == u_v[(np.abs(u_v - 60.0)).argmin()]).sum() >= 3.0 / 0.005
    assert (u_v[0], u_v[-1]) == (0.0, 0.0)
    assert np.ptp(y_um) == pytest.approx(445.0, rel=0.1)
    assert measured.record.name == "SIM-1"


def test_fast_legs_come_in_the_same_record_at_their_own_rate() -> None:
    fast = tuple(Leg(75.0 + swing_v, 0.02) for swing_v in (5.0, -5.0, 5.0, -5.0, 0.0))
    rig = Rig()
    plan = replace(SHORT, fast=(Leg(75.0, 0.3), *fast, Leg(0.0, 0.3)), use=(Leg(20.0, 0.5), Leg(0.0, 0.5)))
    measured = rig.measure(plan)
    t_s, u_v = measured.record.t_s, measured.record.u_v
    assert len(t_s) >= plan.samples
    assert t_s[-1] >= plan.duration_s - plan.period_s
    steps_s = np.diff(t_s)
    assert measured.lost_frames == 0
    assert (steps_s > 0.0).all()
    assert np.round(steps_s, 6).min() == 0.001
    assert steps_s.max() < 0.2
    quick = np.flatnonzero(np.round(steps_s, 6) == 0.001)
    assert (quick[-1] - quick[0] + 1) == len(quick)
    assert {80.0, 70.0} <= set(u_v[quick].round(3))
    assert (u_v[quick[-1] + 2 :].max(), u_v[-1]) == (20.0, 0.0)


def test_it_ends_retracted_and_idle_and_no_pulse_is_possible_meanwhile() -> None:
    rig = Rig()
    seen: set[tuple[int, int]] = set()

    class Watching(Told):
        def progress(self, p: Progress) -> None:
            Told.progress(self, p)
            seen.add((rig.bench.controller.seen.pulses_allowed, rig.bench.plant.drive.pulses_on))

    rig.told = Watching()
    rig.measure()
    assert seen == {(0, 0)}
    assert rig.machine.status().state is MachineState.IDLE
    assert rig.applied_v == 0.0
    left_s = [p.time_left_s for p in rig.told.states if p.phase is Phase.CALIBRATING]
    assert left_s[0] == pytest.approx(SHORT.duration_s, abs=0.1 + VIRTUAL_SLICE_S)  # of the first report
    assert left_s == sorted(left_s, reverse=True)
    assert left_s[-1] < 0.3


def test_a_machine_elsewhere_is_parked_first() -> None:
    rig = Rig(setup=Setup(stage=Stage(park_x_um=-4000.0, park_y_um=300.0)))
    rig.measure()
    assert rig.told.states[0].phase is Phase.MOVING
    reported = rig.bench.plant.reported
    assert (reported[Axis.X], reported[Axis.Y]) == (-4000.0, 300.0)


def test_a_tool_that_hangs_too_low_is_not_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibrating, "SAFE_Z_UM", -50.0)
    rig = Rig(setup=Setup(stage=Stage(park_x_um=-4000.0)))
    with refused("E8020", r"may move within -50\.0 µm"):
        rig.measure()
    assert rig.machine.status().state is MachineState.IDLE


@pytest.mark.parametrize(
    ("act", "error", "state"),
    [
        (lambda rig: setattr(rig.bench.plant, "estop", True), MachineFault, MachineState.ESTOP),
        (lambda rig: rig.stop.request(signal.SIGINT), Interrupted, MachineState.IDLE),
        (lambda rig: rig.bench.transport.close(), LinkLost, MachineState.FAULT),  # by the watchdog
    ],
)
def test_an_emergency_stop_ctrl_c_and_a_lost_line_retract(
    act: Callable[[Rig], None], error: type[Exception], state: MachineState
) -> None:
    rig = Rig()
    rig.when_calibrating(lambda: act(rig))
    with pytest.raises(error):
        rig.measure()
    if error is LinkLost:
        rig.bench.controller.advance(2000)
    assert rig.applied_v == 0.0
    assert rig.bench.controller.state is state


def test_a_dead_sensor_is_noticed_after_the_first_swing() -> None:
    rig = Rig(BenchConfig(sensors=SensorConstants(fitted=False)))
    with pytest.raises(RecordError) as refusal:
        rig.measure(plan_calibration(rig.setup))
    assert refusal.value.message.startswith("SIM-1: ")
    assert rig.machine.time_s < 10.0
    assert rig.machine.status().state is MachineState.IDLE
