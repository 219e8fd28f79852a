"""How far touches of the pad have drifted from one reading to a later one, by the rests before them.

A deep cut leaves creep in the rest after it, and what is unknown of that creep is unknown of the drift. A rest goes
on before the touch where that pays.
"""

from __future__ import annotations

from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.process.touches import Drift
from edmctl.record.rows import RunEvent
from edmctl.wording import duration


def drift_between(run: JobRun, first: SurfaceReading, last: SurfaceReading) -> Drift | None:
    """Return how much a touch drifted between two readings, by the rests before them.

    None where nobody has measured what rests and touches of the machine have in common, where a reading has no
    rest, as one that an earlier run has left, and where all that the rests leave unknown is more than what the run
    goes by without: creep of a use that nobody has followed may be in them.
    """
    job = run.job
    if job.drift is None or first.rest is None or last.rest is None:
        return None
    seconds = last.time_s - first.time_s
    found = job.drift.between(first.rest, last.rest, seconds, job.unknown_use_s)
    return found if found.left_u_um < run.uncertainty.drift_u_um_per_s * seconds else None


def rest_before_pad(run: JobRun, first: SurfaceReading) -> None:
    """Rest at 0 V over the pad before it is touched again, where more is gained of wear than lost of depth."""
    model = run.job.drift
    if model is None or first.rest is None:
        return
    move_to(run, run.job.pad)
    now = run.watch.last_rest
    assert now is not None
    more_s = model.rest_that_pays_s(
        first.rest,
        now,
        now.time_s - first.time_s,
        run.job.unknown_use_s,
        run.uncertainty.drift_u_um_per_s,
    )
    if not more_s:
        return
    message = (
        f"Rests for {duration(more_s)} before the pad: creep of the cut fades, and drift is known better."
    )
    run.decide(RunEvent.CREEP_RESTED_OUT, message, {"rest_s": more_s})
    run.machine.rest(more_s)
