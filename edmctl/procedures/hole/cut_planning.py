"""Where a cut ends: from a depth wanted below a known bottom to a limit of the tool's displacement."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass, replace
from edmctl.planning.measuring import cut_budget, estimate_of
from edmctl.planning.removal import feed_rate_um_s
from edmctl.procedures.job import HoleTarget, target_of
from edmctl.process.live_erosion import RECIPE_U_REL, Energy, ErosionEstimate, LiveErosion
from edmctl.process.next_cut import CLEAR_SIGMAS, NextCut, largest_first_um, next_cut
from edmctl.quantity import Value

if TYPE_CHECKING:
    from edmctl.profile.model import Profile, Pulse


ARC_SHARE_OF_DISCHARGE_VOLTAGE = 0.77
"""An arc burns at 17 V where a normal discharge burns at 22 V."""


@dataclass(frozen=True, slots=True)
class CutStart:
    """What a cut starts from.

    The tool would touch the bottom at `bottom_um`, known within `bottom_u_um` at `time_s` and drifting within
    `drift_u_um_per_s` since. `depth_um` and `wear_um` are the hole's so far, the wear known within `wear_u_um`;
    `depth_u_um` is what else is unknown of the depth. `gap_um` is the working gap to expect, with the standard
    uncertainty `gap_u_um`.
    """

    bottom_um: float
    bottom_u_um: float
    gap_um: float
    gap_u_um: float
    time_s: float = 0.0
    drift_u_um_per_s: float = 0.0
    depth_um: float = 0.0
    depth_u_um: float = 0.0
    wear_um: float = 0.0
    wear_u_um: float = 0.0

    def bottom_u_at(self, now_s: float) -> float:
        """Return the standard uncertainty of where the tool would touch the bottom, at a moment."""
        return math.hypot(self.bottom_u_um, self.drift_u_um_per_s * max(0.0, now_s - self.time_s))

    def u_at(self, now_s: float) -> float:
        """Return the standard uncertainty of a depth counted from the bottom at a moment, without working gap."""
        return math.hypot(self.bottom_u_at(now_s), self.depth_u_um)


@dataclass(frozen=True, slots=True, eq=False)
class CutPlan:
    """One cut of `feed_um`, from what it starts from to `z_limit_um`.

    `wear_ratio` is the wear per depth that is expected, `target_um` the depth of the hole that is wanted (NaN for a
    feed), `measured` whether a measuring stop is to follow, `depth_u_um` what will be unknown of the depth then.
    """

    number: int
    feed_um: float
    start: CutStart
    estimate: ErosionEstimate
    target_um: float = math.nan
    measured: bool = True
    depth_u_um: float = math.nan

    @property
    def wear_ratio(self) -> float:
        """Wear per depth expected."""
        return self.estimate.wear_ratio

    @property
    def z_limit_um(self) -> float:
        """Displacement at which the cut ends: a working gap short of where the tool will touch afterwards."""
        return self.start.bottom_um + self.feed_um - self.start.gap_um

    def fed_um(self, displacement_um: float) -> float:
        """Feed of this cut while sparking at a displacement."""
        return max(0.0, displacement_um + self.start.gap_um - self.start.bottom_um)

    def at(self, displacement_um: float, energy: Energy | None = None, now_s: float = 0.0) -> LiveErosion:
        """Depth and wear of the hole while sparking at a displacement, after discharges of that energy.

        `wear_u_um` is what this cut adds; see `stated` for that of the hole.
        """
        split = self.estimate.split(self.fed_um(displacement_um), self.start.gap_u_um, energy)
        return LiveErosion(
            self.start.depth_um + split.depth_um,
            math.hypot(self.start.u_at(now_s), split.depth_u_um),
            self.start.wear_um + split.wear_um,
            split.wear_ratio_u_um,
            split.wear_own_u_um,
        )

    def contradicts(self, displacement_um: float, energy: Energy) -> bool:
        """Return whether by what is believed the feed cannot have taken that energy: then only a touch can tell."""
        return self.estimate.contradicts(self.fed_um(displacement_um), self.start.gap_u_um, energy)

    def off_by_energy_um(self, displacement_um: float, energy: Energy) -> float:
        """Wear of this cut by feed and energy less that by the ratio; 0 where chance may make them so different."""
        return self.estimate.off_by_energy_um(self.fed_um(displacement_um), self.start.gap_u_um, energy)

    def stated(self, live: LiveErosion) -> tuple[Value, Value]:
        """Return depth and wear as they are shown in a cut.

        How the feed of this cut divides is as unknown as any recipe's, until a touch has confirmed it.
        """
        unconfirmed_um = 0.0
        if self.estimate.fits == 0:
            worn_um = live.wear_um - self.start.wear_um
            unconfirmed_um = RECIPE_U_REL * worn_um / (1.0 + self.wear_ratio)
        return (
            Value(live.depth_um, math.hypot(live.depth_u_um, unconfirmed_um)),
            Value(live.wear_um, math.hypot(self.start.wear_u_um, live.wear_u_um, unconfirmed_um)),
        )

    def depth_at(self, displacement_um: float) -> float:
        """Estimated depth while sparking at this displacement, from the expected gap and wear ratio."""
        return self.at(displacement_um).depth_um


def energy_of(pulse: Pulse, counts: tuple[int, int, int, int] | list[int], energy_j: float) -> Energy:
    """Divide the energy of discharges between normal ones and arcs; `counts` are open, normal, arc and short pulses.

    An arc burns from the start of its pulse through the generator's resistance, so its energy is known.
    """
    arc_uj = counts[2] * _full_pulse_uc(pulse, _arc_v(pulse)) * _arc_v(pulse)
    return Energy(max(0.0, 1e6 * energy_j - arc_uj), arc_uj)


def discharge_energy_j(pulse: Pulse, counts: tuple[int, int, int, int], charge_c: float) -> float:
    """Return the energy of the discharges among pulses (open, normal, arc, short) that passed a charge, in J.

    Charge times the plateau voltage of a normal discharge counts arcs too high, and shorts, which burn nothing.
    """
    plateau_v, arc_v = pulse.discharge_voltage_v, _arc_v(pulse)
    excess_uj = counts[2] * _full_pulse_uc(pulse, arc_v) * (plateau_v - arc_v)
    excess_uj += counts[3] * _full_pulse_uc(pulse, 0.0) * plateau_v
    return plateau_v * charge_c - 1e-6 * excess_uj


def _arc_v(pulse: Pulse) -> float:
    return ARC_SHARE_OF_DISCHARGE_VOLTAGE * pulse.discharge_voltage_v


def _full_pulse_uc(pulse: Pulse, plateau_v: float) -> float:
    """Return the charge of a pulse that burns at this voltage from its start, µC."""
    siemens = pulse.current_a / max(pulse.open_voltage_v - pulse.discharge_voltage_v, 0.1)
    return siemens * (pulse.open_voltage_v - plateau_v) * pulse.burning_time_us


def first_plan(
    profile: Profile,
    start: CutStart,
    target: HoleTarget | None = None,
    estimate: ErosionEstimate | None = None,
    now_s: float = 0.0,
) -> CutPlan:
    """Plan the first cut of a hole at `now_s`: all of a feed or way through, of a depth what is surely short."""
    target = target or target_of(profile)
    estimate = estimate or estimate_of(profile)
    if target.kind == "feed":
        return CutPlan(1, target.feed_um, start, estimate)
    if target.kind == "through":
        return through_plan(1, start, target, estimate)
    if cut_budget(profile) == 1:
        return CutPlan(1, target.depth_um * (1.0 + estimate.wear_ratio), start, estimate, target.depth_um)
    cut = next_cut(
        estimate,
        target_um=target.depth_um,
        remaining_um=target.depth_um,
        tolerance_um=target.tolerance_um,
        start_u_um=start.u_at(now_s + _cut_s(profile, target, target.depth_um, estimate)),
        gap_u_um=start.gap_u_um,
        largest_um=largest_first_um(target.depth_um, profile.wear.first_fraction, estimate),
        begun=False,
    )
    return _planned(1, cut, start, estimate, target, profile)


def through_plan(number: int, start: CutStart, target: HoleTarget, estimate: ErosionEstimate) -> CutPlan:
    """Return all that is left of a way through the sheet.

    The breakthrough ends it: the limit leaves room for a tool that wears more than the recipe says.
    """
    worst = estimate.wear_ratio * (1.0 + (0.0 if estimate.fits else CLEAR_SIGMAS * RECIPE_U_REL))
    left_um = max(0.0, target.depth_um - start.depth_um) + target.tolerance_um
    return CutPlan(number, left_um * (1.0 + worst) + target.completion_um, start, estimate, target.depth_um)


def following_plan(
    profile: Profile,
    target: HoleTarget,
    number: int,
    start: CutStart,
    estimate: ErosionEstimate,
    *,
    touch_final: bool = False,
) -> CutPlan:
    """Return the next cut, from the bottom just touched, with the gap and the estimate just learned.

    `touch_final` says that it is measured however small.
    """
    remaining_um = target.depth_um - start.depth_um
    cut = next_cut(
        estimate,
        target_um=target.depth_um,
        remaining_um=remaining_um,
        tolerance_um=target.tolerance_um,
        start_u_um=start.u_at(start.time_s + _cut_s(profile, target, remaining_um, estimate)),
        gap_u_um=start.gap_u_um,
        begun=True,
    )
    planned = _planned(number, cut, start, estimate, target, profile)
    return replace(planned, measured=True) if touch_final else planned


def _cut_s(profile: Profile, target: HoleTarget, depth_um: float, estimate: ErosionEstimate) -> float:
    """Return how long a cut of that depth will take, for what drifts meanwhile."""
    return depth_um * (1.0 + estimate.wear_ratio) / feed_rate_um_s(profile, target.depth_um)


def _planned(
    number: int,
    cut: NextCut,
    start: CutStart,
    estimate: ErosionEstimate,
    target: HoleTarget,
    profile: Profile,
) -> CutPlan:
    measured = cut.measured or profile.wear.remeasure not in ("auto", "sparing")
    return CutPlan(number, cut.feed_um, start, estimate, target.depth_um, measured, cut.depth_u_um)


def learned_gap_um(bottom_um: float, end_displacement_um: float) -> float:
    """Return the working gap: how much further the tool goes to touch than it went to spark."""
    return bottom_um - end_displacement_um
