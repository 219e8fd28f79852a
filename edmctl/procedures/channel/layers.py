"""The layers of a channel: passes to and fro until the tool was held, and the updates by measurements."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from edmctl.planning.removal import SIDE_DISCHARGE_SHARE, removal_um3_s
from edmctl.procedures.channel.scan import PassPlan, PassResult, run_pass
from edmctl.procedures.channel.touching import ChannelSurface, FloorReading, learned_gap_um
from edmctl.procedures.job import CutTotals, RunningCut
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.limits import TimeLimits
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import approach_bottom
from edmctl.process.channel import HeldTool, ToolWear, Way, channel_width_um, passes_needed
from edmctl.process.discharge import hole_area_um2
from edmctl.process.touches import TOUCH_U_UM
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.record.rows import EventLevel, RunEvent

QUIET_SHARE = 0.65
"""A floor is even when this share of the pulses of a pass is open; the servo's own gap has 0.3."""
GAP_GROWTH = 1.25
"""Gap of an evened floor relative to that of the servo, until it is measured: a larger gap ignites half the
pulses."""
FLOOR_U_UM = 1.0  # standard uncertainty of the height of a floor after a pass: gap and unevenness [assumed]
SPARE_PASSES = 4  # a layer may take these and twice the passes that its volume needs
MOST_TO_EVEN = 8  # passes at one height to even out the floor before a measuring stop


class Layers:
    """The layers cut so far, the wear of the tool, and the gap that a held tool leaves.

    `since_uj` is the wearing energy since the last measurement, at `since_s`, `measured_u_um` the standard
    uncertainty of the wear measured then; `last` the newest pass. `aim_um` is the depth of the layer under way,
    `behind` says that it took more passes than it may. `keep` is called before every pass.
    """

    def __init__(
        self, run: JobRun, limits: TimeLimits, way: Way, surface: ChannelSurface, speed_um_s: float
    ) -> None:
        profile = run.profile
        self._run = run
        self._limits = limits
        self._way = way
        self.surface = surface
        self._width_um = channel_width_um(profile.tool.diameter_um, profile.work.side_gap_um)
        self._speed_um_s = speed_um_s
        self._engaged = False
        self.wear = wear_of(profile)
        self.gap_um = GAP_GROWTH * profile.measure.expected_gap_um
        self.depth_um = self.aim_um = 0.0
        self.since_uj = 0.0
        self.since_s = surface.z1.time_s
        self.measured_u_um = 0.0
        self.layers = 0
        self.behind = False
        self.sums = CutTotals()
        self.keep: Callable[[], None] = lambda: None
        self.last: tuple[PassPlan, PassResult] | None = None

    @property
    def wear_u_um(self) -> float:
        """Standard uncertainty of the tip of the tool: wear since the last measurement, and drift."""
        return math.hypot(self.wear.u_um(self.since_uj), self._drift_um)

    @property
    def _drift_um(self) -> float:
        """Standard uncertainty of the drift since the last measurement."""
        drift_u_um_per_s = self._run.uncertainty.drift_u_um_per_s
        return drift_u_um_per_s * (self._run.machine.time_s - self.since_s)

    def cut(self, depth_um: float, layers_after: int, *, even_out: bool) -> tuple[str, str]:
        """Cut a layer down to `depth_um`; with `even_out` until hardly any sparks remain.

        Return the fault row that ended it early and a message; both empty if it is cut.
        """
        left = self._limits.left()
        if left.seconds <= 0.0:
            return "TIMEOUT", left.limit
        self.aim_um, thickness_um = depth_um, depth_um - self.depth_um
        held = HeldTool(self.surface.z1.z_um, self.surface.plane, depth_um, self.gap_um)
        self._engage(held)
        profile = self._run.profile
        rate_um3_s = removal_um3_s(profile, depth_um)
        needed = passes_needed(thickness_um, self._width_um, self._speed_um_s, rate_um3_s)
        uj_per_um = thickness_um * self._width_um / needed / _removal_um3_per_uj(profile)
        most = 2 * needed + SPARE_PASSES
        self.behind = False
        for _ in range(most):
            done = self._pass(held, uj_per_um, layers_after * needed)
            if done.fault:
                return done.fault, done.message
            uj_per_um = done.wearing_uj / self._way.length_um
            if done.held:
                break
        else:
            self.behind = True
            message = f"after {most} passes the tool was held on {100 * done.held_share:.0f} % of the path"
            return "STALL", message
        self.depth_um, self.layers = depth_um, self.layers + 1
        if not even_out:
            return "", ""
        return self._even_out(held, uj_per_um)

    def learn(self, found: FloorReading) -> None:
        """Update wear, wear per energy, the gap of a held tool and the depth by a measurement."""
        if self.last is None:
            raise ValueError("nothing was cut")
        drift_u_um_per_s = self._run.uncertainty.drift_u_um_per_s
        wear_um = found.pad.z_um - self.surface.z1.z_um
        self.wear.learn(self.since_uj, wear_um, drift_u_um_per_s * (found.pad.time_s - self.since_s))
        self.gap_um = learned_gap_um(*self.last, found, self.wear, self.gap_um)
        self._start_from(found)

    def resume(self, found: FloorReading) -> None:
        """Take the first measurement after an earlier run, whose last seconds of sparks are in no sum.

        So it shows where tool and floor are, and nothing of wear per energy or of the gap.
        """
        self.wear.restart(found.pad.z_um - self.surface.z1.z_um)
        self._start_from(found)

    def _start_from(self, found: FloorReading) -> None:
        self.depth_um = found.depth_um
        self.since_uj, self.since_s = 0.0, found.pad.time_s
        self._engaged = False

    def _pass(self, held: HeldTool, uj_per_um: float, passes_after: int) -> PassResult:
        """Make one pass, against the direction of the one before."""
        run, left = self._run, self._limits.left()
        if left.seconds <= 0.0:
            nothing = np.zeros(len(self._way.points))
            return PassResult(nothing, nothing, fault="TIMEOUT", message=left.limit)
        way = self._way.reversed() if self.sums.number % 2 else self._way
        rest_s = passes_after * way.length_um / self._speed_um_s
        plan = PassPlan(
            way,
            self._speed_um_s,
            held,
            uj_per_um,
            self.since_uj,
            rest_s,
            self.sums.number + 1,
            math.hypot(self.measured_u_um, self._drift_um),
        )
        before_s = run.tally.machining_time_s
        run.tally.unmeasured_site = run.profile.meta.name
        self.keep()
        done = run_pass(run, plan, self.wear, left.seconds, left.limit)
        run.tally.machining_time_s = before_s + done.time_s
        self.sums = self.sums.plus(done)
        run.tally.cut = RunningCut()
        self.last = (plan, done)
        self.since_uj += done.wearing_uj
        self._report_pass(held, done)
        return done

    def _even_out(self, held: HeldTool, uj_per_um: float) -> tuple[str, str]:
        """Pass again without feeding down, until hardly any sparks remain."""
        for _ in range(MOST_TO_EVEN):
            done = self._pass(held, uj_per_um, 0)
            if done.fault:
                return done.fault, done.message
            if done.open_share >= QUIET_SHARE:
                break
            uj_per_um = done.wearing_uj / self._way.length_um
        return "", ""

    def _engage(self, held: HeldTool) -> None:
        """Go to the start of the next pass, and down to the first sparks, unless the tool is there."""
        if self._engaged:
            return
        x_um, y_um = self._way.at(self._way.length_um if self.sums.number % 2 else 0.0)
        move_to(
            self._run, Place("the path's end" if self.sums.number % 2 else "the path's start", x_um, y_um)
        )
        old = HeldTool(held.pad_um, held.plane, self.depth_um, held.gap_um)
        floor_um = old.floor_um((x_um, y_um), self.wear.um(self.since_uj))
        floor_u_um = math.hypot(self.wear_u_um, self.surface.plane.height_u_um(x_um, y_um), FLOOR_U_UM)
        approach_bottom(self._run, floor_um, floor_u_um)
        self._engaged = True

    def _report_pass(self, held: HeldTool, done: PassResult) -> None:
        self._run.decide(
            RunEvent.PASS_ENDED,
            f"Pass {self.sums.number} at {held.depth_um:.2f} µm took {done.time_s:.0f} s: held on "
            f"{100 * done.held_share:.0f} % of the path, {100 * done.open_share:.0f} % of the pulses open"
            f"{f'; ended early, {done.message}' if done.fault else ''}.",
            {
                "pass": self.sums.number,
                "depth_um": held.depth_um,
                "time_s": done.time_s,
                "held": done.held_share,
                "open": done.open_share,
                "wear_um": self.wear.um(self.since_uj),
            },
            level=EventLevel.WARNING if done.fault else EventLevel.INFO,
        )


def wear_of(profile: Profile) -> ToolWear:
    """Return the wear per energy by the recipe: as much tool per workpiece as in a hole."""
    work, wear = profile.work, profile.wear
    section_um2 = hole_area_um2(profile.tool.diameter_um, work.side_gap_um)
    per_uj = wear.expected_ratio / section_um2 * _removal_um3_per_uj(profile)
    return ToolWear(per_uj, math.hypot(wear.ratio_u_rel, work.removal_u_rel), TOUCH_U_UM)


def _removal_um3_per_uj(profile: Profile) -> float:
    return profile.work.removal_um3_per_uj * (1.0 - SIDE_DISCHARGE_SHARE)
