"""The common drift of rests at 0 V and touches of the pad: touched and rested in turn, with a hold at depth between.

No sparks are made. The tool is held over free space, at the parking place: creep after it moves rests and no
touches, and touches of the pad alone would not cause it as a job does.
"""

from __future__ import annotations

import math

from edmctl import failures
from edmctl.dataclasses import dataclass, field
from edmctl.planning.measuring import again_s, move_time_s, park_to_pad_um, touch_time_s
from edmctl.procedures.monitoring.monitors import judge
from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import move_to, retract
from edmctl.procedures.touch.approach import lower_to
from edmctl.procedures.touch.reading import SurfaceReading, take_reading
from edmctl.procedures.touch.surfaces import OFFSET_U_UM, read_pad
from edmctl.process.rest_drift import LEAST_TOUCHES, DriftFit, Rest, fit_drift, model_of, refuse_creep
from edmctl.process.touches import Touch
from edmctl.profile.model import Profile
from edmctl.profile.setup import Setup
from edmctl.profile.tables import accepts, permitted_at
from edmctl.record.rows import RunEvent
from edmctl.results.measurements import DriftResult
from edmctl.results.progress import Phase
from edmctl.wording import decimal

AGAIN_U_UM = 0.5  # standard uncertainty of every further touch of the pad: drift of a minute, and creep
BEFORE_HOLD_SHARE = 0.3  # of the time without the hold; the rest shows the creep of the hold fade
RESTED_S = 1.0  # time from a retraction to the rest; in a job the stages move for as long
STROKE_SHARE = 0.95  # largest share of the permitted stroke for the hold
TOUCH_S = 12.0  # time of a touch of a known pad from 0 V and back, besides its contacts
MOST_MISFIT = 3.0  # largest ratio of residuals to the expected ones; beyond it not only creep and drift act


@dataclass(frozen=True, slots=True)
class DriftPlan:
    """Touches every `interval_s` for `duration_s`, with a hold of `hold_s` at `hold_um` between them."""

    duration_s: float
    interval_s: float
    hold_um: float
    hold_s: float

    @property
    def touches(self) -> int:
        """Approximate number of touches."""
        return int((self.duration_s - self.hold_s) // self.interval_s) + 1


@dataclass(slots=True)
class DriftRecord:
    """Rests and touches, the index of the first rest after the hold, and the first reading of the pad."""

    rests: list[Rest] = field(default_factory=list)
    touches: list[Touch] = field(default_factory=list)
    held_after: int = 0
    first: SurfaceReading | None = None


def plan_drift(profile: Profile, setup: Setup, duration_s: float | None = None) -> DriftPlan:
    """Plan by the setup, or over the given time.

    Raises UsageError E2064 if the time is beyond the bounds of drift.duration_s or too short for the hold,
    PreconditionError E8034 without a sensor.
    """
    drift, key = setup.drift, ("drift", "duration_s")
    if duration_s is not None and not accepts(Setup, key, duration_s):
        raise failures.drift_duration_out_of_range(duration_s=duration_s, setup=permitted_at(Setup, key))
    if not setup.sensor.fitted:
        raise failures.drift_without_sensor()
    stroke_um = STROKE_SHARE * setup.actuator.gain_um_per_v * profile.limits.stroke_v_max
    plan = DriftPlan(
        duration_s=drift.duration_s if duration_s is None else duration_s,
        interval_s=drift.interval_s,
        hold_um=min(drift.hold_um, stroke_um),
        hold_s=drift.hold_s,
    )
    least = LEAST_TOUCHES + 1
    if plan.touches < least:
        raise failures.too_few_drift_touches(
            duration_s=plan.duration_s,
            hold_s=plan.hold_s,
            interval_s=plan.interval_s,
            value=max(0, plan.touches),
            least=least,
        )
    return plan


def drift_time_s(plan: DriftPlan, profile: Profile, setup: Setup) -> float:
    """Return the time from an idle machine to the last touch, s."""
    moves_s = 2.0 * move_time_s(park_to_pad_um(setup), setup)
    last_s = TOUCH_S + profile.measure.touches * again_s(profile)
    return touch_time_s(profile, setup) + plan.duration_s + moves_s + last_s


def measure_drift(run: JobRun, plan: DriftPlan, expected_um: float) -> DriftRecord:
    """Touch the pad, expected at `expected_um`, and rest in turn; hold the tool at depth over the parking place."""
    pad, record = run.job.pad, DriftRecord()
    first = read_pad(run, "Z1", pad.name, expected_um, OFFSET_U_UM)
    record.first, predicted_um = first, first.z_um
    move_to(run, pad)
    begin_s = run.machine.time_s
    next_s, is_held = begin_s, False
    while run.machine.time_s - begin_s < plan.duration_s:
        if not is_held and next_s - begin_s >= BEFORE_HOLD_SHARE * (plan.duration_s - plan.hold_s):
            is_held = True
            record.held_after = len(record.rests)
            move_to(run, run.job.parking)
            run.begin(Phase.MEASURING)
            lower_to(run, run.tally.home_um + plan.hold_um)
            run.machine.rest(plan.hold_s)
            remedy = "Set stage.park_x_um and park_y_um to where the tool may use its whole stroke."
            run.refuse_contact(" over the parking place", remedy)
            move_to(run, pad)
            run.machine.rest(RESTED_S)
            _note_rest(run, record)
            next_s = run.machine.time_s
        run.begin(Phase.MEASURING)
        run.machine.rest(max(RESTED_S, next_s - run.machine.time_s))
        _note_rest(run, record)
        found = take_reading(run, "Z1", pad.name, predicted_um, AGAIN_U_UM)
        predicted_um = found.z_um
        record.touches.append(Touch(found.time_s, found.reading))
        retract(run)
        run.machine.rest(RESTED_S)
        _note_rest(run, record)
        next_s += plan.interval_s
    return record


def drift_result(run: JobRun, plan: DriftPlan, record: DriftRecord) -> tuple[DriftFit, DriftResult]:
    """Regress touches on rests. Raises ObjectiveNotReached E7041 if drift and creep do not explain them."""
    try:
        walk = run.setup.drift.walk_um_per_sqrt_s
        fit = fit_drift(record.rests, record.touches, walk, run.job.unknown_use_s)
        refuse_creep(fit.creep, fit.creep_covariance)
    except ValueError as error:
        raise failures.drift_not_conclusive(what=f"the touches tell nothing: {error}") from error
    if fit.misfit > MOST_MISFIT:
        raise failures.drift_not_conclusive(
            what=f"residuals of {decimal(fit.rest_rms_um)} µm at rest and {decimal(fit.touch_rms_um)} µm at the pad "
            f"are {fit.misfit:.1f} times what drift, creep and noise explain"
        )
    used, share = model_of(fit), fit.share if fit.is_steady else None
    before, after = record.rests[record.held_after - 1], record.rests[record.held_after]
    lags_um = after.lags_um - before.lags_um
    rest, touch, apart = fit.rest_um_per_s, fit.touch_um_per_s, fit.apart_um_per_s
    pads = [record.first] if record.first else []
    result = DriftResult(
        rest_um_per_s=rest.value,
        rest_u_um_per_s=rest.u,
        touch_um_per_s=touch.value,
        touch_u_um_per_s=touch.u,
        apart_um_per_s=apart.value,
        apart_u_um_per_s=apart.u,
        share=share.value if share else math.nan,
        share_u=share.u if share else math.nan,
        share_used=used.share,
        share_used_u=used.share_u,
        creep_um=float(fit.creep @ lags_um),
        creep_u_um=math.sqrt(max(0.0, float(lags_um @ fit.creep_covariance @ lags_um))),
        rests=len(record.rests),
        touches=len(record.touches),
        outliers=fit.outliers,
        misfit=fit.misfit,
        rest_rms_um=fit.rest_rms_um,
        touch_rms_um=fit.touch_rms_um,
        hold_um=plan.hold_um,
        hold_s=plan.hold_s,
        time_s=run.machine.time_s,
        beliefs=judge(run, pads, rest.value, rest.u),
    )
    run.decide(
        RunEvent.DRIFT_MEASURED,
        f"Rests drift by {decimal(1e3 * rest.value)} nm/s, touches by {decimal(1e3 * touch.value)} nm/s; creep "
        f"after the hold {decimal(result.creep_um)} µm.",
        {"rest_um_s": rest.value, "touch_um_s": touch.value, "share": used.share},
    )
    return fit, result


def _note_rest(run: JobRun, record: DriftRecord) -> None:
    run.watch.rest()
    assert run.watch.last_rest is not None
    record.rests.append(run.watch.last_rest)
