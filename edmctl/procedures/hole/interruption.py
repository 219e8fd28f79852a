"""How long a job that is taken up again stood still, and what may have drifted meanwhile."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.procedures.touch.site_readings import displacement_uncertainty

if TYPE_CHECKING:
    from edmctl.procedures.job import Job
    from edmctl.procedures.job_state import JobState

UNCERTAINTIES_IN_STROKE = 3.0
"""A zero that has drifted by the whole stroke could not be touched, so a drift counts for no more than that."""


def counted_pause_s(job: Job) -> float:
    """The pause as far as drift goes on in it.

    An unknown pause, and one of days, counts until three standard uncertainties of the drift are the whole stroke.
    """
    drift_um_per_s = displacement_uncertainty(job).drift_u_um_per_s
    if not drift_um_per_s:
        return job.pause_s if math.isfinite(job.pause_s) else 0.0
    actuator = job.setup.actuator
    stroke_um = actuator.gain_um_per_v * actuator.stroke_v
    return min(job.pause_s, stroke_um / (UNCERTAINTIES_IN_STROKE * drift_um_per_s))


def drift_u_um(job: Job) -> float:
    """Standard uncertainty of a place of the tool that was touched before the pause."""
    return displacement_uncertainty(job).drift_u_um_per_s * counted_pause_s(job)


def told_pause_s(job: Job) -> float:
    """All pauses of the job so far; NaN where nobody knows."""
    before_s = job.resumed.pause_s if job.resumed else 0.0
    return before_s + job.pause_s if math.isfinite(job.pause_s) else math.nan


def after_pause(job: Job) -> JobState:
    """What the run before left, as long ago as it is now: the pause is in it, for whoever goes on later."""
    state = job.resumed
    assert state is not None
    return replace(
        state,
        z1_time_s=state.z1_time_s - counted_pause_s(job),
        pause_s=told_pause_s(job),
        home_age_s=state.home_age_s + job.pause_s,
    )
