"""A hole that an earlier run left in the middle: pad and bottom are touched again, then it continues.

The tool returns to 0 V without power, so the pad shows the remaining tool length, and the bottom the depth of the
hole. Estimates from before the interruption enter no result, but they have to agree: otherwise workpiece, place or
tool are not those that were left, and nothing is machined.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

from edmctl import failures
from edmctl.errors import MachineFault, PreconditionError
from edmctl.procedures.hole import cut_planning as planning
from edmctl.procedures.hole.cut import NO_SPARK
from edmctl.procedures.hole.cut_planning import ExpectedHole
from edmctl.procedures.hole.decision import Decision, close_site
from edmctl.procedures.hole.hole import Hole
from edmctl.procedures.hole.knowledge import JobKnowledge
from edmctl.procedures.hole.procedure import HoleProcedure
from edmctl.procedures.job import JobState
from edmctl.procedures.monitoring.drift import counted_pause_s, pause_drift_u_um
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.limits import TimeLimits, is_near_back
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import MORE_LOOKS, wash
from edmctl.procedures.touch.reading import BEYOND_SIGMAS, NO_CONTACT, SurfaceReading, take_reading
from edmctl.procedures.touch.surfaces import SurfacePlane, ToolLength, read_pad
from edmctl.process.touches import DepthAndWear, Reading
from edmctl.profile.places import Place
from edmctl.record.rows import RejectedTouch, RunEvent
from edmctl.wording import decimal, length, with_u95

BEYOND_UM = 12.0  # touches search this far beyond what is accepted: a mistake is to be found, not missed


class ResumedHole(HoleProcedure):
    """Continues a hole from the journal of an earlier run."""

    def __init__(self, run: JobRun, site: Place, knowledge: JobKnowledge, limits: TimeLimits) -> None:
        state = run.job.resumed
        assert state is not None
        restore_surface(run, knowledge.surface, state)
        z1 = z1_left_by(run, state)
        knowledge.tool = ToolLength(z1, state.wear_um)
        hole = Hole(run, site, knowledge.surface, knowledge.estimate, z1, state.z1_u_um)
        hole.resume(state)
        super().__init__(run, hole, knowledge, limits)
        self._state, self._expected = state, planning.expected_of_left(state, run.profile)
        run.tally.depth_um, run.tally.unmeasured_site = state.depth_um, site.name
        hole.keep(begun=True)

    def resume(self) -> Decision | None:
        """Measure the hole, and cut the rest; None if it is to be restarted.

        Raises PreconditionError: E8060 this is not the hole that was left, E8061 nor the tool, E8062 there is no
        untouched surface for a hole that is to be restarted.
        """
        run, hole, expected = self._run, self._hole, self._expected
        if run.profile.target.kind == "through" and not run.job.restart_hole:
            return self._resume_through()
        z3 = self._touch_pad(expected)
        z2 = _touch_bottom(run, hole.site, z3.z_um + hole.face_um + self._state.depth_um, expected)
        found = hole.measured(z2, z3)
        for _ in range(0 if run.job.restart_hole else MORE_LOOKS):
            if found.depth_um >= expected.estimate.depth_um or expected.depth_fits(found):
                break
            run.warn(
                RunEvent.TOUCH_DOUBTED,
                f"Z2 = {z2.z_um:.2f} µm is nearer than the journal expects (a chip?). It is touched again.",
                {"kind": "Z2", "z_um": z2.z_um},
            )
            run.recorder.append(RejectedTouch(z2.time_s))
            wash(run, z2.z_um)  # the oil may remove debris that settled on the bottom
            z2 = _touch_bottom(run, hole.site, z2.z_um, expected)
            found = hole.measured(z2, z3)
        if not run.tally.sites and run.profile.target.kind != "through":
            found = self._on_its_own_surface(z2, z3, found)
        if run.job.restart_hole:
            self._restart(z3, found)
            return None
        refuse_other(run, hole.site, expected, found, untouched=planning.is_untouched(found))
        found = self._learn_resumed(z2, z3)
        decision = self._decide(max(1, hole.total.number), None, found)
        if decision.plan is None:
            close_site(run, settled=True)
            return decision
        return self.cut_to_the_end(decision.plan)

    def _resume_through(self) -> Decision:
        """Measure a hole through the sheet, and continue the cut if it is not open.

        A hole is open if the tool goes through it as far below the surface as it would have been fed, without
        contact. A rim that the first touch has met is gone after an approach without sparks.
        """
        run, hole, target = self._run, self._hole, self._hole.target
        expected = self._expected
        opened = expected.through_at_most(target.depth_um)
        # Behind the sheet a tool does not wear, although its feed was divided as if it did.
        not_worn_um = expected.estimate.wear_um - opened.estimate.wear_um
        pad = self._touch_pad(opened, not_worn_um)
        least_um = max(0.0, expected.estimate.depth_um - expected.depth_reach_um - BEYOND_UM)
        bottom = self.touch_bottom_or_none(pad, pad.z_um + hole.face_um + least_um)
        if bottom is None:
            return self._open(pad, opened)
        found = hole.measured(bottom, pad)
        refuse_other(run, hole.site, expected, found)
        found = self._learn_resumed(bottom, pad)
        start = hole.next_start(self._knowledge.gap)
        plan = planning.through_plan(max(1, hole.total.number) + 1, start, target, self._knowledge.estimate)
        try:
            return self.cut_to_the_end(plan)
        except MachineFault as fault:
            is_in_approach = hole.plan is None
            if fault.code != NO_SPARK or not is_in_approach or not is_near_back(found.depth, target.depth_um):
                raise
            run.machine.clear_fault(fault.fault)
            run.machine.arm()
            if self.touch_bottom_or_none(pad, bottom.z_um) is not None:
                raise
        return self._open(pad, opened)

    def _learn_resumed(self, bottom: SurfaceReading, pad: SurfaceReading) -> DepthAndWear:
        """Learn from the touches; no cut of this run has shown the working gap yet."""
        found = self._learn(bottom, pad, self._knowledge.gap)
        report_resumed(self._run, self._expected.estimate, found.depth_um, found.wear_um)
        return found

    def _touch_pad(self, expected: ExpectedHole, more_um: float = 0.0) -> SurfaceReading:
        """Touch the pad (Z3), which may be `more_um` further than expected."""
        run, hole = self._run, self._hole
        z3_um = hole.z1.z_um + expected.estimate.wear_um
        drift_um = planning.STANDARD_UNCERTAINTIES * pause_drift_u_um(run.job)
        u_um = (expected.reach_um(expected.estimate.wear) + drift_um + more_um + BEYOND_UM) / BEYOND_SIGMAS
        with _journal_hint(run.job.pad, z3_um):
            z3 = read_pad(run, "Z3", hole.site.name, z3_um, u_um)
        self._update_surface(z3)
        return z3

    def _update_surface(self, pad: SurfaceReading) -> None:
        self._knowledge.surface.fit_pad_slope(pad)
        self._hole.locate_surface(self._knowledge.surface)

    def _on_its_own_surface(
        self, z2: SurfaceReading, z3: SurfaceReading, found: DepthAndWear
    ) -> DepthAndWear:
        """Return depth and wear with the surface beside the hole, if this may be another workpiece.

        If the hole has hardly any depth, the touches of the earlier run do not count any more.
        """
        run, hole, knowledge = self._run, self._hole, self._knowledge
        restored, knowledge.surface = knowledge.surface, SurfacePlane(run)
        self._update_surface(z3)
        if restored.touched and planning.is_untouched(hole.measured(z2, z3)):
            knowledge.surface.touch_beside(hole.site, ToolLength(z3))
            knowledge.surface.keep()
            self._update_surface(z3)
            return hole.measured(z2, z3)
        knowledge.surface = restored
        self._update_surface(z3)
        return found

    def _restart(self, pad: SurfaceReading, found: DepthAndWear) -> None:
        """Restart the hole on an untouched surface, beside the finished holes that belong to it."""
        run, name, u95_um = self._run, self._hole.site.name, found.depth.u95
        if not planning.is_untouched(found):
            depth_um = with_u95(found.depth_um, u95_um)
            raise _refused(run, failures.face_not_untouched(site=name, depth_um=depth_um))
        if run.tally.sites:
            _check_finished(run, self._knowledge, pad)
        self._knowledge.tool = ToolLength(pad)
        run.tally.depth_um, run.tally.unmeasured_site = 0.0, ""
        depth = length(found.depth_um, u95_um)
        message = f"The face at {name} is untouched ({depth}): the hole is made from the start."
        run.decide(RunEvent.RESUMED, message, {"depth_um": found.depth_um})

    def _open(self, pad: SurfaceReading, expected: ExpectedHole) -> Decision:
        run, hole, target = self._run, self._hole, self._hole.target
        found = hole.take_tip(pad.z_um + hole.face_um + target.depth_um + target.completion_um, pad)
        if expected.estimate.depth_um + expected.depth_reach_um < target.depth_um - target.tolerance_um:
            raise _refused(run, planning.other_work(hole.site, found, expected.estimate, begun=True))
        if not expected.wear_fits(found):
            raise _refused(run, planning.other_tool(found, expected.estimate))
        self._knowledge.tool = ToolLength(pad)
        # The tip went further than the sheet is thick: an open hole is resumed.
        report_resumed(run, expected.estimate, target.depth_um, found.wear_um)
        hole.report(found, self._knowledge.gap.value, through=True)
        decision = self.through(found)
        run.decide(RunEvent.TARGET_REACHED, decision.message, {"depth_um": found.depth_um})
        close_site(run, settled=True)
        return decision


def check_last_hole(run: JobRun, knowledge: JobKnowledge) -> None:
    """Touch the bottom of the hole that was finished last, if none was begun after it: is this that workpiece?

    A hole through the sheet has no bottom. The touch of the pad needs no comparison: the next hole counts from it.
    Raises PreconditionError E8060.
    """
    state = run.job.resumed
    if state is None or not run.tally.sites or run.profile.target.kind == "through":
        return
    restore_surface(run, knowledge.surface, state)
    _check_finished(run, knowledge, knowledge.touch_pad_first(run.job.pad.name))


def _check_finished(run: JobRun, knowledge: JobKnowledge, pad: SurfaceReading) -> None:
    result = list(run.tally.sites.values())[-1]
    site = Place(result.name, result.x_um, result.y_um, result.theta_deg)
    expected = planning.expected_of_finished(result)
    hole = Hole(run, site, knowledge.surface, knowledge.estimate, pad)
    bottom = _touch_bottom(run, site, pad.z_um + hole.face_um + result.depth_um, expected)
    found = hole.measured(bottom, pad)
    if not expected.depth_fits(found):
        raise _refused(run, planning.other_work(site, found, expected.estimate, begun=False))
    depths = f"{found.depth_um:.2f} µm deep; {result.depth_um:.2f} µm were expected"
    args = {"depth_um": found.depth_um, "expected_um": result.depth_um}
    run.decide(RunEvent.RESUMED, f"{site.name}, finished before, is {depths}.", args)


def _touch_bottom(run: JobRun, site: Place, predicted_um: float, expected: ExpectedHole) -> SurfaceReading:
    move_to(run, site)
    u_um = (expected.depth_reach_um + BEYOND_UM) / BEYOND_SIGMAS
    with _journal_hint(site, predicted_um):
        return take_reading(run, "Z2", site.name, predicted_um, u_um)


@contextmanager
def _journal_hint(place: Place, predicted_um: float) -> Iterator[None]:
    try:
        yield
    except MachineFault as fault:
        if fault.code == NO_CONTACT:
            fault.hint += (
                f" The journal expects contact at {predicted_um:.1f} µm, {place.name}: work, place or tool may not "
                "be those that were left."
            )
        raise


def refuse_other(
    run: JobRun,
    site: Place,
    expected: ExpectedHole,
    found: DepthAndWear,
    *,
    untouched: bool = False,
    begun: bool = True,
) -> None:
    """Raise PreconditionError E8060, E8061 if the touches contradict the journal by depth or by tool."""
    tool_fits = expected.tool_fits(found)
    if not expected.depth_fits(found) or (untouched and not tool_fits):
        raise _refused(run, planning.other_work(site, found, expected.estimate, begun=begun))
    if not tool_fits:
        raise _refused(run, planning.other_tool(found, expected.estimate))


def _refused(run: JobRun, error: PreconditionError) -> PreconditionError:
    """Return the error, after clearing the estimates of the journal: they are no result of this run then."""
    run.tally.depth_um, run.tally.unmeasured_site = math.nan, ""
    return error


def report_resumed(run: JobRun, expected: DepthAndWear, depth_um: float, wear_um: float) -> None:
    run.decide(
        RunEvent.RESUMED,
        f"Taken up again at {decimal(depth_um)} µm depth and {decimal(wear_um)} µm wear; the journal expected "
        f"{decimal(expected.depth_um, 1)} and {decimal(expected.wear_um, 1)} µm.",
        {"depth_um": depth_um, "wear_um": wear_um, "expected_um": expected.depth_um},
    )


def restore_surface(run: JobRun, surface: SurfacePlane, state: JobState) -> None:
    """Take the touches of the surface from the journal, and warn about a pause of unknown length."""
    if not surface.touched:
        surface.restore(state.face, state.face_doubt_u_um)
    if math.isfinite(run.job.pause_s):
        return
    drift_um = 2.0 * pause_drift_u_um(run.job)
    message = (
        "The length of the pause is unknown: a clock was set back, or the time is missing. Depth is measured anew; "
        f"the interval of the wear includes a drift of ± {drift_um:.0f} µm."
    )
    run.warn(RunEvent.RESUMED, message, {"drift_um": drift_um})


def z1_left_by(run: JobRun, state: JobState) -> SurfaceReading:
    """Return Z1 as the journal has it; times before this run are negative."""
    return SurfaceReading(
        kind="Z1",
        reading=Reading(state.z1_um, state.z1_sd_um, state.z1_touches),
        model_um=state.z1_model_um,
        actuator_v=math.nan,
        time_s=state.z1_time_s - state.time_s - counted_pause_s(run.job),
        zero_um=math.nan,
        doubt_u_um=state.z1_doubt_u_um,
    )
