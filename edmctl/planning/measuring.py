"""The cuts of a job with their measurement cycles, and the time of everything but machining.

The cuts follow from the rules of a job (`edmctl.process.next_cut`), with wear and removal as the recipe expects
them. The times are those of conditioning, approaches, touches and stage moves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.actuator.correction import GAIN_SD_BETWEEN_DAYS, ZERO_DRIFT_UM_PER_S
from edmctl.dataclasses import dataclass
from edmctl.planning.removal import (
    SIDE_DISCHARGE_SHARE,
    Hole,
    approach_speed_um_s,
    feed_rate_um_s,
    jump_duration_s,
)
from edmctl.process.erosion import first_gap_u_um, hole_area_um2
from edmctl.process.live_erosion import Energy, ErosionEstimate
from edmctl.process.next_cut import GAP_U_UM, is_done, largest_first_um, next_cut
from edmctl.process.touches import TOUCH_U_UM, Displacement
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.profile.setup import Setup
from edmctl.quantity import half_width

SET_U_UM = math.sqrt(2.0) * TOUCH_U_UM
"""Of the difference of two readings taken one after the other, by their scatter."""
FACE_U_UM = 0.10  # of the face at a place after a plane was fitted to three touches
FACE_LIMIT_UM = 0.3
"""Of the face at a place; where tilt makes it worse, a millimetre away at 0.3 mrad, the face is touched there."""
BETWEEN_S = 60.0  # from touch to touch besides the machining
STARTING_S = 1.6  # arming, the test of the gap sensor and a rest before the first stroke
MOVING_S = 0.7  # a stage move besides its way: ramp to 0 V, rest, and play of the drive
RELUCTANCE = 1.45
"""From 0 V the actuator follows its command with less than its mean gain: an approach at 1 µm/s over 45 µm took
65 s (hysteresis of the piezo, Muralidhara et al. 2009, Fig. 3a)."""
RELUCTANCE_TOUCHING = 1.25  # the same on average over a fast leg and the slow one after it
RISE_UM = 60.0  # before a bottom is touched the tool rises by this
FAST_LEG_MARGIN_UM = 3.0  # the fast leg of a touch ends this far above the predicted contact
OFFSET_U_UM, WEAR_U_SHARE = 7.0, 0.05
"""The slow leg begins earlier by what is unknown: of the first surface, and of the wear as a share of the feed."""
RIM_WEAR_SHARE = 0.3
"""Behind a sheet the tool hardly wears, so the pad is met earlier than expected by this share of the feed there."""
FURTHER_SPOT_S = 6.5
"""Pad and face are touched at a second spot: a move, the way down, and one touch, one less at the first spot."""
SAMPLING_S = 0.4  # at the end of a reading, for the last samples
FAST_DESCENT_S = 2.0
LAST_UM = 15.0  # down to a known surface in fast steps, and the last µm at the speed of the approach
CREEP_STROKE_UM = 430.0
"""After a long fast descent the actuator creeps on by itself and shortens the slow one, down to a third."""


@dataclass(frozen=True, slots=True)
class Cut:
    """One cut: its feed, whether a measurement cycle follows, and half the 95 % interval of the depth then."""

    feed_um: float
    measured: bool
    depth_u95_um: float = math.nan


def cut_budget(profile: Profile) -> int:
    """How many cuts a hole may take: one without a depth target or without remeasuring."""
    wear = profile.wear
    if profile.target.kind != "depth" or wear.remeasure == "never":
        return 1
    if isinstance(wear.remeasure, int):
        return min(wear.remeasure + 1, wear.max_cuts)
    return wear.max_cuts


def estimate_of(profile: Profile) -> ErosionEstimate:
    """Return what the recipe knows before anything was machined."""
    work, wear = profile.work, profile.wear
    return ErosionEstimate(
        removal_um3_per_uj=work.removal_um3_per_uj * (1.0 - SIDE_DISCHARGE_SHARE),
        removal_u_rel=work.removal_u_rel,
        wear_ratio=wear.expected_ratio,
        ratio_u_rel=wear.ratio_u_rel,
        hole_area_um2=hole_area_um2(profile.tool.diameter_um, work.side_gap_um),
    )


def planned_cuts(
    profile: Profile, setup: Setup, holes: Sequence[Hole], away_um: Sequence[float], *, plane: bool
) -> list[list[Cut]]:
    """The cuts of every hole in working order, `away_um` from the pad; `plane`: the face is touched at three
    places.
    """
    plan = _Plan(profile, setup)
    tilt = 1e-3 * setup.surface.tilt_u_mrad
    return [
        plan.hole(
            one,
            FACE_U_UM if plane else min(tilt * way_um, FACE_LIMIT_UM),
            is_last=one is holes[-1],
            is_single=len(holes) == 1,
        )
        for one, way_um in zip(holes, away_um, strict=True)
    ]


def channel_depth_u95_um(setup: Setup, depth_um: float) -> float:
    """Half the 95 % interval of a channel's mean depth, whose face is touched along its way."""
    known = displacement(setup)
    return half_width(math.hypot(SET_U_UM, FACE_U_UM, known.length_u_um(depth_um)))


def displacement(setup: Setup) -> Displacement:
    """Return the uncertainties of the sensor; without one, those of a calibration of another day at best."""
    sensor = setup.sensor
    gain_u_rel, drift_um_per_s = sensor.gain_u_rel, sensor.drift_um_per_s
    if sensor.fitted:
        walk = setup.drift.walk_um_per_sqrt_s
        return Displacement(gain_u_rel, sensor.linearity_u_um, drift_um_per_s, walk)
    gain_u_rel = math.hypot(gain_u_rel, GAIN_SD_BETWEEN_DAYS)
    return Displacement(gain_u_rel, sensor.linearity_u_um, max(drift_um_per_s, ZERO_DRIFT_UM_PER_S))


class _Plan:
    """State of the plan while holes follow one another: the estimate, and since when the pad was not touched."""

    def __init__(self, profile: Profile, setup: Setup) -> None:
        self._profile = profile
        self._displacement = displacement(setup)
        self._area_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
        self._estimate = estimate_of(profile)
        self._wear_u_um = 0.0
        self._since_s = BETWEEN_S

    def hole(self, one: Hole, face_u_um: float, *, is_last: bool, is_single: bool) -> list[Cut]:
        """The cuts of the next hole; `face_u_um` is the standard uncertainty of the face's height over the pad's."""
        target, wear = self._profile.target, self._profile.wear
        if target.kind != "depth":
            return [Cut(one.feed_um, measured=True)]
        if cut_budget(self._profile) == 1:
            measured_u_um, _ = self._measured_u_um(one.depth_um, face_u_um)
            return [Cut(one.feed_um, measured=True, depth_u95_um=half_width(measured_u_um))]
        counted = wear.remeasure not in ("auto", "sparing")
        touches_final = counted or (is_single and wear.remeasure == "auto")
        fresh = self._estimate.fits == 0
        estimate = before = self._estimate if fresh else self._estimate.next_hole(one.depth_um)
        rate_um_s = feed_rate_um_s(self._profile, one.depth_um)
        drift_um = self._drift_um(one.depth_um * (1.0 + estimate.wear_ratio) / rate_um_s)
        sensed_u_um = self._displacement.length_u_um(one.depth_um)
        start_u_um = math.hypot(TOUCH_U_UM, self._wear_u_um, drift_um, face_u_um, sensed_u_um)
        gap_u_um = first_gap_u_um(self._profile.pulse.open_voltage_v) if fresh else GAP_U_UM
        largest_um = largest_first_um(one.depth_um, wear.first_fraction, estimate)
        cuts, depth_um = list[Cut](), 0.0
        while True:
            cut = next_cut(
                estimate,
                target_um=one.depth_um,
                remaining_um=one.depth_um - depth_um,
                tolerance_um=target.tolerance_um,
                start_u_um=start_u_um,
                gap_u_um=gap_u_um,
                largest_um=math.inf if cuts else largest_um,
                begun=bool(cuts),
            )
            measured = cut.measured or touches_final or (is_last and not cuts)
            depth_u_um, worn_u_um = self._measured_u_um(depth_um + cut.depth_um, face_u_um)
            # A later touch of the pad corrects what was not measured, by its own uncertainty.
            corrected_u_um = math.hypot(start_u_um, gap_u_um, TOUCH_U_UM) if cuts else 0.0
            known_u_um = depth_u_um if measured else max(cut.depth_u_um, corrected_u_um)
            cuts.append(Cut(cut.feed_um, measured, half_width(known_u_um)))
            self._since_s += cut.feed_um / rate_um_s
            if not measured:
                energy = self._energy(estimate, cut.depth_um)
                split = estimate.split(cut.feed_um, math.hypot(start_u_um, gap_u_um), energy)
                self._wear_u_um += split.wear_u_um
                return cuts
            depth_um += cut.depth_um
            energy, wear_um = self._energy(before, depth_um), before.wear_ratio * depth_um
            estimate = before.fitted(energy, depth_um, depth_u_um, wear_um, worn_u_um)
            self._estimate, self._wear_u_um, self._since_s = estimate, 0.0, BETWEEN_S
            is_last_cut = len(cuts) >= cut_budget(self._profile)
            if is_last_cut or is_done(one.depth_um - depth_um, target.tolerance_um, SET_U_UM):
                return cuts
            start_u_um, gap_u_um = depth_u_um, GAP_U_UM

    def _energy(self, estimate: ErosionEstimate, depth_um: float) -> Energy:
        return Energy(depth_um * self._area_um2 / estimate.removal_um3_per_uj, 0.0)

    def _drift_um(self, more_s: float = 0.0) -> float:
        """Drift since the last touch of the pad, now or `more_s` later."""
        return self._displacement.drift_u_um_per_s * (self._since_s + more_s)

    def _measured_u_um(self, depth_um: float, face_u_um: float) -> tuple[float, float]:
        """Return the standard uncertainties of a measured depth and its wear."""
        known = self._displacement
        wear_um = self._profile.wear.expected_ratio * depth_um
        between_um = known.drift_u_um_per_s * BETWEEN_S
        depth_u_um = math.hypot(SET_U_UM, known.length_u_um(depth_um), face_u_um, between_um)
        wear_u_um = math.hypot(SET_U_UM, known.length_u_um(wear_um), self._drift_um())
        return depth_u_um, wear_u_um


def conditioning_time_s(profile: Profile, setup: Setup) -> float:
    """From arming to a conditioned actuator at the parking place, s."""
    actuator = setup.actuator
    strokes_s = 2.0 * profile.limits.stroke_v_max / actuator.conditioning_slew_v_s
    return STARTING_S + actuator.conditioning_cycles * strokes_s


def approach_time_s(profile: Profile, setup: Setup) -> float:
    """From an idle machine to the spark gap beside the reference pad: conditioning, the move, the approach, s."""
    move_s = move_time_s(park_to_pad_um(setup) + profile.measure.site_dx_um, setup)
    way_um = max(0.0, profile.approach.offset_um - profile.measure.expected_gap_um)
    surface_s = RELUCTANCE * way_um / approach_speed_um_s(profile)
    return conditioning_time_s(profile, setup) + move_s + surface_s


def touch_time_s(profile: Profile, setup: Setup) -> float:
    """From an idle machine to a reading of the reference pad: conditioning, the move, all its touches, s."""
    move_s = move_time_s(park_to_pad_um(setup), setup)
    return conditioning_time_s(profile, setup) + move_s + pad_time_s(profile)


def jumps_time_s(profile: Profile, count: int, period_s: float) -> float:
    """Electrode jumps that begin every `period_s`, or one after the other where they take longer, s."""
    return count * max(period_s, jump_duration_s(profile))


def pad_time_s(profile: Profile) -> float:
    """One reading of the untouched pad from home: all its touches, s."""
    first_s = reading_time_s(profile, profile.approach.offset_um, OFFSET_U_UM, RELUCTANCE_TOUCHING)
    return first_s + further_spot_s(profile)


def face_time_s(profile: Profile, way_um: float) -> float:
    """One reading of the face at a place, expected `way_um` below the tool, s."""
    return reading_time_s(profile, way_um) + further_spot_s(profile)


def further_spot_s(profile: Profile) -> float:
    """How much longer a reading takes because pad or face are touched at two spots, s."""
    return FURTHER_SPOT_S - (again_s(profile) if profile.measure.touches > 1 else 0.0)


def again_s(profile: Profile) -> float:
    """One more touch at the same place, s."""
    return profile.measure.back_off_um / profile.measure.speed_um_s + profile.measure.dwell_s


def reading_time_s(
    profile: Profile, way_um: float, unknown_um: float = 0.0, reluctance: float = 1.0
) -> float:
    """One reading of a surface expected `way_um` below the tool, known within `unknown_um`, s."""
    measure = profile.measure
    slow_um = min(FAST_LEG_MARGIN_UM + unknown_um, way_um)
    down_s = slow_um / measure.speed_um_s + (way_um - slow_um) / measure.fast_um_s
    rest_s = measure.settle_s + measure.dwell_s + SAMPLING_S
    return rest_s + reluctance * down_s + (measure.touches - 1) * again_s(profile)


def descent_time_s(profile: Profile, place_um: float) -> float:
    """From home to the spark gap over a surface or bottom that is known to be `place_um` below, s."""
    slow_um = LAST_UM * max(1.0 - place_um / CREEP_STROKE_UM, 1.0 / 3.0)
    return FAST_DESCENT_S + slow_um / approach_speed_um_s(profile)


def stop_time_s(
    profile: Profile,
    feed_um: float,
    wear_um: float,
    pad_s: float,
    *,
    bottom: bool = True,
    rim_um: float = 0.0,
) -> float:
    """One measurement cycle, s: bottom, if any, the way to the pad, and pad; wear over the last `rim_um` is
    unknown.
    """
    bottom_s = 0.5 + reading_time_s(profile, RISE_UM) if bottom else 0.0
    early_um = RIM_WEAR_SHARE * rim_um
    way_um = profile.approach.offset_um + wear_um - early_um
    unknown_um = math.hypot(WEAR_U_SHARE * feed_um, 2.0 * rim_um / math.sqrt(12.0)) - early_um
    pad_reading_s = reading_time_s(profile, way_um, unknown_um, RELUCTANCE_TOUCHING)
    return bottom_s + pad_s + pad_reading_s + further_spot_s(profile)


def pad_of(setup: Setup) -> Place:
    """The reference pad."""
    return Place("reference pad", setup.stage.reference_x_um, setup.stage.reference_y_um)


def park_to_pad_um(setup: Setup) -> float:
    """Way of the stages from the parking place to the reference pad, µm."""
    stage = setup.stage
    return abs(stage.reference_x_um - stage.park_x_um) + abs(stage.reference_y_um - stage.park_y_um)


def beside_pad_um(profile: Profile, setup: Setup) -> tuple[float, float]:
    """Place of the single hole of a job without `[[sites]]`, stage coordinates in µm."""
    return setup.stage.reference_x_um + profile.measure.site_dx_um, setup.stage.reference_y_um


def between_s(start: Place, end: Place, setup: Setup) -> float:
    """One move of the stages from place to place, axis after axis, s."""
    way_um = abs(end.x_um - start.x_um) + abs(end.y_um - start.y_um)
    return move_time_s(way_um, setup) + abs(end.theta_deg - start.theta_deg) / setup.stage.rotary_deg_s


def move_time_s(way_um: float, setup: Setup) -> float:
    """One move of the stages over a way, retraction and all, s."""
    return MOVING_S + way_um / setup.stage.speed_um_s
