"""Which cuts a job will be made of, and which of them are measured: as the job decides, without its surprises.

The same arithmetic of uncertainty decides as during the job (`edmctl.process.next_cut`), here with wear and removal
exactly as the recipe expects them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.actuator.correction import GAIN_SD_BETWEEN_DAYS, ZERO_DRIFT_UM_PER_S
from edmctl.forecasts.removal import SIDE_DISCHARGE_SHARE, feed_rate_um_s
from edmctl.process.discharge import first_gap_u_um, hole_area_um2
from edmctl.process.live_erosion import Energy, ErosionEstimate
from edmctl.process.next_cut import (
    COVERAGE,
    GAP_U_UM,
    is_done,
    largest_first_um,
    next_cut,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.forecasts.removal import Hole
    from edmctl.profile.model import Profile
    from edmctl.profile.setup import Setup

READING_U_UM = 0.15
"""Standard uncertainty of one reading of a surface."""
SET_U_UM = 0.10
"""Of the difference of two readings taken one after the other, by their scatter."""
FACE_U_UM = 0.20
"""Of the face at a place after a plane was fitted to three touches."""
FACE_LIMIT_UM = 2.0 * READING_U_UM
"""Of the face at a place where tilt would make it worse: it is touched there then, and a touch knows it better. At
0.3 mrad it takes a millimetre to get there."""
BETWEEN_S = 60.0
"""From touch to touch besides the machining."""


@dataclass(frozen=True, slots=True)
class Cut:
    """One cut: how far it feeds, whether a measuring stop follows, and how well the depth is known after it.

    `depth_u95_um` is half the 95 % interval; NaN where no depth is wanted.
    """

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


def planned_cuts(
    profile: Profile, setup: Setup, holes: Sequence[Hole], away_um: Sequence[float], *, plane: bool
) -> list[list[Cut]]:
    """The cuts of every hole, in working order, each `away_um` from the reference pad.

    `plane` says whether the face is touched at three places before.
    """
    plan = _Plan(profile, setup, plane=plane)
    last, is_single = len(holes) - 1, len(holes) == 1
    pairs = zip(holes, away_um, strict=True)
    return [
        plan.hole(one, way_um, is_last=i == last, is_single=is_single)
        for i, (one, way_um) in enumerate(pairs)
    ]


def channel_depth_u95_um(setup: Setup, depth_um: float) -> float:
    """Half the 95 % interval of a channel's mean depth, whose face is touched along its way."""
    known = displacement(setup)
    return COVERAGE * math.hypot(SET_U_UM, FACE_U_UM, known.gain_u_rel * depth_um, known.linearity_u_um)


@dataclass(frozen=True, slots=True)
class Displacement:
    """Standard uncertainties of a displacement: of its scale, of any one length besides, of its drift."""

    gain_u_rel: float
    linearity_u_um: float
    drift_u_um_per_s: float


def displacement(setup: Setup) -> Displacement:
    """What the setup says of its sensor; without one, what a calibration of another day keeps of it at best."""
    sensor = setup.sensor
    if sensor.fitted:
        return Displacement(sensor.gain_u_rel, sensor.linearity_u_um, sensor.drift_um_per_s)
    return Displacement(
        math.hypot(sensor.gain_u_rel, GAIN_SD_BETWEEN_DAYS),
        sensor.linearity_u_um,
        max(sensor.drift_um_per_s, ZERO_DRIFT_UM_PER_S),
    )


class _Plan:
    """What is known while the holes are made one after the other."""

    def __init__(self, profile: Profile, setup: Setup, *, plane: bool) -> None:
        work, wear, tool = profile.work, profile.wear, profile.tool
        self._profile = profile
        self._setup = setup
        self._displacement = displacement(setup)
        self._plane = plane
        self._area_um2 = hole_area_um2(tool.diameter_um, work.side_gap_um)
        self._estimate = ErosionEstimate(
            removal_um3_per_uj=work.removal_um3_per_uj * (1.0 - SIDE_DISCHARGE_SHARE),
            removal_u_rel=work.removal_u_rel,
            wear_ratio=wear.expected_ratio,
            ratio_u_rel=wear.ratio_u_rel,
            hole_area_um2=self._area_um2,
        )
        self._wear_u_um = 0.0
        self._since_s = BETWEEN_S

    def hole(self, one: Hole, away_um: float, *, is_last: bool, is_single: bool) -> list[Cut]:
        """The cuts of the next hole."""
        target, wear = self._profile.target, self._profile.wear
        if target.kind != "depth":
            return [Cut(one.feed_um, measured=True)]
        if cut_budget(self._profile) == 1:
            found_u_um, _ = self._found_u_um(one.depth_um, self._face_u_um(away_um))
            return [Cut(one.feed_um, measured=True, depth_u95_um=COVERAGE * found_u_um)]
        counted = wear.remeasure not in ("auto", "sparing")
        touches_final = counted or (is_single and wear.remeasure == "auto")
        fresh = self._estimate.fits == 0
        before = self._estimate if fresh else self._estimate.next_hole()
        estimate, face_u_um = before, self._face_u_um(away_um)
        cut_s = one.depth_um * (1.0 + estimate.wear_ratio) / feed_rate_um_s(self._profile, one.depth_um)
        known = self._displacement
        sensed_u_um = math.hypot(known.linearity_u_um, known.gain_u_rel * one.depth_um)
        drift_um = self._drift_um(cut_s)
        start_u_um = math.hypot(READING_U_UM, self._wear_u_um, drift_um, face_u_um, sensed_u_um)
        gap_u_um = first_gap_u_um(self._profile.pulse.open_voltage_v) if fresh else GAP_U_UM
        cut = next_cut(
            estimate,
            target_um=one.depth_um,
            remaining_um=one.depth_um,
            tolerance_um=target.tolerance_um,
            start_u_um=start_u_um,
            gap_u_um=gap_u_um,
            largest_um=largest_first_um(one.depth_um, wear.first_fraction, estimate),
            begun=False,
        )
        cuts: list[Cut] = []
        depth_um = 0.0
        while True:
            measured = cut.measured or touches_final or (is_last and not cuts)
            depth_u_um, worn_u_um = self._found_u_um(depth_um + cut.depth_um, face_u_um)
            # A later touch of the pad corrects what was not measured, by its own uncertainty.
            settled_u_um = math.hypot(start_u_um, gap_u_um, READING_U_UM) if cuts else 0.0
            known_u_um = depth_u_um if measured else max(cut.depth_u_um, settled_u_um)
            cuts.append(Cut(cut.feed_um, measured, COVERAGE * known_u_um))
            self._since_s += cut.feed_um / feed_rate_um_s(self._profile, one.depth_um)
            if not measured:
                split = estimate.split(
                    cut.feed_um, math.hypot(start_u_um, gap_u_um), self._energy(estimate, cut.depth_um)
                )
                self._wear_u_um += split.wear_u_um
                return cuts
            depth_um += cut.depth_um
            estimate = before.fitted(
                self._energy(before, depth_um), depth_um, depth_u_um, before.wear_ratio * depth_um, worn_u_um
            )
            self._estimate, self._wear_u_um, self._since_s = estimate, 0.0, BETWEEN_S
            remaining_um = one.depth_um - depth_um
            if len(cuts) >= cut_budget(self._profile) or is_done(remaining_um, target.tolerance_um, SET_U_UM):
                return cuts
            start_u_um, gap_u_um = depth_u_um, GAP_U_UM
            cut = next_cut(
                estimate,
                target_um=one.depth_um,
                remaining_um=remaining_um,
                tolerance_um=target.tolerance_um,
                start_u_um=start_u_um,
                begun=True,
            )

    def _energy(self, estimate: ErosionEstimate, depth_um: float) -> Energy:
        """Energy of the discharges that make a hole so deep, as far as is known."""
        return Energy(depth_um * self._area_um2 / estimate.removal_um3_per_uj, 0.0)

    def _face_u_um(self, away_um: float) -> float:
        """Standard uncertainty of the face's height over the pad's."""
        tilted_um = 1e-3 * self._setup.surface.tilt_u_mrad * away_um
        return FACE_U_UM if self._plane else min(tilted_um, FACE_LIMIT_UM)

    def _drift_um(self, more_s: float = 0.0) -> float:
        """Drift since the last touch of the pad, now or `more_s` later."""
        return self._displacement.drift_u_um_per_s * (self._since_s + more_s)

    def _found_u_um(self, depth_um: float, face_u_um: float) -> tuple[float, float]:
        """Standard uncertainties of a measured depth, and of the wear that goes with it."""
        known = self._displacement
        wear_um = self._profile.wear.expected_ratio * depth_um
        between_um = known.drift_u_um_per_s * BETWEEN_S
        depth_u_um = math.hypot(
            SET_U_UM, known.gain_u_rel * depth_um, known.linearity_u_um, face_u_um, between_um
        )
        wear_u_um = math.hypot(SET_U_UM, known.gain_u_rel * wear_um, known.linearity_u_um, self._drift_um())
        return depth_u_um, wear_u_um
