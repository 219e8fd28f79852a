"""A Z reading: several contacts at one place, reduced to their mean.

The tool hunts at contact, so that creep cannot push it into the work, and the sensor is averaged meanwhile
(Muralidhara et al. 2009, §4).
"""

from __future__ import annotations

import math

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import ObjectiveNotReached
from edmctl.machine.interface import Touch, TouchRequest
from edmctl.planning.measuring import FAST_LEG_MARGIN_UM
from edmctl.procedures.job import JobState
from edmctl.procedures.run import JobRun
from edmctl.process.plane import Step
from edmctl.process.rest_drift import Rest
from edmctl.process.touches import Reading, is_constant, reading_of
from edmctl.record.rows import EventLevel, RunEvent, TouchRow
from edmctl.results.progress import Phase
from edmctl.wording import decimal

FAST_SIGMAS = 2.0  # and this many standard uncertainties: a tool that meets the work then returns slowly
BEYOND_PREDICTION_UM = 15.0  # no contact this far beyond the predicted one is a fault
BEYOND_SIGMAS = 3.0  # and this many standard uncertainties
NO_CONTACT = "E62005"  # no contact up to the end of a search
ATTEMPTS = 2
_TELEMETRY_LAG_S = 0.2  # after this, the samples around the last event have arrived


@dataclass(frozen=True, slots=True)
class SurfaceReading:
    """Where the tool met a surface: by the sensor (`reading`), and by the actuator model (`model_um`).

    Without a sensor both are the model's. `zero_um` is the zero of the model, `creep_um` the creep since the last
    rest that it extrapolates; `doubt_u_um` is an additional standard uncertainty of doubted touches, `debris_um` the
    height of debris at the first spot, `step` how much further the second of two spots is, if both count.
    """

    kind: str
    reading: Reading
    model_um: float
    actuator_v: float
    time_s: float
    zero_um: float
    creep_um: float = 0.0
    doubt_u_um: float = 0.0
    debris_um: float = 0.0
    step: Step | None = None
    rest: Rest | None = None

    @property
    def z_um(self) -> float:
        return self.reading.mean_um

    def shifted(self, way_um: float) -> SurfaceReading:
        """Return the reading as if it were `way_um` further."""
        if way_um == 0.0:
            return self
        reading = replace(self.reading, mean_um=self.reading.mean_um + way_um)
        return replace(self, reading=reading, model_um=self.model_um + way_um)

    def as_z1(self, state: JobState, earlier_time_s: float, u_um: float = 0.0) -> JobState:
        """Return the state of a job with this reading of the pad; the run began at `earlier_time_s` of the job."""
        return replace(
            state,
            z1_um=self.z_um,
            z1_sd_um=self.reading.sd_um,
            z1_touches=self.reading.touches,
            z1_u_um=u_um,
            z1_doubt_u_um=self.doubt_u_um,
            z1_time_s=earlier_time_s + self.time_s,
            z1_model_um=self.model_um,
        )


@dataclass(frozen=True, slots=True)
class Search:
    """A search of a surface: fast to `fast_to_um`, then slowly to `z_max_um`, `touches` times after a rest."""

    fast_to_um: float
    z_max_um: float
    touches: int
    settle_s: float


def search_near(run: JobRun, predicted_um: float, u_um: float, deepest_um: float = -math.inf) -> Search:
    """Return the search by the recipe for a contact at `predicted_um`; it ends beyond `deepest_um` at least."""
    measure, fast_to_um = run.profile.measure, predicted_um - FAST_LEG_MARGIN_UM - FAST_SIGMAS * u_um
    z_max_um = max(predicted_um + BEYOND_SIGMAS * u_um, deepest_um) + BEYOND_PREDICTION_UM
    return Search(fast_to_um, z_max_um, measure.touches, measure.settle_s)


def take_reading(
    run: JobRun, kind: str, place: str, predicted_um: float, u_um: float = 0.0
) -> SurfaceReading:
    """Touch off `measure.touches` times and average; once more if they scatter too much.

    Contact is expected at `predicted_um`, with a standard uncertainty of `u_um`. The tool begins at least 20 µm
    above it, and ends a back-off above it. Raises PreconditionError if the sensor reads contact before.
    """
    return take_reading_in(run, kind, place, search_near(run, predicted_um, u_um))


def take_reading_in(run: JobRun, kind: str, place: str, search: Search) -> SurfaceReading:
    """Return the same with a given search."""
    run.begin(Phase.MEASURING)
    run.machine.rest(search.settle_s)
    run.refuse_contact(
        ", clear of the surface", "Look for a chip between tool and work, or a shorted continuity wire."
    )
    measure = run.profile.measure
    request = TouchRequest(
        fast_um_s=measure.fast_um_s,
        fast_to_um=search.fast_to_um,
        speed_um_s=measure.speed_um_s,
        z_max_um=search.z_max_um,
        back_off_um=measure.back_off_um,
        dwell_s=measure.dwell_s,
        touches=search.touches,
    )
    for _ in range(ATTEMPTS):
        touches = run.machine.touch(request)
        run.machine.rest(_TELEMETRY_LAG_S)
        found = _reduced(run, kind, touches)
        refused = None
        if is_constant((found.reading,)):
            refused = constant(found)
        elif found.reading.sd_um > measure.max_sd_um:
            refused = failures.touches_scatter(
                kind=kind, sd_um=found.reading.sd_um, most_um=measure.max_sd_um
            )
        _report(run, place, touches, found, refused.message if refused else "")
        if refused is None:
            run.tally.scatter.add(found.reading)
            tracker = run.watch.tracker()
            if tracker is not None:
                tracker.note(found.model_um, found.z_um)
            return found
    assert refused is not None
    raise refused


def constant(found: SurfaceReading) -> ObjectiveNotReached:
    """Return the error of touches that repeat to the last digit."""
    return failures.touches_identical(kind=found.kind, z_um=found.z_um)


def _reduced(run: JobRun, kind: str, touches: tuple[Touch, ...]) -> SurfaceReading:
    """Return the mean of the touches; the model is read at first contact, where the voltage peaks."""
    models_um = [run.watch.model_at(touch.time_s) for touch in touches]
    tracker = run.watch.tracker()
    return SurfaceReading(
        kind=kind,
        reading=reading_of(tuple(touch.displacement_um for touch in touches)),
        model_um=sum(models_um) / len(models_um),
        actuator_v=sum(touch.actuator_v for touch in touches) / len(touches),
        time_s=touches[-1].time_s,
        zero_um=math.nan if tracker is None else tracker.estimator.offset_um,
        creep_um=0.0 if tracker is None else tracker.creep_um(),
        rest=run.watch.last_rest,
    )


def _report(run: JobRun, place: str, touches: tuple[Touch, ...], found: SurfaceReading, refused: str) -> None:
    reading = found.reading
    run.recorder.append(
        TouchRow(
            time_s=found.time_s,
            kind=found.kind,
            site=place,
            actuator_v=found.actuator_v,
            displacement_um=reading.mean_um if run.setup.sensor.fitted else math.nan,
            model_um=found.model_um,
            touches=reading.touches,
            sd_um=reading.sd_um,
            drift_um=touches[-1].displacement_um - touches[0].displacement_um,
            speed_um_s=run.profile.measure.speed_um_s,
            accepted=not refused,
        )
    )
    model = "" if math.isnan(found.model_um) else f" (model {decimal(found.model_um, 1)} µm)"
    count = (
        "1 touch" if reading.touches == 1 else f"{reading.touches} touches within {reading.sd_um:.2f} µm rms"
    )
    run.decide(
        RunEvent.READING_REJECTED if refused else RunEvent.READING,
        refused or f"{found.kind} = {decimal(reading.mean_um)} µm{model}, {count}.",
        {"kind": found.kind, "z_um": reading.mean_um, "model_um": found.model_um, "sd_um": reading.sd_um},
        level=EventLevel.WARNING if refused else EventLevel.INFO,
    )
