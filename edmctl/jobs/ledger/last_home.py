"""Where the tool was at rest last, by the ledger or by the journal of the run before, and how long ago."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.procedures.job import REPORT_DELAY_S

if TYPE_CHECKING:
    from edmctl.jobs.ledger.elapsed import Now
    from edmctl.procedures.job import Job
    from edmctl.record.tool_account import Books


def with_home(job: Job, books: Books, now: Now) -> Job:
    """Return the job with where the tool's home was last by the ledger, how long ago, and how fast it moved before.

    Where the clock was set back since, nobody knows how long ago that was, nor where home is by now; how fast it
    moved before is known all the same.
    """
    from edmctl.procedures.monitoring.drift import displacement_uncertainty, seen_between_jobs_um_s

    if not books.homes:
        return job
    drift_u_um_per_s = displacement_uncertainty(job).drift_u_um_per_s
    seen = [(now.time_of(home.utc_s, home.bench_s), home.um) for home in books.homes]
    job = replace(job, drift_seen_um_s=seen_between_jobs_um_s(seen, drift_u_um_per_s))
    last = books.homes[-1]
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
