"""A machine is made ready for a job or one procedure, and left retracted and idle after it.

Conditioning erases the memory of the actuator beside the work, and starts the estimator there: hysteresis depends on
the turning points of the voltage, and without full swings a model is wrong by tens of µm near 0 V (Muralidhara et
al. 2009, §2.2, near the trough of Fig. 3a). The swings are compared with the sensor, which sets the gain and zero of
the day for a calibration; without one a plain model is identified from them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import cast

import numpy as np

from edmctl import failures
from edmctl.actuator.inverse import jump_volts
from edmctl.actuator.quick import identify_quick
from edmctl.actuator.record import Record
from edmctl.errors import EdmError, LinkLost, MachineFault, PreconditionError, ProtocolMismatch, RunFileError
from edmctl.machine.interface import SLICE_S, Machine, TelemetryBlock, joined
from edmctl.machine.stop import safe_state_on_error
from edmctl.procedures.displacement_estimate import SensorlessMachine, home
from edmctl.procedures.job import Job, JobTally, NoStateStore, StateStore
from edmctl.procedures.monitoring.monitors import LinkMonitor, SensorMonitor, record_link
from edmctl.procedures.monitoring.watch import Watch
from edmctl.procedures.run import Args, JobRun, JobStateKeeper, rest_and_look, total_pause_s
from edmctl.procedures.settings import controller_settings, pulse_settings, recorded_every, telemetry_settings
from edmctl.procedures.stages import move_to
from edmctl.record.json_rows import site_result_of
from edmctl.record.rows import EventLevel, Recorder, RunEvent
from edmctl.results.progress import Observer, Phase
from edmctl.wording import signed

LEAST_GAIN_UM_PER_V = 0.05  # half the least mean gain that a setup may have
DAY_GAINS = (
    0.5,
    2.0,
)  # limits of the gain of the day: a stage changes by percents, another machine by tens of them
REST_S = 1.0  # rest before the first swing, so that the record starts from an actuator at rest


@contextmanager
def running(
    machine: Machine,
    job: Job,
    tally: JobTally,
    *,
    recorder: Recorder,
    observer: Observer,
    pulses: bool,
    store: StateStore | None = None,
    self_test: bool = False,
    record_left: Callable[[JobRun], None] = lambda _: None,
) -> Iterator[JobRun]:
    """Arm and condition an idle machine, and leave it retracted and idle whatever happens inside.

    Without `pulses` it can make none, and needs no dielectric; with `self_test` the gap sensor is tested before
    anything moves. `tally` gets the times in any case, `store` the state of the job at every step; `record_left`
    writes the results of sites that an error left. Raises MachineFault, LinkLost, PreconditionError, RunFileError
    and Interrupted after the safe state was reached, by the controller alone if the link is lost.
    """
    duty_voltage_v, has_sensor = job.profile.pulse.duty_voltage_v, job.setup.sensor.fitted
    watch = Watch(recorder, duty_voltage_v, recorded_every(job.profile, job.setup), sensor=has_sensor)
    if not has_sensor:
        if job.calibration is None:
            raise failures.no_calibration(serial=machine.identity.serial, calibrate="edmctl calibrate")
        estimated = SensorlessMachine(machine, job.calibration, job.setup.actuator.gain_um_per_v)
        watch.estimate_with(estimated.tracker)
        machine = cast("Machine", estimated)
    keeper = JobStateKeeper(job, tally, store or NoStateStore())
    run = JobRun(machine, job, watch, recorder, observer, tally, keeper)
    left = job.resumed
    run.use_regime(left.regime if left is not None and left.begun and not job.restart_hole else 0)
    if left is not None:
        tally.sites.update({result.name: result for result in map(site_result_of, left.done)})
        tally.unwritten.extend(tally.sites)
        tally.earlier_time_s, tally.machining_time_s = left.time_s, left.job_machining_time_s
        tally.pause_s = total_pause_s(job)
    watch.follow_creep(job.creep_left)
    for guard in (keeper.on_telemetry, LinkMonitor(run).on_telemetry, run.on_telemetry):
        watch.guard(guard)
    if has_sensor and job.calibration is not None:
        watch.compare(SensorMonitor(run).update)
    try:
        with safe_state_on_error(machine):
            _prepare(run, pulses=pulses, self_test=self_test)
            yield run
            run.begin(Phase.RETRACTING)
            machine.disarm()
            machine.stop_telemetry()
            tally.creep_left = watch.creep_left()
            record_link(run)
    except EdmError as error:
        _record_end(run, error, record_left)
        raise
    except BaseException:
        with suppress(Exception):
            watch.settle()  # received samples are kept, whatever ended it
        raise
    finally:
        tally.time_s = tally.earlier_time_s + machine.time_s
        tally.link = machine.link_report()


def _prepare(run: JobRun, *, pulses: bool, self_test: bool) -> None:
    machine, settings = run.machine, controller_settings(run.profile, run.setup)
    if not pulses:
        settings = replace(settings, dielectric_required=False)
    machine.configure(settings, pulse_settings(run.profile))
    machine.start_telemetry(telemetry_settings(run.profile, run.setup), run.watch)
    machine.arm(pulses=pulses)
    run.decide(RunEvent.ARMED, f"Armed: {machine.identity.serial}.", {} if self_test else {"pulses": pulses})
    if self_test:
        # Before anything moves: with a wrong gap voltage the tool would be driven into the workpiece.
        gap_v, open_v = machine.self_test(), run.profile.pulse.duty_voltage_v
        message = (
            f"The gap sensor shows {gap_v:.2f} V of {open_v:.2f} V with the generator on, and none when off."
        )
        run.decide(RunEvent.SELF_TESTED, message, {"gap_v": gap_v, "open_v": open_v})
    condition(run, pulses=pulses)


def _record_end(run: JobRun, error: EdmError, record_left: Callable[[JobRun], None]) -> None:
    """Record what was reached, the black box and why the job ended; a disk that fails now must not hide that."""
    with suppress(EdmError):
        run.keeper.stop(run.machine.time_s, linked=not isinstance(error, LinkLost))
    run.keeper.leave()
    reached = run.tally.reached
    if reached is not None:
        run.observer.note(str(reached))
    with suppress(RunFileError):
        run.watch.settle()
        record_link(run)
        if isinstance(error, MachineFault):
            _record_black_box(run)
        record_left(run)
        if reached is not None:
            depth: Args = {"site": reached.site, "depth_um": reached.depth_estimated_um}
            if math.isfinite(reached.depth_estimated_u95_um):
                depth = {**depth, "depth_u95_um": reached.depth_estimated_u95_um}
            run.note(RunEvent.LEFT_UNMEASURED, str(reached), depth, EventLevel.WARNING)
        why = {"code": error.code, "hint": error.hint}
        run.note(RunEvent.ENDED_EARLY, error.message, why, EventLevel.ERROR)


def _record_black_box(run: JobRun) -> None:
    """Record samples and waveforms about a latched fault, which a dead line must not hide."""
    with suppress(LinkLost, ProtocolMismatch, MachineFault, PreconditionError):
        if not run.machine.status().fault:
            return
        with suppress(PreconditionError):
            block = run.machine.black_box()
            if block is not None:
                if not run.setup.sensor.fitted:
                    block = replace(block, displacement_um=np.full(len(block.time_s), np.nan))
                run.recorder.append(block)
        batch = run.machine.waveforms()
        if batch is not None:
            run.recorder.append(batch)


def condition(run: JobRun, *, pulses: bool = True) -> None:
    """Swing the actuator between 0 V and its limit at the parking place, and start the estimator from there.

    The machine is idle while the model is fitted, because a fitting host sends no heartbeats; then it is armed
    again, with `pulses` permitted or not.
    """
    move_to(run, run.job.parking)
    run.begin(Phase.CONDITIONING)
    actuator, top_v = run.setup.actuator, run.profile.limits.stroke_v_max
    record: list[TelemetryBlock] = []
    run.watch.follow(record.append)
    try:
        rest_and_look(run, REST_S)
        for _ in range(actuator.conditioning_cycles):
            run.machine.ramp(top_v, actuator.conditioning_slew_v_s)
            run.machine.ramp(0.0, actuator.conditioning_slew_v_s)
        run.machine.rest(2.0 * SLICE_S)  # until the last samples of the swings are in
        run.machine.disarm()
    finally:
        run.watch.follow(None)
    if run.setup.sensor.fitted:
        _start_estimator(run, joined(record))
    else:
        cycles = actuator.conditioning_cycles
        message = f"Conditioned with {cycles} swings to {top_v:.0f} V; there is no sensor to compare with."
        run.decide(RunEvent.CONDITIONED, message, {"cycles": cycles})
    estimator = run.watch.estimator()
    if estimator is not None:
        # Where the code of the inverse is not compiled yet, that takes seconds: now nothing waits for it.
        jump_volts(estimator, 1.0, 0.0, 0.01, 0.0)
    run.machine.arm(pulses=pulses)


def _start_estimator(run: JobRun, block: TelemetryBlock) -> None:
    """Follow the voltage really applied through the swings, from a conditioned actuator at rest.

    Raises PreconditionError: E8033 if the sensor does not rise with the voltage, E8038 for a calibration of
    something else.
    """
    record = Record(block.time_s, block.actuator_v, block.displacement_um)
    calibration, cycles = run.job.calibration, run.setup.actuator.conditioning_cycles
    if cycles:
        slope = float(np.cov(record.u_v, record.y_um)[0, 1]) / max(float(record.u_v.var()), 1e-12)
        if not slope > LEAST_GAIN_UM_PER_V:
            raise failures.sensor_contradicts_voltage(slope_um_per_v=signed(slope), u_v=np.ptp(record.u_v))
    if calibration is not None:
        gain = math.nan
        with suppress(ValueError):
            tracker, errors = home(calibration.model, record, calibration.held_out_rms_um)
            gain = tracker.estimator.gain
        if not DAY_GAINS[0] <= gain <= DAY_GAINS[1]:
            found = "no positive gain" if math.isnan(gain) else f"a gain of {gain:.3g}"
            evidence = (
                f"its displacements need {found} to be those of the sensor during the conditioning swings"
            )
            raise failures.calibration_contradicted(evidence=evidence)
    elif cycles:
        try:
            model, quick = identify_quick(record)
        except ValueError as error:
            raise failures.conditioning_insufficient(error=error) from error
        tracker, errors = home(model, record, quick.rms_um, float(np.ptp(record.t_s)))
    else:
        return
    run.watch.estimate_with(tracker)
    estimator = tracker.estimator
    figures = {"cycles": cycles, "rms_um": errors.rms_um, "max_um": errors.max_um}
    run.decide(
        RunEvent.CONDITIONED,
        f"Conditioned with {cycles} swings to {run.profile.limits.stroke_v_max:.0f} V; the actuator model fits "
        f"within {errors.rms_um:.2f} µm rms, {errors.max_um:.1f} µm at most.",
        {**figures, "gain": estimator.gain, "offset_um": estimator.offset_um},
    )
