"""The main job: condition, measure, machine every site, and leave the machine retracted and idle."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING

from edmctl.errors import EdmError, LinkLost, MachineFault, PreconditionError, RunFileError
from edmctl.procedures.actuator.conditioning import condition
from edmctl.procedures.actuator.sensorless import SensorlessMachine
from edmctl.procedures.channel.job import machine_path, record_left_channel
from edmctl.procedures.event_codes import RunEvent
from edmctl.procedures.hole.hole import record_left, record_results
from edmctl.procedures.hole.interruption import told_pause_s
from edmctl.procedures.hole.sites import machine_sites
from edmctl.procedures.hole.verdict import judge_holes
from edmctl.procedures.job_state import Journal, NoJournal
from edmctl.procedures.monitoring.black_box import record_black_box
from edmctl.procedures.monitoring.idle_monitor import Standing
from edmctl.procedures.monitoring.link_quality import LinkWatch, record_link
from edmctl.procedures.monitoring.sensor_mismatch import MismatchWatch
from edmctl.procedures.monitoring.watch import Watch
from edmctl.procedures.run import Args, Run
from edmctl.procedures.settings import (
    controller_settings,
    pulse_settings,
    recorded_every,
    telemetry_settings,
)
from edmctl.procedures.state_keeper import JobJournal
from edmctl.procedures.stop import safe_state_on_error
from edmctl.procedures.tally import JobTally
from edmctl.record.rows import EventLevel
from edmctl.results.job import JobResult, ObjectiveMissed, site_result_of
from edmctl.results.progress import Observer, Phase

if TYPE_CHECKING:
    from edmctl.machine.interface import Machine
    from edmctl.procedures.job import Job
    from edmctl.record.recorder import Recorder


def run_job(
    machine: Machine,
    job: Job,
    *,
    recorder: Recorder,
    observer: Observer,
    ledger: JobTally | None = None,
    journal: Journal | None = None,
) -> JobResult:
    """Run a whole job on an idle machine.

    The recorder takes every sample, decision and result; the observer is told progress and decisions; the ledger
    holds what has been reached, also after an error; the journal keeps what it takes to go on after an interruption.

    Raises
    ------
    ObjectiveMissed
        The job ended in order but short of its target; carries the result.
    MachineFault, LinkLost, PreconditionError, RunFileError, Interrupted
        The safe state was reached first, or by the controller alone where the link is lost.
    """
    ledger = ledger or JobTally()
    watch = Watch(
        recorder,
        job.profile.pulse.duty_voltage_v,
        recorded_every(job.profile, job.setup),
        sensor=job.setup.sensor.fitted,
    )
    machine = _with_displacements(machine, job, watch)
    if job.resumed is not None:
        ledger.sites.update({result.name: result for result in map(site_result_of, job.resumed.done)})
        ledger.unwritten.extend(ledger.sites)
        ledger.earlier_time_s = job.resumed.time_s
        ledger.machining_time_s = job.resumed.job_machining_time_s
        ledger.pause_s = told_pause_s(job)
    keeper = JobJournal(job, ledger, journal or NoJournal())
    run = Run(machine, job, watch, recorder, observer, ledger, keeper)
    watch.guard(keeper.take)
    watch.guard(LinkWatch(run).take)
    watch.guard(Standing(run).take)
    if job.setup.sensor.fitted and job.calibration is not None:
        watch.compare(MismatchWatch(run).take)
    try:
        with safe_state_on_error(machine):
            _prepare(run)
            missed = machine_sites(run) if job.profile.path is None else machine_path(run)
            record_results(run)
            if job.profile.path is None:
                missed = judge_holes(run, missed)
            run.begin(Phase.RETRACTING)
            machine.disarm()
            machine.stop_telemetry()
            watch.settle()
            record_link(run)
    except EdmError as error:
        _record_end(run, error)
        raise
    finally:
        ledger.time_s = ledger.earlier_time_s + machine.time_s
        ledger.link = machine.link_report()
    if missed is not None:
        raise ObjectiveMissed(missed.missed, hint=missed.hint, result=ledger.result(), code=missed.code)
    return ledger.result()


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


def _record_end(run: Run, error: EdmError) -> None:
    """Keep how far the job came, and write down what was reached, what the controller saw, and why it ended.

    A disk that fails now must not hide that reason.
    """
    with suppress(EdmError):
        run.journal.stop(run.machine.time_s, linked=not isinstance(error, LinkLost))
    left = run.journal.left()
    if left is not None:
        hole, known = left
        hole.report_left(run, known)
    reached = run.ledger.reached
    if reached is not None:
        run.observer.note(str(reached))
    with suppress(RunFileError):
        run.watch.settle()
        record_link(run)
        if isinstance(error, MachineFault):
            record_black_box(run)
        record_left(run)
        record_left_channel(run)
        if reached is not None:
            depth: Args = {"site": reached.site, "depth_um": reached.depth_estimated_um}
            if math.isfinite(reached.depth_estimated_u95_um):
                depth = {**depth, "depth_u95_um": reached.depth_estimated_u95_um}
            run.recorder.event(
                run.machine.time_s, RunEvent.LEFT_UNMEASURED, EventLevel.WARNING, str(reached), depth
            )
        args = {"code": error.code, "hint": error.hint}
        run.recorder.event(run.machine.time_s, RunEvent.ENDED_EARLY, EventLevel.ERROR, error.message, args)


def _prepare(run: Run) -> None:
    settings = controller_settings(run.profile, run.setup)
    run.machine.configure(settings, pulse_settings(run.profile))
    run.machine.start_telemetry(telemetry_settings(run.profile, run.setup), run.watch)
    run.machine.arm()
    run.decide(RunEvent.ARMED, f"Armed: {run.machine.identity.serial}.", {})
    _test_gap_sensor(run)
    condition(run)


def _test_gap_sensor(run: Run) -> None:
    """Before anything moves: a run on a wrong gap voltage would drive the tool into the work."""
    gap_v, open_v = run.machine.self_test(), run.profile.pulse.duty_voltage_v
    run.decide(
        RunEvent.SELF_TESTED,
        f"The gap sensor shows {gap_v:.2f} V of {open_v:.2f} V with the generator on, and none with it off.",
        {"gap_v": gap_v, "open_v": open_v},
    )
