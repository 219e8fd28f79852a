"""Plan of a cut to a limit of the displacement."""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass, replace
from edmctl.planning.measuring import cut_budget, estimate_of
from edmctl.planning.removal import feed_rate_um_s
from edmctl.procedures.job import Discharges, HoleTarget, target_of
from edmctl.process.live_erosion import RECIPE_U_REL, Energy, ErosionEstimate, LiveErosion
from edmctl.process.next_cut import CLEAR_SIGMAS, largest_first_um, next_cut
from edmctl.profile.model import Profile, Pulse
from edmctl.quantity import Value

ARC_SHARE_OF_DISCHARGE_VOLTAGE = 0.77  # an arc burns at 17 V where a normal discharge burns at 22 V


@dataclass(frozen=True, slots=True)
class CutStart:
    """State at the start of a cut; `*_u_um` are standard uncertainties.

    The tool would touch the bottom at `bottom_um`, as measured at `time_s` and drifting since. `depth_um` and
    `wear_um` are those of the hole so far; `depth_u_um` excludes the bottom. `gap_um` is the expected working gap.
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
    """One cut of `feed_um` from `start`.

    `target_um` is the target depth of the hole (NaN for a feed), `measured` whether a measurement cycle follows,
    `depth_u_um` the standard uncertainty of the depth at its end.
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
        """Displacement at which the cut ends: a working gap above the bottom that it leaves."""
        return self.start.bottom_um + self.feed_um - self.start.gap_um

    def fed_um(self, displacement_um: float) -> float:
        """Return the feed of this cut while sparking at a displacement."""
        return max(0.0, displacement_um + self.start.gap_um - self.start.bottom_um)

    def at(self, displacement_um: float, energy: Energy | None = None, now_s: float = 0.0) -> LiveErosion:
        """Return depth and wear of the hole while sparking at a displacement, after discharges of that energy.

        `wear_u_um` is of this cut alone; see `stated` for that of the hole.
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
        """Return whether the estimate cannot explain that energy for the feed."""
        return self.estimate.contradicts(self.fed_um(displacement_um), self.start.gap_u_um, energy)

    def off_by_energy_um(self, displacement_um: float, energy: Energy) -> float:
        """Return the wear of this cut by feed and energy less that by the ratio; 0 if within chance."""
        return self.estimate.off_by_energy_um(self.fed_um(displacement_um), self.start.gap_u_um, energy)

    def stated(self, live: LiveErosion) -> tuple[Value, Value]:
        """Return depth and wear as displayed in a cut; until a touch confirms the recipe's ratio, with its error."""
        unconfirmed_um = 0.0
        if self.estimate.fits == 0:
            worn_um = live.wear_um - self.start.wear_um
            unconfirmed_um = RECIPE_U_REL * worn_um / (1.0 + self.wear_ratio)
        return (
            Value(live.depth_um, math.hypot(live.depth_u_um, unconfirmed_um)),
            Value(live.wear_um, math.hypot(self.start.wear_u_um, live.wear_u_um, unconfirmed_um)),
        )

    def depth_at(self, displacement_um: float) -> float:
        """Return the depth while sparking at this displacement, by the expected gap and wear ratio."""
        return self.at(displacement_um).depth_um


def energy_of(pulse: Pulse, done: Discharges) -> Energy:
    """Divide the energy of discharges between normal ones and arcs.

    An arc burns from the start of its pulse through the generator's resistance, so its energy is known.
    """
    arc_uj = done.counts[2] * _full_pulse_uc(pulse, _arc_v(pulse)) * _arc_v(pulse)
    return Energy(max(0.0, 1e6 * done.energy_j - arc_uj), arc_uj)


def discharge_energy_j(pulse: Pulse, counts: tuple[int, int, int, int], charge_c: float) -> float:
    """Return the energy of the discharges among pulses (open, normal, arc, short) that passed a charge, in J.

    Charge times the plateau voltage of a normal discharge overestimates arcs, and shorts, which release none.
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
    """Plan the first cut of a hole at `now_s`: all of a feed or way through, and less than a target depth."""
    target = target or target_of(profile)
    estimate = estimate or estimate_of(profile)
    if target.kind == "feed":
        return CutPlan(1, target.feed_um, start, estimate)
    if target.kind == "through":
        return through_plan(1, start, target, estimate)
    if cut_budget(profile) == 1:
        return CutPlan(1, target.depth_um * (1.0 + estimate.wear_ratio), start, estimate, target.depth_um)
    largest_um = largest_first_um(target.depth_um, profile.wear.first_fraction, estimate)
    return _planned(profile, target, 1, start, estimate, now_s, largest_um)


def through_plan(number: int, start: CutStart, target: HoleTarget, estimate: ErosionEstimate) -> CutPlan:
    """Plan the rest of the way through a sheet, with room for a tool that wears more than the recipe expects."""
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
    """Plan the next cut from the bottom just measured; `touch_final` measures it however small."""
    planned = _planned(profile, target, number, start, estimate, start.time_s)
    return replace(planned, measured=True) if touch_final else planned


def _planned(
    profile: Profile,
    target: HoleTarget,
    number: int,
    start: CutStart,
    estimate: ErosionEstimate,
    begin_s: float,
    largest_um: float = math.inf,
) -> CutPlan:
    """Plan a cut that begins at `begin_s`; until its end the start drifts."""
    remaining_um = target.depth_um - start.depth_um
    cut_s = remaining_um * (1.0 + estimate.wear_ratio) / feed_rate_um_s(profile, target.depth_um)
    cut = next_cut(
        estimate,
        target_um=target.depth_um,
        remaining_um=remaining_um,
        tolerance_um=target.tolerance_um,
        start_u_um=start.u_at(begin_s + cut_s),
        gap_u_um=start.gap_u_um,
        largest_um=largest_um,
        begun=number > 1,
    )
    measured = cut.measured or profile.wear.remeasure not in ("auto", "sparing")
    return CutPlan(number, cut.feed_um, start, estimate, target.depth_um, measured, cut.depth_u_um)
