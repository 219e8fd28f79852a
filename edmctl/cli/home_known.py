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
    """Return the job with where the tool's home was last by the ledger, and how long ago: by calendar or runs.

    Of a run that was killed the ledger does not know how long it took, so the age is taken a little too large. Where
    the clock was set back since, nobody knows it, nor where home is.
    """
    passed_s = passed_since_s(books.home_utc_s) if clock else 0.0
    if math.isnan(books.home_um) or math.isinf(passed_s):
        return job
    age_s = max(books.runs_s - books.home_at_s + UNTOLD_S, passed_s)
    return replace(job, home_um=books.home_um, home_age_s=age_s)


def with_home_left(job: Job) -> Job:
    """Return the job with where the tool's home was by the journal of the run before, where that is known later.

    A run that was killed has told the ledger no more than its first touch of the pad.
    """
    left = job.resumed
    age_s = left.home_age_s + job.pause_s + UNTOLD_S if left is not None else math.nan
    if left is None or not math.isfinite(age_s) or age_s >= job.home_age_s:
        return job
    return replace(job, home_um=left.home_um, home_age_s=age_s)
