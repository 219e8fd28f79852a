"""Tool wear and depth after a job, by touches: pad, bottom, pad again, against the reference before the job.

`wear = Z3 - Z1`, `depth = Z2 - Z3` and `feed = Z2 - Z1 = depth + wear` (Muralidhara et al. 2009, §4). Z3 is the mean
of the pad before and after the bottom, so that a steady drift takes nothing from the depth; their difference tells
it. The bottom is judged by how deep the hole is known to be, and a tool that has grown is refused.
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import ObjectiveNotReached
from edmctl.labels import Basis
from edmctl.procedures.hole.hole import model_u95_um
from edmctl.procedures.monitoring.drift import displacement_uncertainty
from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import ExpectedBottom, read_expected
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.procedures.touch.spots import pad_u_um, read_pad, refuse_grown_tool
from edmctl.procedures.touch.surface_plane import fit_pad_slope, level_surface
from edmctl.process.touches import TOUCH_U_UM, Displacement, Drift, Reading, Touch, measure, share_u
from edmctl.profile.places import Place
from edmctl.quantity import Value, half_width
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.results.measurements import UncertaintyPart, WearResult
from edmctl.wording import signed

LEAST_TOUCHES = 3
"""Of every Z: the scatter of two says next to nothing."""
MOST_DRIFT_UM = 2.0
"""Between the pad before and after the bottom, minutes apart: more of it, and the wear, which is taken over the
whole job, is not known any more. Our choice: the tolerance that shipped recipes allow for a depth."""
HOME_CREEP_UM = 9.0
"""Creep that what was driven before leaves in a home, however long ago: 4 µm after a deep hole and 8 µm after a
calibration were seen on the virtual machine. It hides as much of a drift the other way [assumed]."""
PAD_U_UM = 3.5
"""Standard uncertainty with which the first touch of the pad is foreseen: drift, and a tool that was set anew to the
same height."""
BOTTOM_U_UM = 2.0
"""The same of a bottom whose depth nobody has stated an uncertainty of: debris, and the roughness of its floor."""


@dataclass(frozen=True, slots=True)
class Reference:
    """Z1 of the tool before its job, and what is known of it: its touches, how long ago it was, what is in doubt.

    `home_um` is what the sensor showed of a tool at home then, NaN if unknown. `drift_um_per_s` is the drift of
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
    """A hole whose bottom is touched, as deep as it is known to be, and the run that made it."""

    name: str
    x_um: float
    y_um: float
    depth_um: float
    depth_u_um: float = BOTTOM_U_UM
    run_file: str = ""


def touch_pad(run: JobRun, kind: str, expected_um: float, more_u_um: float = 0.0) -> SurfaceReading:
    """Touch the pad, expected at `expected_um`, with `more_u_um` more of standard uncertainty than usual."""
    return read_pad(run, kind, run.job.pad.name, expected_um, math.hypot(PAD_U_UM, more_u_um))


def measure_wear(run: JobRun, reference: Reference, expected_um: float, bottom: Bottom | None) -> WearResult:
    """Touch the pad, where it is expected at `expected_um`, then the bottom of a hole, then the pad again."""
    home = run.tally.home_um, run.tally.home_s
    before = touch_pad(run, "Z3", expected_um)
    z2, face_um, face_u_um = None, 0.0, pad_u_um(run.setup)
    if bottom is None:
        move_to(run, run.job.parking)
    else:
        surface, site = level_surface(run), Place(bottom.name, bottom.x_um, bottom.y_um)
        fit_pad_slope(run, surface, before)
        face_um, face_u_um = surface.height_um(site), math.hypot(surface.height_u_um(site), face_u_um)
        move_to(run, site)
        depth_u_um = math.hypot(bottom.depth_u_um, face_u_um)
        expected = ExpectedBottom(before.z_um + face_um, bottom.depth_um, depth_u_um, "the job that made it")
        z2 = read_expected(run, bottom.name, expected)
    after = touch_pad(run, "Z3", before.z_um)
    return _found(run, reference, home, before, z2, after, face_um, face_u_um)


def refuse_drift(run: JobRun, found: WearResult) -> None:
    """Raise ObjectiveNotReached E7040 where the pad moved too far between two touches."""
    if abs(found.drift_um) <= MOST_DRIFT_UM:
        return
    message = (
        f"Z3 moved by {signed(found.drift_um)} µm while the hole was measured; at most {MOST_DRIFT_UM:g} µm are "
        "allowed."
    )
    run.decide(RunEvent.WEAR_MEASURED, message, {"drift_um": found.drift_um}, level=EventLevel.WARNING)
    raise ObjectiveNotReached(
        message,
        hint="Let machine and dielectric warm up, look for chips on the pad, and measure again.",
        code="E7040",
    )


def _found(
    run: JobRun,
    reference: Reference,
    home: tuple[float, float],
    before: SurfaceReading,
    z2: SurfaceReading | None,
    after: SurfaceReading,
    face_um: float,
    face_u_um: float,
) -> WearResult:
    z3 = _mean(before.reading, after.reading)
    bottom = z2.reading if z2 else z3
    sensor_u, meeting_u_um = run.uncertainty, pad_u_um(run.setup)
    age_s = reference.age_s + after.time_s
    until_s = 0.5 * (before.time_s + after.time_s)
    drift = drift_since(reference, home[0], reference.age_s + until_s, sensor_u)
    if drift is None:
        seen_um_s = (abs(after.z_um - before.z_um) + TOUCH_U_UM) / max(1.0, after.time_s - before.time_s)
        since_um = min(sensor_u.drift_u_um_per_s, seen_um_s) * (after.time_s - home[1])
        drifting_s = _drifting_s(run, reference, home[0], age_s, since_um, sensor_u.drift_u_um_per_s)
        drift = Drift(0.0, sensor_u.drifted_u_um(drifting_s))
    z1 = Reading(reference.z_um + drift.um, reference.sd_um, reference.touches)
    refuse_grown_tool(run, z1.mean_um, after, age_s)
    depth_s = after.time_s - z2.time_s if z2 else 0.0
    pad_doubt_um = 0.5 * (before.doubt_u_um + after.doubt_u_um)
    doubts_u_um = (reference.doubt_u_um, z2.doubt_u_um if z2 else 0.0, pad_doubt_um)
    found = measure(
        Touch(-age_s, z1, doubts_u_um[0]),
        Touch(-depth_s, bottom, doubts_u_um[1]),
        Touch(0.0, z3, doubts_u_um[2]),
        sensor_u,
        tilt_u_um=face_u_um,
        pad_u_um=meeting_u_um,
        height_um=face_um,
        drift=Drift(0.0, drift.left_u_um),
    )
    lengths_um = (found.wear_um, found.depth_um, found.feed_um)
    model3_um = 0.5 * (before.model_um + after.model_um)
    model2_um = z2.model_um if z2 else math.nan
    hole = z2 is not None
    between_u_um = sensor_u.drifted_u_um(depth_s)
    creep_um = z2.creep_um - 0.5 * (before.creep_um + after.creep_um) if z2 else 0.0
    depth_model_u95_um, wear_model_u95_um = model_u95_um(run, found, creep_um)
    noise_um = found.depth_noise_um / math.sqrt(1.0 / bottom.touches + 1.0 / z3.touches)
    noises_um = [noise_um / math.sqrt(reading.touches) for reading in (z1, bottom, z3)]
    pairs = ((0, 2), (1, 2), (0, 1))  # of Z1, Z2 and Z3: wear, depth and feed
    budget = [
        UncertaintyPart(
            "scatter of the touches", *(math.hypot(noises_um[i], noises_um[j]) for i, j in pairs)
        ),
        UncertaintyPart(
            "drift of the sensor",
            drift.left_u_um,
            between_u_um,
            math.hypot((1.0 - depth_s / age_s) * drift.left_u_um, between_u_um),
        ),
        UncertaintyPart("gain of the sensor", *(sensor_u.gain_u_rel * abs(um) for um in lengths_um)),
        UncertaintyPart("linearity of the sensor", *(sensor_u.bend_u_um(um) for um in lengths_um)),
        UncertaintyPart("tilt and stages", meeting_u_um, face_u_um, face_u_um),
        UncertaintyPart("touches in doubt", *(math.hypot(doubts_u_um[i], doubts_u_um[j]) for i, j in pairs)),
    ]
    if not hole:
        budget = [replace(part, depth_um=math.nan, feed_um=math.nan) for part in budget]
    return WearResult(
        z1_um=reference.z_um,
        z2_um=bottom.mean_um if hole else math.nan,
        z3_um=z3.mean_um,
        z3_before_um=before.z_um,
        z3_after_um=after.z_um,
        drift_um=after.z_um - before.z_um,
        drift_correction_um=drift.um,
        touches=min(reading.touches for reading in (z1, bottom, before.reading, after.reading)),
        sd_um=(z1.sd_um, bottom.sd_um if hole else math.nan, before.reading.sd_um, after.reading.sd_um),
        wear_um=found.wear_um,
        wear_u95_um=found.wear.u95,
        depth_um=found.depth_um if hole else math.nan,
        depth_u95_um=found.depth.u95 if hole else math.nan,
        feed_um=found.feed_um if hole else math.nan,
        feed_u95_um=found.feed.u95 if hole else math.nan,
        wear_model_um=model3_um - reference.model_um - drift.um,
        wear_model_u95_um=wear_model_u95_um,
        depth_model_um=model2_um - model3_um - face_um,
        depth_model_u95_um=depth_model_u95_um if hole else math.nan,
        feed_model_um=model2_um - reference.model_um - drift.um,
        feed_model_u95_um=math.hypot(depth_model_u95_um, wear_model_u95_um) if hole else math.nan,
        depth_basis=None if z2 is None else Basis.ESTIMATED if z2.doubt_u_um > 0.0 else run.job.touch_basis,
        wear_basis=run.job.touch_basis,
        budget=tuple(budget),
        time_s=run.machine.time_s,
    )


def drift_since(reference: Reference, home_um: float, age_s: float, sensor_u: Displacement) -> Drift | None:
    """Return the drift of a touch since the reference, by the rate that `measure-drift` has measured.

    None if no rate was measured, or if the home at `home_um` contradicts it: then the rate has changed.
    """
    rate = reference.drift_um_per_s
    if rate is None:
        return None
    drift = Drift(rate.value * age_s, replace(sensor_u, drift_u_um_per_s=rate.u).drifted_u_um(age_s))
    off_um = abs(home_um - reference.home_um - drift.um)
    return None if off_um > HOME_CREEP_UM + half_width(drift.left_u_um) else drift


def _drifting_s(
    run: JobRun,
    reference: Reference,
    home_um: float,
    age_s: float,
    since_um: float,
    drift_u_um_per_s: float,
) -> float:
    """For how long the displacement may have drifted at its rate since the reference, s.

    What the homes of then and now differ by bounds the drift between them, creep in either apart. A rate that the
    rests of some minutes have shown, creep for the most part, is not to be taken for that of hours. `since_um` is
    what may have drifted since `home_um` was seen.
    """
    moved_um = abs(home_um - reference.home_um)
    if not drift_u_um_per_s or not math.isfinite(moved_um + since_um):
        return age_s
    believed_um = displacement_uncertainty(run.job).drift_u_um_per_s * age_s
    between_um = max(believed_um, share_u(moved_um + HOME_CREEP_UM))
    return min(age_s, math.hypot(between_um, since_um) / drift_u_um_per_s)


def _mean(a: Reading, b: Reading) -> Reading:
    """Two readings of one place as one: the mean, and the scatter within them."""
    dof = a.touches + b.touches - 2
    squares = (a.touches - 1) * a.sd_um**2 + (b.touches - 1) * b.sd_um**2
    sd_um = math.sqrt(squares / dof) if dof else 0.0
    return Reading(0.5 * (a.mean_um + b.mean_um), sd_um, a.touches + b.touches)
