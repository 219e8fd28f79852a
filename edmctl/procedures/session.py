"""A machine made ready for a job or one procedure and put away after it: armed, conditioned, recorded, retracted.

Whatever ends a procedure early, the machine is brought to its safe state first.
"""

from __future__ import annotations

import math
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from edmctl.errors import EdmError, LinkLost, MachineFault, PreconditionError, ProtocolMismatch, RunFileError
from edmctl.procedures.actuator.conditioning import condition
from edmctl.procedures.actuator.sensorless import SensorlessMachine
from edmctl.procedures.job_state import NoStateStore
from edmctl.procedures.monitoring.monitors import IdleMonitor, LinkMonitor, SensorMonitor, record_link
from edmctl.procedures.monitoring.watch import Watch
from edmctl.procedures.run import JobRun, JobStateKeeper, total_pause_s
from edmctl.procedures.settings import controller_settings, pulse_settings, recorded_every, telemetry_settings
from edmctl.record.rows import EventLevel, EventRow, RunEvent
from edmctl.results.job import site_result_of
from edmctl.results.progress import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from edmctl.machine.interface import Machine
    from edmctl.procedures.job import Job
    from edmctl.procedures.job_state import JobTally, StateStore
    from edmctl.procedures.run import Args
    from edmctl.record.rows import Recorder
    from edmctl.results.progress import Observer


@contextmanager
def safe_state_on_error(machine: Machine) -> Iterator[None]:
    """Pulses off, retract, idle, when anything is raised inside; the error then goes on its way unchanged.

    A failure of the safe stop itself becomes a note of that error and never takes its place: the controller's
    watchdog reaches the safe state without the host.
    """
    try:
        yield
    except BaseException as error:
        try:
            machine.safe_stop()
        except Exception as failure:
            error.add_note(f"While stopping: {failure!r}")
        raise


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
    anything moves. `tally` gets the times in any case, `store` the state of the job at every step. `record_left`
    writes what is known of sites that were left, where an error ends the job.

    Raises MachineFault, LinkLost, PreconditionError, RunFileError, Interrupted; the safe state was reached first, or
    by the controller alone where the link is lost.
    """
    watch = Watch(
        recorder,
        job.profile.pulse.duty_voltage_v,
        recorded_every(job.profile, job.setup),
        sensor=job.setup.sensor.fitted,
    )
    machine = _with_displacements(machine, job, watch)
    if job.resumed is not None:
        tally.sites.update({result.name: result for result in map(site_result_of, job.resumed.done)})
        tally.unwritten.extend(tally.sites)
        tally.earlier_time_s = job.resumed.time_s
        tally.machining_time_s = job.resumed.job_machining_time_s
        tally.pause_s = total_pause_s(job)
    keeper = JobStateKeeper(job, tally, store or NoStateStore())
    run = JobRun(machine, job, watch, recorder, observer, tally, keeper)
    watch.guard(keeper.on_telemetry)
    watch.guard(LinkMonitor(run).on_telemetry)
    watch.guard(IdleMonitor(run).on_telemetry)
    if job.setup.sensor.fitted and job.calibration is not None:
        watch.compare(SensorMonitor(run).update)
    try:
        with safe_state_on_error(machine):
            _prepare(run, pulses=pulses, self_test=self_test)
            yield run
            run.begin(Phase.RETRACTING)
            machine.disarm()
            machine.stop_telemetry()
            watch.settle()
            record_link(run)
    except EdmError as error:
        _record_end(run, error, record_left)
        raise
    finally:
        tally.time_s = tally.earlier_time_s + machine.time_s
        tally.link = machine.link_report()


def _with_displacements(machine: Machine, job: Job, watch: Watch) -> Machine:
    """Return the machine itself where it has a sensor, otherwise the one that its calibrated actuator makes."""
    if job.setup.sensor.fitted:
        return machine
    if job.calibration is None:
        raise PreconditionError(
            f"No displacement sensor is fitted and no calibration of {machine.identity.serial} was found.",
            hint="Borrow a sensor, run `edmctl calibrate` once with it, and say --calibration FILE.",
            code="E8031",
        )
    estimated = SensorlessMachine(machine, job.calibration, job.setup.actuator.gain_um_per_v)
    watch.estimate_with(estimated.tracker)
    return estimated


def _prepare(run: JobRun, *, pulses: bool, self_test: bool) -> None:
    settings = controller_settings(run.profile, run.setup)
    if not pulses:
        settings = replace(settings, dielectric_required=False)
    run.machine.configure(settings, pulse_settings(run.profile))
    run.machine.start_telemetry(telemetry_settings(run.profile, run.setup), run.watch)
    run.machine.arm(pulses=pulses)
    run.decide(
        RunEvent.ARMED, f"Armed: {run.machine.identity.serial}.", {} if self_test else {"pulses": pulses}
    )
    if self_test:
        _test_gap_sensor(run)
    condition(run, pulses=pulses)


def _test_gap_sensor(run: JobRun) -> None:
    """Before anything moves: a run on a wrong gap voltage would drive the tool into the work."""
    gap_v, open_v = run.machine.self_test(), run.profile.pulse.duty_voltage_v
    run.decide(
        RunEvent.SELF_TESTED,
        f"The gap sensor shows {gap_v:.2f} V of {open_v:.2f} V with the generator on, and none with it off.",
        {"gap_v": gap_v, "open_v": open_v},
    )


def _record_end(run: JobRun, error: EdmError, record_left: Callable[[JobRun], None]) -> None:
    """Keep how far the job came, and write down what was reached, what the controller saw, and why it ended.

    A disk that fails now must not hide that reason.
    """
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
            run.recorder.append(
                EventRow(
                    run.machine.time_s, RunEvent.LEFT_UNMEASURED, EventLevel.WARNING, str(reached), depth
                )
            )
        args = {"code": error.code, "hint": error.hint}
        run.recorder.append(
            EventRow(run.machine.time_s, RunEvent.ENDED_EARLY, EventLevel.ERROR, error.message, args)
        )


def _record_black_box(run: JobRun) -> None:
    """Write what the controller kept of the time about a latched fault into the run file, where there is one.

    A line that is dead by now, or a controller that says what cannot be, hides nothing.
    """
    with suppress(LinkLost, ProtocolMismatch, MachineFault, PreconditionError):
        if not run.machine.status().fault:
            return
        with suppress(PreconditionError):
            _record_samples(run)
        batch = run.machine.waveforms()
        if batch is not None:
            run.recorder.append(batch)


def _record_samples(run: JobRun) -> None:
    block = run.machine.black_box()
    if block is None:
        return
    if not run.setup.sensor.fitted:
        block = replace(block, displacement_um=np.full(len(block.time_s), np.nan))
    run.recorder.append(block)
