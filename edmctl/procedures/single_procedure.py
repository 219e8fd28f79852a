"""A machine made ready for one procedure, and put away after it: armed, conditioned, recorded, retracted, idle."""

from __future__ import annotations

from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.errors import EdmError, MachineFault, RunFileError
from edmctl.procedures.actuator.conditioning import condition
from edmctl.procedures.event_codes import RunEvent
from edmctl.procedures.machining import _with_displacements
from edmctl.procedures.monitoring.black_box import record_black_box
from edmctl.procedures.monitoring.idle_monitor import Standing
from edmctl.procedures.monitoring.link_quality import LinkWatch, record_link
from edmctl.procedures.monitoring.sensor_mismatch import MismatchWatch
from edmctl.procedures.monitoring.watch import Watch
from edmctl.procedures.run import Run
from edmctl.procedures.settings import (
    controller_settings,
    pulse_settings,
    recorded_every,
    telemetry_settings,
)
from edmctl.procedures.state_keeper import JobJournal
from edmctl.procedures.stop import safe_state_on_error
from edmctl.record.rows import EventLevel
from edmctl.results.progress import Observer, Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from edmctl.machine.interface import Machine
    from edmctl.procedures.job import Job
    from edmctl.procedures.tally import JobTally
    from edmctl.record.recorder import Recorder


@contextmanager
def running(
    machine: Machine,
    job: Job,
    ledger: JobTally,
    *,
    recorder: Recorder,
    observer: Observer,
    pulses: bool,
) -> Iterator[Run]:
    """Arm and condition an idle machine, and leave it retracted and idle whatever happens inside.

    Without `pulses` it can make none, and needs no dielectric. `ledger` gets the times in any case.

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
    run = Run(machine, job, watch, recorder, observer, ledger, JobJournal(job, ledger))
    watch.guard(LinkWatch(run).take)
    watch.guard(Standing(run).take)
    if job.setup.sensor.fitted and job.calibration is not None:
        watch.compare(MismatchWatch(run).take)
    try:
        with safe_state_on_error(machine):
            _prepare(run, pulses=pulses)
            yield run
            run.begin(Phase.RETRACTING)
            machine.disarm()
            machine.stop_telemetry()
            watch.settle()
            record_link(run)
    except EdmError as error:
        _record_end(run, error)
        raise
    finally:
        ledger.time_s = machine.time_s
        ledger.link = machine.link_report()


def _prepare(run: Run, *, pulses: bool) -> None:
    settings = controller_settings(run.profile, run.setup)
    if not pulses:
        settings = replace(settings, dielectric_required=False)
    run.machine.configure(settings, pulse_settings(run.profile))
    run.machine.start_telemetry(telemetry_settings(run.profile, run.setup), run.watch)
    run.machine.arm(pulses=pulses)
    run.decide(RunEvent.ARMED, f"Armed: {run.machine.identity.serial}.", {"pulses": pulses})
    condition(run, pulses=pulses)


def _record_end(run: Run, error: EdmError) -> None:
    """Write down what the controller saw, and why it ended. A disk that fails now must not hide that reason."""
    with suppress(RunFileError):
        run.watch.settle()
        record_link(run)
        if isinstance(error, MachineFault):
            record_black_box(run)
        args = {"code": error.code, "hint": error.hint}
        run.recorder.event(run.machine.time_s, RunEvent.ENDED_EARLY, EventLevel.ERROR, error.message, args)
