"""How far touches of the pad have drifted from one reading to a later one, by the rests before them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.procedures.monitoring.drift import unused_s

if TYPE_CHECKING:
    from edmctl.procedures.job import Job
    from edmctl.procedures.touch.reading import SurfaceReading
    from edmctl.process.touches import Drift


def drift_between(job: Job, first: SurfaceReading, last: SurfaceReading) -> Drift | None:
    """Return how much a touch drifted between two readings, by the rests before them.

    None where nobody has measured what rests and touches of the machine have in common, and where a reading has no
    rest, as one that an earlier run has left.
    """
    if job.drift is None or first.rest is None or last.rest is None:
        return None
    return job.drift.between(first.rest, last.rest, last.time_s - first.time_s, unused_s(job))
