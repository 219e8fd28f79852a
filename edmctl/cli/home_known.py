"""Where the tool was at rest last, by the ledger or by the journal of the run before, and how long ago."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.cli.elapsed import passed_since_s

if TYPE_CHECKING:
    from edmctl.procedures.job import Job
    from edmctl.record.bookkeeping import Books

UNTOLD_S = 600.0
"""Added to the age of what the ledger knows: a run that was killed has not told how long it took."""


def with_home(job: Job, books: Books, *, clock: bool) -> Job:
    """Return the job with where the tool's home was last by the ledger, how long ago, and how fast it moved before.

    Time goes by calendar or runs. Of a run that was killed the ledger does not know how long it took, so the age is
    taken a little too large. Where the clock was set back since, nobody knows it, nor where home is.
    """
    from edmctl.procedures.drift import seen_between_jobs_um_s
    from edmctl.procedures.measuring import displacement_uncertainty

    if not books.homes:
        return job
    last = books.homes[-1]
    passed_s = passed_since_s(last.utc_s) if clock else 0.0
    if math.isinf(passed_s):
        return job
    age_s = max(books.runs_s - last.at_s + UNTOLD_S, passed_s)
    drift_u_um_per_s = displacement_uncertainty(job).drift_u_um_per_s
    seen = [(home.utc_s if clock else home.at_s, home.um) for home in books.homes]
    drift_um_s = seen_between_jobs_um_s(seen, drift_u_um_per_s)
    return replace(job, home_um=last.um, home_age_s=age_s, drift_seen_um_s=drift_um_s)


def with_home_left(job: Job) -> Job:
    """Return the job with where the tool's home was by the journal of the run before, where that is known later.

    A run that was killed has told the ledger no more than its first touch of the pad.
    """
    left = job.resumed
    age_s = left.home_age_s + job.pause_s + UNTOLD_S if left is not None else math.nan
    if left is None or not math.isfinite(age_s) or age_s >= job.home_age_s:
        return job
    return replace(job, home_um=left.home_um, home_age_s=age_s)
