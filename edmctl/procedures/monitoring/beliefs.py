"""Check of the setup's uncertainties: tilt by the two spots of the pad, drift by the rests.

A value contradicts a standard uncertainty if it is beyond two of them, with its own uncertainty: one in twenty does
so by chance. A wrong gain of the sensor scales everything alike, so that nothing in a job can show it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.labels import Seen
from edmctl.procedures.run import Args, JobRun
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.process.plane import CONTRADICTION_SDS
from edmctl.record.rows import RunEvent
from edmctl.results.job import Belief

LEAST_SPAN_S = 60.0
"""Over less time creep of the first seconds after a cut would look like a drift."""


def judge_job(run: JobRun, pads: Sequence[SurfaceReading]) -> None:
    """Check the setup by all readings of the pad in a job, into its tally."""
    run.tally.beliefs = judge(run, pads, *_drift_um_s(run, pads))


def judge(
    run: JobRun, pads: Sequence[SurfaceReading], drift_um_s: float, drift_u_um_s: float
) -> tuple[Belief, ...]:
    """Compare the setup's uncertainties with readings of the pad and with a drift; warn of contradictions.

    The drift is that of the rests without creep, with its standard uncertainty; NaN if unknown.
    """
    setup = run.setup
    beliefs = (
        _judged("surface.tilt_u_mrad", setup.surface.tilt_u_mrad, *_slope_mrad(run, pads)),
        _judged("sensor.drift_um_per_s", setup.sensor.drift_um_per_s, drift_um_s, drift_u_um_s),
        Belief("sensor.gain_u_rel", setup.sensor.gain_u_rel, math.nan, math.nan, Seen.NEVER),
    )
    for belief in beliefs:
        if belief.seen is Seen.CONTRADICTED:
            args: Args = {"belief": belief.name, "believed": belief.believed, "found": belief.found}
            run.warn(RunEvent.BELIEF_CONTRADICTED, belief.message, args)
    return beliefs


def _judged(name: str, believed: float, found: float, u: float) -> Belief:
    if math.isnan(found):
        return Belief(name, believed, found, u, Seen.NOT)
    contradicted = abs(found) > CONTRADICTION_SDS * math.hypot(believed, u)
    return Belief(name, believed, found, u, Seen.CONTRADICTED if contradicted else Seen.HELD)


def _slope_mrad(run: JobRun, pads: Sequence[SurfaceReading]) -> tuple[float, float]:
    """Return the slope between the two spots of the pad and its standard uncertainty; NaN without one."""
    steps = [pad.step for pad in pads if pad.step is not None]
    if not steps:
        return math.nan, math.nan
    touch_u_um = run.tally.scatter.u_um
    slopes = [1e3 * step.um / math.hypot(*step.way_um) for step in steps]
    us = [1e3 * step.u_um(touch_u_um) / math.hypot(*step.way_um) for step in steps]
    return math.fsum(slopes) / len(steps), math.sqrt(math.fsum(u**2 for u in us)) / len(steps)


def _drift_um_s(run: JobRun, pads: Sequence[SurfaceReading]) -> tuple[float, float]:
    """Return the drift of the rests without creep and its standard uncertainty; NaN over a short time.

    Measured creep is subtracted from the first to the last reading of the pad; otherwise it is bounded.
    """
    drift, rests = run.job.drift, [pad.rest for pad in pads if pad.rest is not None]
    if drift is not None and len(rests) > 1:
        span_s = rests[-1].time_s - rests[0].time_s
        moved = drift.rest_moved(rests[0], rests[-1], run.job.unknown_use_s)
    else:
        span_s, moved = run.watch.rests.drifted()
    if span_s < LEAST_SPAN_S:
        return math.nan, math.nan
    return moved.um / span_s, moved.left_u_um / span_s
