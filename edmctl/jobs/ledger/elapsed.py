"""Where the tool was at rest last."""

from __future__ import annotations

import math

from edmctl.dataclasses import replace
from edmctl.jobs.connected_machine import Now
from edmctl.procedures.job import REPORT_DELAY_S, Job
from edmctl.procedures.monitoring.drift import contradicting_between_jobs_um_s, displacement_uncertainty
from edmctl.record.tool_account import MachineHistory


def with_home(job: Job, history: MachineHistory, now: Now) -> Job:
    """Return the job with where the tool's home was last by the ledger, how long ago, and how fast it moved before.

    Where the clock was set back since, nobody knows how long ago that was, nor where home is by now; how fast it
    moved before is known all the same.
    """
    if not history.homes:
        return job
    drift_u_um_per_s = displacement_uncertainty(job).drift_u_um_per_s
    seen = [(home.utc_s if math.isnan(now.bench_s) else home.bench_s, home.um) for home in history.homes]
    job = replace(job, drift_seen_um_s=contradicting_between_jobs_um_s(seen, drift_u_um_per_s))
    last = history.homes[-1]
    passed_s = now.since_s(last.utc_s, last.bench_s)
    return (
        job if math.isinf(passed_s) else replace(job, home_um=last.um, home_age_s=passed_s + REPORT_DELAY_S)
    )


def with_home_left(job: Job) -> Job:
    """Return the job with where the tool's home was by the journal of the run before, where that is known later.

    A run that was killed has told the ledger no more than its first touch of the pad.
    """
    left = job.resumed
    age_s = left.home_age_s + job.pause_s + REPORT_DELAY_S if left is not None else math.nan
    if left is None or not math.isfinite(age_s) or age_s >= job.home_age_s:
        return job
    return replace(job, home_um=left.home_um, home_age_s=age_s)
