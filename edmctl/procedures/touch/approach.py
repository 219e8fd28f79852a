"""The approach to the spark gap from above, and the bottom of a hole, touched and compared with the expected one.

A bottom at or above the last sparks is impossible, and one that is shorter than the working gap allows has debris on
it. The tool is lifted so that oil washes it away, and touches again. A doubt that remains widens the interval.
"""

from __future__ import annotations

import math

from edmctl.actuator.inverse import ramp_by
from edmctl.dataclasses import replace
from edmctl.machine.interface import MachineEvent
from edmctl.planning.removal import approach_speed_um_s
from edmctl.procedures.run import JobRun, rest_and_look
from edmctl.procedures.settings import first_sparks_v
from edmctl.procedures.stages import move_to, retract
from edmctl.procedures.touch.reading import SurfaceReading, take_reading
from edmctl.process.touches import TOUCH_CHECK_SD_UM, against_sparks, between, is_long, is_short
from edmctl.profile.places import Place
from edmctl.quantity import half_width
from edmctl.record.rows import RejectedTouch, RunEvent
from edmctl.results.measurements import SurfaceFound
from edmctl.results.progress import Phase

ABOVE_BOTTOM_UM = 15.0  # a later cut is approached fast to this far above the highest possible bottom
UNKNOWN_SDS = 4.0  # range of a surface in standard uncertainties of its height: exceeded in 1 of 16 000 ramps
BEYOND_BOTTOM_UM = 15.0  # no spark this far beyond the last bottom is a fault
SURFACE_U_UM = 3.5  # standard uncertainty of the gap at 0 V before it is touched
_STEEPEST = 1.35  # steepest local slope of the actuator over its mean gain, with a margin: no step overshoots
_SHORT_SHARE = 0.03  # steps by the actuator model end short by three times its error, so that none overshoots
_NEAR_UM = 3.0
_SHORT_UM = 1.5  # and by this at least: after a long ramp the actuator creeps by a micrometre
_STEPS = 20
_SETTLE_S = 0.2
CLEAR_OF_BOTTOM_UM = 60.0  # the tool rises by this before a touch: clear of 20 µm for the contact check
MORE_LOOKS = 2  # further touches of a doubted bottom
WASHING_STROKES = 3  # strokes of the tool before each of them, so that oil removes loose debris


def approach_bottom(run: JobRun, bottom_um: float, bottom_u_um: float) -> MachineEvent:
    """Feed from 0 V to the first sparks at a bottom, from above its highest place to below its lowest."""
    run.begin(Phase.APPROACHING)
    unknown_um = UNKNOWN_SDS * bottom_u_um
    lower_to(run, bottom_um - ABOVE_BOTTOM_UM - unknown_um)
    return _approach(run, bottom_um - run.watch.displacement_um + BEYOND_BOTTOM_UM + unknown_um)


def find_gap(run: JobRun, place: Place) -> SurfaceFound:
    """Go to a place and feed at the approach speed until sparks flow; the tool is held there."""
    move_to(run, place)
    begin_s = run.machine.time_s
    event = _approach(run, run.profile.approach.max_travel_um)
    return SurfaceFound(
        kind="spark gap",
        x_um=place.x_um,
        y_um=place.y_um,
        displacement_um=event.displacement_um,
        model_um=run.watch.model_at(event.time_s),
        actuator_v=event.actuator_v,
        travel_s=event.time_s - begin_s,
    )


def find_contact(run: JobRun, place: Place) -> SurfaceFound:
    """Go to a place and touch its surface, which is expected at `approach.offset_um` from home."""
    move_to(run, place)
    begin_s = run.machine.time_s
    expected_um = run.tally.home_um + run.profile.approach.offset_um
    found = take_reading(run, "Zr", place.name, expected_um, SURFACE_U_UM)
    return SurfaceFound(
        kind="contact",
        x_um=place.x_um,
        y_um=place.y_um,
        displacement_um=found.z_um,
        model_um=found.model_um,
        actuator_v=found.actuator_v,
        travel_s=found.time_s - begin_s,
        touches=found.reading.touches,
        sd_um=found.reading.sd_um,
    )


def lower_to(run: JobRun, target_um: float) -> None:
    """Ramp towards a displacement, until just above it, in steps that do not overshoot."""
    for _ in range(_STEPS):
        rest_and_look(run, _SETTLE_S)
        left_um = target_um - run.watch.displacement_um
        if left_um <= _NEAR_UM:
            return
        _ramp_by(run, left_um - max(_SHORT_UM, _SHORT_SHARE * left_um), left_um / _STEEPEST)


def raise_by(run: JobRun, distance_um: float) -> None:
    """Ramp up by `distance_um`; without an actuator model by less, as it moves less per volt on the way back."""
    _ramp_by(run, -distance_um, -distance_um)


def _ramp_by(run: JobRun, modelled_um: float, linear_um: float) -> None:
    """Ramp by the actuator model's exact inverse, or by the mean gain beyond or without it."""
    actuator, estimator = run.setup.actuator, run.watch.estimator()
    slew_v_s = actuator.conditioning_slew_v_s
    target_v = math.inf if estimator is None else ramp_by(estimator, modelled_um, slew_v_s)
    if estimator is None or target_v >= estimator.model.high_v:
        target_v = run.watch.actuator_v + linear_um / actuator.gain_um_per_v
    run.machine.ramp(min(max(target_v, 0.0), run.profile.limits.stroke_v_max), slew_v_s)


def _approach(run: JobRun, max_travel_um: float) -> MachineEvent:
    run.begin(Phase.APPROACHING)
    speed_um_s = approach_speed_um_s(run.profile)
    event = run.machine.approach(speed_um_s, max_travel_um, first_sparks_v(run.profile))
    run.decide(
        RunEvent.APPROACHED,
        f"Spark gap found at {event.displacement_um:.1f} µm, {event.actuator_v:.1f} V.",
        {"displacement_um": event.displacement_um, "actuator_v": event.actuator_v},
    )
    return event


def read_expected(
    run: JobRun, place: str, above_um: float, way_um: float, u_um: float, source: str
) -> SurfaceReading:
    """Touch a bottom below the tool, again if it is not where expected; a doubt that remains widens the reading.

    It is expected `way_um` below its highest place `above_um`, with a standard uncertainty of `u_um`, by `source`.
    """
    z2 = take_reading(run, "Z2", place, above_um + way_um, u_um)

    def report_doubt(what_now: str) -> None:
        side, chip = ("short of", " (a chip?)") if off.um < 0.0 else ("beyond", "")
        run.warn(
            RunEvent.TOUCH_DOUBTED,
            f"Z2 = {z2.z_um:.2f} µm is {abs(off.um):.2f} ± {half_width(off.u_um):.2f} µm {side} where {source} put "
            f"the bottom{chip}. {what_now}",
            {"kind": "Z2", "off_um": off.um, "u_um": off.u_um, "z_um": z2.z_um},
        )

    for look in range(MORE_LOOKS + 1):
        off = against_sparks(z2.z_um, above_um, way_um, u_um)
        if not is_short(off, way_um) and (look > 0 or not is_long(off)):
            return z2
        if look == MORE_LOOKS:
            break
        report_doubt("It is touched again.")
        wash(run, above_um)
        again = take_reading(run, "Z2", place, above_um + way_um, u_um)
        # Debris never makes a reading longer; of two within their noise the newer one counts.
        used, other = (z2, again) if z2.z_um > again.z_um + TOUCH_CHECK_SD_UM else (again, z2)
        run.recorder.append(RejectedTouch(other.time_s))
        z2 = used
    middle_um, doubt_u_um = between(z2.z_um, above_um, way_um, u_um)
    report_doubt(f"It is taken to be at {middle_um:.2f} ± {half_width(doubt_u_um):.2f} µm.")
    return replace(z2.shifted(middle_um - z2.z_um), doubt_u_um=doubt_u_um)


def wash(run: JobRun, bottom_um: float) -> None:
    """Draw the tool out of the hole and back above the bottom, repeatedly."""
    for _ in range(WASHING_STROKES):
        retract(run)
        lower_to(run, bottom_um - CLEAR_OF_BOTTOM_UM)
