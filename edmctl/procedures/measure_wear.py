"""Tool wear and depth after a job, by touches: pad, bottom, pad again, against the reference before the job.

`wear = Z3 - Z1`, `depth = Z2 - Z3` and `feed = Z2 - Z1 = depth + wear` (Muralidhara et al. 2009, §4). Z3 is the mean
of the pad before and after the bottom, so that a steady drift takes nothing from the depth; their difference shows
it. The bottom is compared with the known depth of the hole, and a tool that has grown is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.labels import Basis
from edmctl.procedures.hole.hole import model_u95_um
from edmctl.procedures.monitoring.drift import displacement_uncertainty
from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import read_expected
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.procedures.touch.surfaces import OFFSET_U_UM, SurfacePlane, pad_u_um, read_pad, refuse_grown_tool
from edmctl.process.touches import (
    TOUCH_U_UM,
    DepthAndWear,
    Displacement,
    Drift,
    Reading,
    Touch,
    measure,
    share_u,
)
from edmctl.profile.places import Place
from edmctl.quantity import Value, half_width
from edmctl.record.rows import RunEvent
from edmctl.results.measurements import UncertaintyPart, WearResult
from edmctl.wording import signed

LEAST_TOUCHES = 3  # touches of every Z: the scatter of two shows next to nothing
MOST_DRIFT_UM = 2.0  # of the pad in minutes: more leaves the wear unknown. Our choice: a tolerance of recipes
HOME_CREEP_UM = 9.0  # residual creep in a home: 4 µm after a deep hole, 8 µm after a calibration [assumed]
BOTTOM_U_UM = 2.0  # u of a bottom without a stated one: debris, and the roughness of its floor


@dataclass(frozen=True, slots=True)
class Reference:
    """Z1 of the tool before its job: its touches, its age, and the standard uncertainty of doubts about it.

    `home_um` is the sensor reading of a tool at home then, NaN if unknown. `drift_um_per_s` is the drift of
    touches that `measure-drift` has measured on the machine, None without a drift file.
    """

    z_um: float
    sd_um: float
    touches: int
    model_um: float
    age_s: float
    doubt_u_um: float = 0.0
    home_um: float = math.nan
    drift_um_per_s: Value | None = None


@dataclass(frozen=True, slots=True)
class Bottom:
    """A hole whose bottom is touched, its known depth, and the run that made it."""

    name: str
    x_um: float
    y_um: float
    depth_um: float
    depth_u_um: float = BOTTOM_U_UM
    run_file: str = ""


def touch_pad(run: JobRun, kind: str, expected_um: float, more_u_um: float = 0.0) -> SurfaceReading:
    """Touch the pad, expected at `expected_um`, with `more_u_um` more of standard uncertainty than usual."""
    return read_pad(run, kind, run.job.pad.name, expected_um, math.hypot(OFFSET_U_UM, more_u_um))


def measure_wear(run: JobRun, reference: Reference, expected_um: float, bottom: Bottom | None) -> WearResult:
    """Touch the pad, where it is expected at `expected_um`, then the bottom of a hole, then the pad again."""
    home = run.tally.home_um, run.tally.home_s
    before = touch_pad(run, "Z3", expected_um)
    z2, face_um, face_u_um = None, 0.0, pad_u_um(run.setup)
    if bottom is None:
        move_to(run, run.job.parking)
    else:
        surface, site = SurfacePlane(run), Place(bottom.name, bottom.x_um, bottom.y_um)
        surface.fit_pad_slope(before)
        face_um, face_u_um = surface.height_um(site), math.hypot(surface.height_u_um(site), face_u_um)
        move_to(run, site)
        depth_u_um = math.hypot(bottom.depth_u_um, face_u_um)
        z_um, source = before.z_um + face_um, "the job that made it"
        z2 = read_expected(run, bottom.name, z_um, bottom.depth_um, depth_u_um, source)
    after = touch_pad(run, "Z3", before.z_um)
    face = Value(face_um, face_u_um)
    return _Measurement(run, reference, home, (before, after), z2, face).result()


def refuse_drift(run: JobRun, found: WearResult) -> None:
    """Raise ObjectiveNotReached E7040 if the pad moved too far between two touches."""
    if abs(found.drift_um) <= MOST_DRIFT_UM:
        return
    error = failures.reference_not_steady(drift_um=signed(found.drift_um), most_um=MOST_DRIFT_UM)
    run.warn(RunEvent.WEAR_MEASURED, error.message, {"drift_um": found.drift_um})
    raise error


class _Measurement:
    def __init__(
        self,
        run: JobRun,
        reference: Reference,
        home: tuple[float, float],
        pads: tuple[SurfaceReading, SurfaceReading],
        z2: SurfaceReading | None,
        face: Value,
    ) -> None:
        self._run, self._reference, self._z2, self._face = run, reference, z2, face
        self._before, self._after = before, after = pads
        self._home_um, self._home_s = home
        self._z3 = _mean(before.reading, after.reading)
        self._bottom = z2.reading if z2 else self._z3
        self._pad_u_um = pad_u_um(run.setup)
        self._age_s = reference.age_s + after.time_s
        self._depth_s = after.time_s - z2.time_s if z2 else 0.0
        doubts = 0.5 * (before.doubt_u_um + after.doubt_u_um)
        self._doubts_u_um = (reference.doubt_u_um, z2.doubt_u_um if z2 else 0.0, doubts)
        self._drift = self._drift_since_reference()
        self._z1 = Reading(reference.z_um + self._drift.um, reference.sd_um, reference.touches)

    def result(self) -> WearResult:
        """Return wear and depth. Raises ObjectiveNotReached E7023 if the tool has grown."""
        run, reference, z2, drift = self._run, self._reference, self._z2, self._drift
        before, after, z1, bottom = self._before, self._after, self._z1, self._bottom
        refuse_grown_tool(run, z1.mean_um, after, self._age_s)
        found = measure(
            Touch(-self._age_s, z1, self._doubts_u_um[0]),
            Touch(-self._depth_s, bottom, self._doubts_u_um[1]),
            Touch(0.0, self._z3, self._doubts_u_um[2]),
            run.uncertainty,
            tilt_u_um=self._face.u,
            pad_u_um=self._pad_u_um,
            height_um=self._face.value,
            drift=Drift(0.0, drift.left_u_um),
        )
        model3_um = 0.5 * (before.model_um + after.model_um)
        model2_um, creep_um, depth_basis = math.nan, 0.0, None
        if z2 is not None:
            model2_um, creep_um = z2.model_um, z2.creep_um - 0.5 * (before.creep_um + after.creep_um)
            depth_basis = Basis.ESTIMATED if z2.doubt_u_um > 0.0 else run.job.touch_basis
        depth_model_u95_um, wear_model_u95_um = model_u95_um(run, found, creep_um)

        def of_hole(value: float) -> float:
            return math.nan if z2 is None else value

        return WearResult(
            z1_um=reference.z_um,
            z2_um=of_hole(bottom.mean_um),
            z3_um=self._z3.mean_um,
            z3_before_um=before.z_um,
            z3_after_um=after.z_um,
            drift_um=after.z_um - before.z_um,
            drift_correction_um=drift.um,
            touches=min(reading.touches for reading in (z1, bottom, before.reading, after.reading)),
            sd_um=(z1.sd_um, of_hole(bottom.sd_um), before.reading.sd_um, after.reading.sd_um),
            wear_um=found.wear_um,
            wear_u95_um=found.wear.u95,
            depth_um=of_hole(found.depth_um),
            depth_u95_um=of_hole(found.depth.u95),
            feed_um=of_hole(found.feed_um),
            feed_u95_um=of_hole(found.feed.u95),
            wear_model_um=model3_um - reference.model_um - drift.um,
            wear_model_u95_um=wear_model_u95_um,
            depth_model_um=model2_um - model3_um - self._face.value,
            depth_model_u95_um=of_hole(depth_model_u95_um),
            feed_model_um=model2_um - reference.model_um - drift.um,
            feed_model_u95_um=of_hole(math.hypot(depth_model_u95_um, wear_model_u95_um)),
            depth_basis=depth_basis,
            wear_basis=run.job.touch_basis,
            budget=self._budget(found),
            time_s=run.machine.time_s,
        )

    def _budget(self, found: DepthAndWear) -> tuple[UncertaintyPart, ...]:
        sensor_u, drift, face_u_um = self._run.uncertainty, self._drift, self._face.u
        between_u_um = sensor_u.drifted_u_um(self._depth_s)
        feed_drift_um = math.hypot((1.0 - self._depth_s / self._age_s) * drift.left_u_um, between_u_um)
        readings = (self._z1, self._bottom, self._z3)
        noise_um = found.depth_noise_um / math.sqrt(1.0 / self._bottom.touches + 1.0 / self._z3.touches)
        noises_um = [noise_um / math.sqrt(reading.touches) for reading in readings]
        lengths_um = (found.wear_um, found.depth_um, found.feed_um)

        def of_pairs(values: Sequence[float]) -> Iterable[float]:
            """Combine those of Z1, Z2 and Z3: wear, depth and feed are differences of two each."""
            return (math.hypot(values[i], values[j]) for i, j in ((0, 2), (1, 2), (0, 1)))

        budget = (
            UncertaintyPart("scatter of the touches", *of_pairs(noises_um)),
            UncertaintyPart("drift of the sensor", drift.left_u_um, between_u_um, feed_drift_um),
            UncertaintyPart("gain of the sensor", *(sensor_u.gain_u_rel * abs(um) for um in lengths_um)),
            UncertaintyPart("linearity of the sensor", *(sensor_u.bend_u_um(um) for um in lengths_um)),
            UncertaintyPart("tilt and stages", self._pad_u_um, face_u_um, face_u_um),
            UncertaintyPart("touches in doubt", *of_pairs(self._doubts_u_um)),
        )
        if self._z2 is not None:
            return budget
        return tuple(replace(part, depth_um=math.nan, feed_um=math.nan) for part in budget)

    def _drift_since_reference(self) -> Drift:
        """Return the drift by the rate that `measure-drift` has measured, otherwise its bound.

        The difference of the homes of then and now bounds the drift between them, apart from creep in both. A rate
        by the rests of some minutes, mostly creep, is not that of hours.
        """
        reference, before, after, age_s = self._reference, self._before, self._after, self._age_s
        sensor_u = self._run.uncertainty
        until_s = 0.5 * (before.time_s + after.time_s)
        drift = drift_since(reference, self._home_um, reference.age_s + until_s, sensor_u)
        if drift is not None:
            return drift
        rate_um_s = sensor_u.drift_u_um_per_s
        seen_um_s = (abs(after.z_um - before.z_um) + TOUCH_U_UM) / max(1.0, after.time_s - before.time_s)
        since_um = min(rate_um_s, seen_um_s) * (after.time_s - self._home_s)
        moved_um, drifting_s = abs(self._home_um - reference.home_um), age_s
        if rate_um_s and math.isfinite(moved_um + since_um):
            by_setup_um = displacement_uncertainty(self._run.job).drift_u_um_per_s * age_s
            between_um = max(by_setup_um, share_u(moved_um + HOME_CREEP_UM))
            drifting_s = min(age_s, math.hypot(between_um, since_um) / rate_um_s)
        return Drift(0.0, sensor_u.drifted_u_um(drifting_s))


def drift_since(reference: Reference, home_um: float, age_s: float, sensor_u: Displacement) -> Drift | None:
    """Return the drift since the reference by a measured rate; None without one, or if the home contradicts it."""
    rate = reference.drift_um_per_s
    if rate is None:
        return None
    drift = Drift(rate.value * age_s, replace(sensor_u, drift_u_um_per_s=rate.u).drifted_u_um(age_s))
    off_um = abs(home_um - reference.home_um - drift.um)
    return None if off_um > HOME_CREEP_UM + half_width(drift.left_u_um) else drift


def _mean(a: Reading, b: Reading) -> Reading:
    """Return two readings of one place as one: the mean, and the scatter within them."""
    dof = a.touches + b.touches - 2
    squares = (a.touches - 1) * a.sd_um**2 + (b.touches - 1) * b.sd_um**2
    sd_um = math.sqrt(squares / dof) if dof else 0.0
    return Reading(0.5 * (a.mean_um + b.mean_um), sd_um, a.touches + b.touches)
