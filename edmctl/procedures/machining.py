"""The main job: measure, machine and judge every site, or a channel, and leave the machine retracted and idle."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.procedures.channel.procedure import machine_path, record_left_channel
from edmctl.procedures.hole.site_result import record_left, record_results
from edmctl.procedures.hole.sites import machine_sites
from edmctl.procedures.hole.verdict import judge_holes
from edmctl.procedures.job_state import JobTally
from edmctl.procedures.session import running
from edmctl.results.job import ObjectiveMissed

if TYPE_CHECKING:
    from edmctl.machine.interface import Machine
    from edmctl.procedures.job import Job
    from edmctl.procedures.job_state import StateStore
    from edmctl.procedures.run import JobRun
    from edmctl.record.rows import Recorder
    from edmctl.results.job import JobResult
    from edmctl.results.progress import Observer


def run_job(
    machine: Machine,
    job: Job,
    *,
    recorder: Recorder,
    observer: Observer,
    tally: JobTally | None = None,
    store: StateStore | None = None,
) -> JobResult:
    """Run a whole job on an idle machine.

    The recorder takes every sample, decision and result; the observer is told progress and decisions; the tally
    holds what has been reached, also after an error; the store keeps what it takes to go on after an interruption.

    Raises
    ------
    ObjectiveMissed
        The job ended in order but short of its target; carries the result.
    MachineFault, LinkLost, PreconditionError, RunFileError, Interrupted
        The safe state was reached first, or by the controller alone where the link is lost.
    """
    tally = tally or JobTally()
    with running(
        machine,
        job,
        tally,
        recorder=recorder,
        observer=observer,
        pulses=True,
        store=store,
        self_test=True,
        record_left=_record_left,
    ) as run:
        if job.profile.path is None:
            missed = machine_sites(run)
            record_results(run)
            missed = judge_holes(run, missed)
        else:
            missed = machine_path(run)
    if missed is not None:
        raise ObjectiveMissed(missed.missed, hint=missed.hint, result=tally.result(), code=missed.code)
    return tally.result()


def _record_left(run: JobRun) -> None:
    record_left(run)
    record_left_channel(run)
