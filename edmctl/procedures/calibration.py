"""Record the motions from which an actuator is identified: at the parking place, without pulses.

Full swings, first-order reversal curves, minor loops, holds and cycles of 1 s to 50 s separate hysteresis, creep and
delay; swings of up to 50 Hz lag from delay. Typical motions of a job follow, as some actuators slide by small moves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl import failures
from edmctl.actuator.record import Record, check_record
from edmctl.actuator.waveforms import SLEW_V_S, Leg, calibration_legs
from edmctl.dataclasses import dataclass, field
from edmctl.errors import stages_by_hand
from edmctl.machine.interface import (
    Axis,
    Machine,
    MachineListener,
    PulseLog,
    TelemetryBlock,
    TelemetrySettings,
    joined,
)
from edmctl.machine.stop import safe_state_on_error
from edmctl.procedures.monitoring.drift import DRIFT_SDS, first_home_um
from edmctl.procedures.run import NO_PULSES
from edmctl.procedures.settings import motion_settings, retract_v_s
from edmctl.procedures.stages import CREEP_LOOK_S, CREEP_WAIT_S, READING_MARGIN_UM
from edmctl.profile.setup import Setup
from edmctl.results.progress import Observer, Phase, Progress

RATE_HZ = 200.0  # 60 000 samples in five minutes; the fastest swing, of 1 s, has 200 of them
FAST_HZ = 1000.0
BATCH, FRAME_S = 14, 0.1  # samples in a telemetry frame, and longest wait for one
FAST_BATCH = 4  # samples in a frame of the fast legs, whose moves wait for the frame with their end
SAFE_Z_UM = 20.0  # the stages may move while the tool reads at most this: above every permitted workpiece
REST_S = 1.0  # rest before the first swing, so that the record starts from an actuator at rest


@dataclass(frozen=True, slots=True)
class CalibrationPlan:
    """Motions of a calibration, beginning at 0 V: `legs`, then `fast`, then `use`."""

    legs: tuple[Leg, ...]
    period_us: int
    fast: tuple[Leg, ...] = ()
    fast_period_us: int = 1000
    use: tuple[Leg, ...] = ()

    @property
    def high_v(self) -> float:
        """Highest voltage; the lowest is 0 V."""
        return max(leg.u_v for leg in self.legs)

    @property
    def period_s(self) -> float:
        """Sample period of all but the fast legs."""
        return 1e-6 * self.period_us

    @property
    def duration_s(self) -> float:
        """Least length of the record: rests, legs, and a sample at every turning point."""
        return sum(self._lengths_s)

    @property
    def samples(self) -> int:
        """Least number of samples of the record."""
        slow_s, fast_s = self._lengths_s
        return round(slow_s / self.period_s + fast_s / (1e-6 * self.fast_period_us))

    @property
    def _lengths_s(self) -> tuple[float, float]:
        def length_s(legs: Sequence[Leg], period_s: float) -> float:
            starts_v = [0.0, *(leg.u_v for leg in legs[:-1])]
            moves = sum(leg.u_v != start_v for leg, start_v in zip(legs, starts_v, strict=False))
            return sum(leg.duration_s for leg in legs) + period_s * moves

        slow_s = REST_S + sum(length_s(legs, self.period_s) for legs in (self.legs, self.use))
        return slow_s, length_s(self.fast, 1e-6 * self.fast_period_us)


@dataclass(frozen=True, slots=True)
class MeasuredActuator:
    """A record of a machine's actuator; `lost_frames` of telemetry are missing from it."""

    record: Record
    lost_frames: int


def plan_calibration(setup: Setup) -> CalibrationPlan:
    """Plan over the whole stroke. Raises PreconditionError E8034 without a sensor."""
    if not setup.sensor.fitted:
        raise failures.calibrating_without_sensor()
    tick_us, most_hz = setup.controller.servo_period_us, setup.controller.telemetry_hz
    slow_us, fast_us = (
        tick_us * max(1, round(1e6 / min(rate_hz, most_hz) / tick_us)) for rate_hz in (RATE_HZ, FAST_HZ)
    )
    slow, fast, use = calibration_legs(setup.actuator.stroke_v, min(SLEW_V_S, setup.actuator.slew_v_s))
    return CalibrationPlan(legs=slow, period_us=slow_us, fast=fast, fast_period_us=fast_us, use=use)


def measure_actuator(
    machine: Machine, setup: Setup, plan: CalibrationPlan, observer: Observer
) -> MeasuredActuator:
    """Drive the plan on an idle machine and record the sensor; retracted and idle in the end.

    Raises RecordError after the first swing if the sensor does not show it; otherwise MachineFault, LinkLost,
    PreconditionError and Interrupted as every procedure, with the safe state reached first.
    """
    listener = _Listener(observer, plan.duration_s)
    with safe_state_on_error(machine):
        machine.configure(motion_settings(setup, SAFE_Z_UM, sensor_fitted=True, pulses=False))
        _sample(machine, plan.period_us, listener)
        machine.arm(pulses=False)
        _park(machine, setup, listener)
        listener.begin()
        machine.rest(REST_S)
        swing, others = plan.legs[:2], plan.legs[2:]
        _drive(machine, swing, plan.period_us)
        check_record(listener.record(machine))
        _drive(machine, others, plan.period_us)
        if plan.fast:
            _drive_fast(machine, plan, listener)
        _drive(machine, plan.use, plan.period_us)
        machine.disarm()
        machine.stop_telemetry()
    return MeasuredActuator(listener.record(machine), listener.lost_frames)


def _sample(machine: Machine, period_us: int, listener: _Listener, *, fast: bool = False) -> None:
    batch = max(1, min(FAST_BATCH if fast else BATCH, round(FRAME_S / (1e-6 * period_us))))
    machine.start_telemetry(TelemetrySettings(period_us, batch, PulseLog.OFF), listener)


def _drive_fast(machine: Machine, plan: CalibrationPlan, listener: _Listener) -> None:
    machine.rest(FRAME_S)
    machine.stop_telemetry()
    _sample(machine, plan.fast_period_us, listener, fast=True)
    machine.rest(FRAME_S)
    _drive(machine, plan.fast, plan.fast_period_us)
    machine.rest(FRAME_S)
    machine.stop_telemetry()
    _sample(machine, plan.period_us, listener)
    machine.rest(FRAME_S)


def _park(machine: Machine, setup: Setup, listener: _Listener) -> None:
    """Retract, and move to the parking place if the machine is not there yet, as soon as creep allows that."""
    stage = setup.stage
    machine.ramp(0.0, retract_v_s(setup))
    status = machine.status()
    places = ((Axis.X, status.x_um, stage.park_x_um), (Axis.Y, status.y_um, stage.park_y_um))
    ways = [
        (axis, target_um)
        for axis, here_um, target_um in places
        if abs(target_um - here_um) > stage.repeatability_um
    ]
    if not ways:
        return
    listener.report(Phase.MOVING, machine.time_s)
    end_s = machine.time_s + CREEP_WAIT_S
    while True:
        here_um = machine.status().displacement_um
        drift_um = DRIFT_SDS * setup.sensor.drift_um_per_s * machine.uptime_s
        if here_um + drift_um <= SAFE_Z_UM - READING_MARGIN_UM:
            break
        if machine.time_s > end_s:
            raise failures.sensor_reading_at_rest(
                here_um=here_um, drift_um=drift_um, safe_z_um=SAFE_Z_UM, stages_by_hand=stages_by_hand()
            )
        machine.rest(CREEP_LOOK_S)
    machine.set_zero(first_home_um(here_um, 0.0, drift_um))
    for axis, target_um in ways:
        machine.move_stage(axis, target_um, stage.speed_um_s)


def _drive(machine: Machine, legs: Sequence[Leg], period_us: int, start_v: float = 0.0) -> None:
    """Ramp, and wait for one sample, so that the turning point is in the record; or hold."""
    for leg in legs:
        if leg.u_v == start_v:
            machine.rest(leg.duration_s)
            continue
        machine.ramp(leg.u_v, abs(leg.u_v - start_v) / leg.duration_s)
        machine.rest(1e-6 * period_us)
        start_v = leg.u_v


@dataclass(slots=True)
class _Listener(MachineListener):
    """Collects telemetry from `begin` on, and reports the progress of the record."""

    observer: Observer
    duration_s: float
    blocks: list[TelemetryBlock] = field(default_factory=list)
    begin_s: float = math.nan
    lost_frames: int = 0
    newest_s: float = 0.0
    displacement_um: float = math.nan

    def begin(self) -> None:
        self.blocks.clear()
        self.begin_s = self.newest_s
        self.lost_frames = 0

    def record(self, machine: Machine) -> Record:
        """Return the record. Raises LinkLost E4020 without any samples."""
        if not self.blocks:
            raise failures.no_telemetry()
        block = joined(self.blocks)
        t_s = block.time_s - block.time_s[0]
        return Record(t_s, block.actuator_v, block.displacement_um, None, machine.identity.serial)

    def telemetry(self, block: TelemetryBlock) -> None:
        self.blocks.append(block)
        self.lost_frames += block.missing_frames
        self.newest_s = float(block.time_s[-1])
        self.displacement_um = float(block.displacement_um[-1])
        if not math.isnan(self.begin_s):
            self.report(Phase.CALIBRATING, self.newest_s)

    def report(self, phase: Phase, time_s: float) -> None:
        self.observer.progress(
            Progress(
                phase=phase,
                time_s=time_s,
                gap_v=0.0,
                reference_v=0.0,
                ratios=NO_PULSES,
                depth_um=math.nan,
                depth_target_um=math.nan,
                displacement_um=self.displacement_um,
                time_left_s=max(0.0, self.begin_s + self.duration_s - time_s),
            )
        )

    def log(self, level: int, text: str) -> None:
        self.observer.note(f"controller: {text}")
