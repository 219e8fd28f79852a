"""A machine without a displacement sensor: its calibrated actuator converts between voltage and displacement.

The controller reports the mean gain times the voltage. Here samples, events and touches get the estimate at their
time. Heights that a motion must not pass are sent as the voltage of the exact inverse, with a margin for its error.
The end of a cut is watched ten times a second, because creep changes its voltage; the controller has a limit beyond.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

from edmctl.actuator.correction import SlowCorrection
from edmctl.actuator.inverse import travel_by
from edmctl.machine.interface import (
    SLICE_S,
    CutRequest,
    EventCode,
    Machine,
    MachineEvent,
    MachineListener,
    MachineState,
    MachineStatus,
    ScanLine,
    TelemetryBlock,
    TelemetrySettings,
    Touch,
    TouchRequest,
)
from edmctl.procedures.actuator.tracker import Trace, Tracker, at_rest
from edmctl.procedures.job import CalibratedActuator

MARGIN_SHARE = 0.03
"""Error of a height by the inverse, as a share of the way there: 2.5 % of gain between days, and the model's own."""
MARGIN_UM = 2.0
"""The same, at least."""
SHORT, AT, BEYOND = -1.0, 0.0, 1.0


class DisplacementEstimates:
    """Replaces the displacement of every sample and event by the estimate, and passes all to a `MachineListener`.

    `displacement_um` is the newest estimate, `cutting_um` its mean over the newest samples of a cut.
    """

    def __init__(self, calibration: CalibratedActuator) -> None:
        estimator = at_rest(calibration.model, 0.0)
        # Displacements count from the actuator at rest, as with a sensor; `at_rest` is there already.
        estimator.correct(1.0, -estimator.tick(estimator.state.u_v, 0.0))
        self.tracker = Tracker(estimator, SlowCorrection(), calibration.held_out_rms_um)
        self.listener: MachineListener | None = None
        self._trace = Trace()
        self._started = False
        self.displacement_um = 0.0
        self.cutting_um = 0.0

    def __getattr__(self, name: str) -> Any:
        """Return a method of the listener: pulses and log lines are passed on unchanged."""
        return getattr(self.listener, name)

    def at(self, time_s: float) -> float:
        """Return the estimate at a touch of this run, or at a moment of the last seconds, µm."""
        return self._trace.at(time_s)

    def translated(self, event: MachineEvent) -> MachineEvent:
        """Return the event with the estimate at its time."""
        return replace(event, displacement_um=self.at(event.time_s))

    def telemetry(self, block: TelemetryBlock) -> None:
        """Estimate, and pass on."""
        estimator = self.tracker.estimator
        if not self._started:
            estimator.state.t_s = float(block.time_s[0])
            self._started = True
        estimate_um = estimator.advance(block.time_s, block.actuator_v)
        self._trace.append(block.time_s, estimate_um)
        self.displacement_um = float(estimate_um[-1])
        cutting_um = estimate_um[block.state == MachineState.MACHINING]
        if len(cutting_um):
            self.cutting_um = float(cutting_um.mean())
        if self.listener is not None:
            self.listener.telemetry(replace(block, displacement_um=estimate_um))

    def event(self, event: MachineEvent) -> None:
        """Pass on with the estimate; that of a touch is kept, because its reading is requested much later."""
        if event.code is EventCode.TOUCH:
            self._trace.keep(event.time_s)
        if self.listener is not None:
            self.listener.event(self.translated(event))


class SensorlessMachine:
    """A `Machine` with the displacements of its calibrated actuator; what is not defined here is of the real one.

    Parameters
    ----------
    machine : the real one, configured with `sensor_fitted` 0
    calibration : of its actuator, which must be at rest after full swings when telemetry starts
    gain_um_per_v : mean gain that the controller is configured with
    """

    slice_s = SLICE_S
    """The limit of a cut is checked in every slice, so they are short."""

    def __init__(self, machine: Machine, calibration: CalibratedActuator, gain_um_per_v: float) -> None:
        self._machine = machine
        self._gain_um_per_v = gain_um_per_v
        self._estimates = DisplacementEstimates(calibration)
        self._z_limit_um = 0.0

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the real machine."""
        return getattr(self._machine, name)

    @property
    def tracker(self) -> Tracker:
        """The estimator behind every displacement."""
        return self._estimates.tracker

    def start_telemetry(self, settings: TelemetrySettings, listener: MachineListener) -> None:
        """Begin to send samples, with estimates, to `listener`."""
        self._estimates.listener = listener
        self._machine.start_telemetry(settings, cast("MachineListener", self._estimates))

    def status(self) -> MachineStatus:
        """Request the state of the controller; the displacement is the newest estimate."""
        return replace(self._machine.status(), displacement_um=self._estimates.displacement_um)

    def set_zero(self, zero_um: float) -> None:
        """Leave the controller's zero alone: its displacements are volts, which are 0 at rest and do not drift."""

    def approach(self, speed_um_s: float, max_travel_um: float, gap_reference_v: float) -> MachineEvent:
        """Advance with pulses until the mean gap voltage falls to the reference."""
        here_v = self.tracker.estimator.state.u_v
        target_um = self._estimates.displacement_um + max_travel_um
        travel_um = self._sent_um(target_um, BEYOND, speed_um_s) - self._gain_um_per_v * here_v
        event = self._machine.approach(speed_um_s, travel_um, gap_reference_v)
        return self._estimates.translated(event)

    def touch(self, request: TouchRequest) -> tuple[Touch, ...]:
        """Find the surface by contact; each touch is the estimate at first contact."""
        sent = replace(
            request,
            fast_to_um=self._sent_um(request.fast_to_um, SHORT, request.fast_um_s),
            z_max_um=self._sent_um(request.z_max_um, BEYOND, request.fast_um_s),
        )
        return tuple(
            replace(touch, displacement_um=self._estimates.at(touch.time_s))
            for touch in self._machine.touch(sent)
        )

    def start_cut(self, request: CutRequest) -> None:
        """Start the gap servo; `watch_cut` checks the limit."""
        self._z_limit_um = request.z_limit_um
        self._estimates.cutting_um = self._estimates.displacement_um
        sent_um = self._sent_um(request.z_limit_um, BEYOND, math.inf)
        self._machine.start_cut(replace(request, z_limit_um=sent_um))

    def start_scan(self, request: CutRequest) -> None:
        """Start the gap servo with the tool held at the voltage that the inverse gives for the limit."""
        self._z_limit_um = math.inf
        self._machine.start_scan(replace(request, z_limit_um=self._sent_um(request.z_limit_um, AT)))

    def path_move(self, line: ScanLine) -> bool:
        """Append a line; its limit becomes the voltage that the inverse gives now, so send it not long before."""
        return self._machine.path_move(replace(line, z_limit_um=self._sent_um(line.z_limit_um, AT)))

    def watch_cut(self, duration_s: float) -> MachineEvent | None:
        """Let at most `duration_s` of a cut pass, and end it when the estimate has reached its limit."""
        event = self._machine.watch_cut(duration_s)
        if event is not None:
            return self._estimates.translated(event)
        if self._estimates.cutting_um < self._z_limit_um:
            return None
        return replace(self.stop_cut(), code=EventCode.CUT_DONE)

    def stop_cut(self) -> MachineEvent:
        """End a cut: pulses off, tool held."""
        return self._estimates.translated(self._machine.stop_cut())

    def _sent_um(self, target_um: float, side: float, speed_um_s: float = math.inf) -> float:
        """Return the displacement to send so that a feed from here ends at `target_um`, short of it or beyond it."""
        way_um = target_um - self._estimates.displacement_um
        way_um += side * (MARGIN_UM + MARGIN_SHARE * abs(way_um))
        return self._gain_um_per_v * travel_by(self.tracker.estimator, way_um, speed_um_s)
