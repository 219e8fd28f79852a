"""A machine without a displacement sensor: its calibrated actuator converts between voltage and displacement.

The controller reports the mean gain times the voltage. Here samples, events and touches get the estimate at their
time. Heights that a motion must not pass are sent as the voltage of the exact inverse, with a margin for its error.
The end of a cut is watched ten times a second, because creep changes its voltage; the controller has a limit beyond.
"""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.actuator.correction import SlowCorrection
from edmctl.actuator.inverse import travel_by
from edmctl.machine.interface import (
    SLICE_S,
    Axis,
    ControllerSettings,
    CutRequest,
    EventCode,
    JumpRequest,
    Machine,
    MachineEvent,
    MachineIdentity,
    MachineListener,
    MachineState,
    MachineStatus,
    MotionSettings,
    PulseBlockBatch,
    PulseSettings,
    PulseTrain,
    ScanLine,
    TelemetryBlock,
    TelemetrySettings,
    Touch,
    TouchRequest,
    WaveformBatch,
)
from edmctl.procedures.actuator.tracker import Trace, Tracker, at_rest
from edmctl.procedures.job import CalibratedActuator
from edmctl.results.telemetry import LinkReport

MARGIN_SHARE = 0.03
"""Error of a height by the inverse, as a share of the way there: 2.5 % of gain between days, and the model's own."""
MARGIN_UM = 2.0
"""The same, at least."""
SHORT, AT, BEYOND = -1.0, 0.0, 1.0


class DisplacementEstimates:
    """Listens between machine and host: turns the displacement of every sample and event into the estimate.

    `displacement_um` is the newest estimate, `cutting_um` the mean of it over the newest samples of a cut.
    """

    def __init__(self, calibration: CalibratedActuator) -> None:
        estimator = at_rest(calibration.model, 0.0)
        # Displacements count from the actuator at rest, as with a sensor; `at_rest` is there already.
        estimator.correct(1.0, -estimator.tick(estimator.state.u_v, 0.0))
        self.tracker = Tracker(estimator, SlowCorrection(), calibration.held_out_rms_um)
        self._listener: MachineListener | None = None
        self._trace = Trace()
        self._started = False
        self.displacement_um = 0.0
        self.cutting_um = 0.0

    def inform(self, listener: MachineListener) -> None:
        """Hand everything on to `listener`."""
        self._listener = listener

    def at(self, time_s: float) -> float:
        """Return the estimate at a touch of this run, or at a moment of the last seconds, µm."""
        return self._trace.at(time_s)

    def translated(self, event: MachineEvent) -> MachineEvent:
        """Return the event with the estimate at its time."""
        return replace(event, displacement_um=self.at(event.time_s))

    def telemetry(self, block: TelemetryBlock) -> None:
        """Estimate and hand on."""
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
        if self._listener is not None:
            self._listener.telemetry(replace(block, displacement_um=estimate_um))

    def pulse_blocks(self, batch: PulseBlockBatch) -> None:
        """Hand on."""
        if self._listener is not None:
            self._listener.pulse_blocks(batch)

    def pulses(self, batch: PulseTrain) -> None:
        """Hand on."""
        if self._listener is not None:
            self._listener.pulses(batch)

    def event(self, event: MachineEvent) -> None:
        """Hand on with the estimate; that of a touch is kept, because its reading is asked for much later."""
        if event.code is EventCode.TOUCH:
            self._trace.keep(event.time_s)
        if self._listener is not None:
            self._listener.event(self.translated(event))

    def log(self, level: int, text: str) -> None:
        """Hand on."""
        if self._listener is not None:
            self._listener.log(level, text)


class SensorlessMachine:
    """A `Machine` whose displacements are those of its calibrated actuator.

    Parameters
    ----------
    machine : the real one, configured with `sensor_fitted` 0
    calibration : of its actuator, which must be at rest after full swings when telemetry starts
    gain_um_per_v : mean gain that the controller is configured with
    """

    def __init__(self, machine: Machine, calibration: CalibratedActuator, gain_um_per_v: float) -> None:
        self._machine = machine
        self._gain_um_per_v = gain_um_per_v
        self._estimates = DisplacementEstimates(calibration)
        self._z_limit_um = 0.0

    @property
    def tracker(self) -> Tracker:
        """The estimator behind every displacement."""
        return self._estimates.tracker

    @property
    def identity(self) -> MachineIdentity:
        """Identity of the controller."""
        return self._machine.identity

    @property
    def time_s(self) -> float:
        """Controller time of the newest message."""
        return self._machine.time_s

    @property
    def uptime_s(self) -> float:
        """How long the controller has been on, s."""
        return self._machine.uptime_s

    @property
    def zero_um(self) -> float:
        """Where the controller takes home to be: nobody tells it another place."""
        return self._machine.zero_um

    def configure(
        self, settings: ControllerSettings | MotionSettings, pulses: PulseSettings | None = None
    ) -> None:
        """Upload and commit every parameter and set the generator."""
        self._machine.configure(settings, pulses)

    def start_telemetry(self, settings: TelemetrySettings, listener: MachineListener) -> None:
        """Begin to send samples, with estimates, to `listener`."""
        self._estimates.inform(listener)
        self._machine.start_telemetry(settings, self._estimates)

    def stop_telemetry(self) -> None:
        """Send no more samples."""
        self._machine.stop_telemetry()

    def arm(self, *, pulses: bool = True) -> None:
        """Start the watchdog; from here on the machine may move."""
        self._machine.arm(pulses=pulses)

    def status(self) -> MachineStatus:
        """Ask what the controller sees now; the displacement is the newest estimate."""
        return replace(self._machine.status(), displacement_um=self._estimates.displacement_um)

    def self_test(self) -> float:
        """Test the gap sensor with the tool retracted; mean gap voltage with the generator on, V."""
        return self._machine.self_test()

    def rest(self, duration_s: float) -> None:
        """Let time pass."""
        self._machine.rest(duration_s)

    def ramp(self, actuator_v: float, slew_v_s: float) -> None:
        """Ramp the actuator."""
        self._machine.ramp(actuator_v, slew_v_s)

    def move_stage(self, axis: Axis, target: float, speed: float) -> None:
        """Move a stage. The controller sees 0 µm at 0 V: the caller waits for creep."""
        self._machine.move_stage(axis, target, speed)

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
        """Start the gap servo; `watch_cut` looks for the limit."""
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

    @property
    def slice_s(self) -> float:
        """The limit of a cut is looked for in every slice, so they are short."""
        return SLICE_S

    def watch_cut(self, duration_s: float) -> MachineEvent | None:
        """Let at most `duration_s` of a cut pass, and end it where the estimate has reached its limit."""
        event = self._machine.watch_cut(duration_s)
        if event is not None:
            return self._estimates.translated(event)
        if self._estimates.cutting_um < self._z_limit_um:
            return None
        return replace(self.stop_cut(), code=EventCode.CUT_DONE)

    def stop_cut(self) -> MachineEvent:
        """End a cut: pulses off, tool held."""
        return self._estimates.translated(self._machine.stop_cut())

    def jump(self, request: JumpRequest) -> None:
        """Lift the tool to flush the gap, and return; a jump is told in µm of the mean gain in any case."""
        self._machine.jump(request)

    def set_pulses(self, pulses: PulseSettings) -> None:
        """Set the generator anew: armed, and not while it makes pulses."""
        self._machine.set_pulses(pulses)

    def clear_fault(self, code: int) -> None:
        """Clear the latched fault once the tool has retracted."""
        self._machine.clear_fault(code)

    def disarm(self) -> None:
        """Pulses off, retract to 0 V, idle."""
        self._machine.disarm()

    def safe_stop(self) -> None:
        """Pulses off, retract to 0 V, idle, whatever the state."""
        self._machine.safe_stop()

    def black_box(self) -> TelemetryBlock | None:
        """Return what the controller saw before the latched fault; its displacements are of no meaning here."""
        return self._machine.black_box()

    def waveforms(self) -> WaveformBatch | None:
        """Gap voltage and current about the latched fault; None where none are held."""
        return self._machine.waveforms()

    def link_report(self) -> LinkReport:
        """Return how the line did since the session opened."""
        return self._machine.link_report()

    @property
    def bad_frames(self) -> int:
        """Frames that arrived damaged since the session opened."""
        return self._machine.bad_frames

    def _sent_um(self, target_um: float, side: float, speed_um_s: float = math.inf) -> float:
        """Return the displacement to send so that a feed from here ends at `target_um`, short of it or beyond it."""
        way_um = target_um - self._estimates.displacement_um
        way_um += side * (MARGIN_UM + MARGIN_SHARE * abs(way_um))
        return self._gain_um_per_v * travel_by(self.tracker.estimator, way_um, speed_um_s)
