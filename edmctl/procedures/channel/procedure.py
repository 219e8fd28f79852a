"""A channel by layers: touch the surface, scan layer after layer with the tool held, touch floor and pad, correct.

Every measurement cycle shows where the floor ends below a held tool and how much the tool wears on the way, so the
last layers are cut by measured values. A channel that an earlier run left is touched again, as a hole is
(decision 0022).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edmctl.dataclasses import replace
from edmctl.errors import MachineFault
from edmctl.labels import NOT_SHOWN_CODE, Basis, Verdict
from edmctl.planning.channel import LAYERS_BEFORE_FIRST_STOP, PLACES, PLACES_AT_THE_END, way_of_path
from edmctl.procedures.channel.layers import GAP_GROWTH, Layers
from edmctl.procedures.channel.scan import PassPlan, PassResult
from edmctl.procedures.channel.touching import (
    FLOOR_U_UM,
    ChannelSurface,
    ExtraUncertainty,
    FloorReading,
    measure_floor,
    touch_untouched,
)
from edmctl.procedures.hole.cut_planning import energy_of
from edmctl.procedures.hole.decision import (
    REMEDIES,
    Decision,
    judged_channel,
    missed,
    missed_by_fault,
    not_shown,
)
from edmctl.procedures.hole.hole_estimate import (
    BELIEF_U_REL,
    FASTER,
    STANDARD_UNCERTAINTIES,
    ExpectedHole,
    estimate_left,
    is_untouched,
    lengths,
    with_cuts,
)
from edmctl.procedures.hole.resuming import (
    BEYOND_UM,
    refuse_other,
    report_resumed,
    restore_surface,
    z1_left_by,
)
from edmctl.procedures.job import PERIOD_S, CutTotals, JobState, target_of
from edmctl.procedures.monitoring.drift import pause_drift_u_um
from edmctl.procedures.run import MACHINING, MEASURING, JobRun
from edmctl.procedures.servo.limits import TimeLimits
from edmctl.procedures.touch.reading import BEYOND_SIGMAS, NO_CONTACT
from edmctl.procedures.touch.surface_plane import SurfacePlane
from edmctl.process.channel import HeldTool, channel_width_um, layer_depths_um, wearing_uj
from edmctl.process.discharge import first_gap_u_um, mrr_mm3_min
from edmctl.process.next_cut import NOISE_FLOOR_SIGMAS
from edmctl.process.touches import TOUCH_U_UM, share_u
from edmctl.profile.places import Place
from edmctl.record.rows import RunEvent
from edmctl.results.declared import shared
from edmctl.results.job import ChannelResult, SiteResult
from edmctl.wording import length, plural, signed

FACE_SD_UM = 0.5  # a floor that differs by more from place to place is no untouched surface
LEAST_SUNK_SHARE = 0.25
"""A layer that takes more passes than it may is measured: the workpiece may erode more slowly, or the tool wear less
than expected, so that the tool is held too deep to get there. If the floor has not even sunk by this share of the
layer, the tool has stopped advancing."""
_UNKNOWN = (
    *("depth_model_um", "wear_model_um", "zero_drift_um"),
    *("feed_model_error_max_um", "feed_model_error_rms_um"),
    *("feed_model_error_max_pct", "feed_model_error_rms_pct"),
    *("wear_ratio_lin", "wear_ratio_vol"),
)
"""Fields of a hole that are NaN for a channel."""


def channel_row(run: JobRun, result: ChannelResult) -> SiteResult:
    """Return the channel as a row of the results: Z2 is the mean of its floor."""
    path = run.profile.path
    assert path is not None
    volume_um3, time_s = result.depth_um * result.width_um * result.length_um, result.machining_time_s
    unknown: dict[str, Any] = dict.fromkeys(_UNKNOWN, math.nan)
    return SiteResult(
        **shared(SiteResult, result),
        **unknown,
        x_um=path.x_um,
        y_um=path.y_um,
        z2_um=result.z3_um + result.depth_um,
        face_um=0.0,
        estimated_um=0.0,
        cuts=result.passes,
        mrr_mm3_min=mrr_mm3_min(volume_um3 / time_s) if time_s else math.nan,
    )


def expected_of_left_channel(state: JobState) -> ExpectedHole:
    """Return what to expect of the channel that an earlier run left."""
    # A held tool cuts no deeper than its layer in the end.
    unseen_um = state.channel["aim_um"] - state.channel["depth_um"]
    if state.machining_time_s >= PERIOD_S:
        unseen_um = FASTER * PERIOD_S * (state.depth_um + state.wear_um) / state.machining_time_s
    return ExpectedHole(estimate_left(state), unseen_um)


class ChannelProcedure:
    """Machines the channel of `profile.path`; the tally has the result of the last measurement cycle."""

    def __init__(self, run: JobRun, limits: TimeLimits) -> None:
        path = run.profile.path
        if path is None:
            raise ValueError("the profile has no channel")
        self._run, self._path, self._way = run, path, way_of_path(path)
        self._target = target_of(run.profile)
        run.tally.depth_um, run.tally.open_site = 0.0, run.profile.meta.name
        run.tally.depth_target_um = self._target.depth_um
        state = run.job.resumed
        self._left = state if state is not None and state.begun else None
        if self._left is None:
            self._surface = touch_untouched(run, self._way)
        else:
            surface = SurfacePlane(run)
            restore_surface(run, surface, self._left)
            self._surface = ChannelSurface(z1_left_by(run, self._left), surface.plane, surface.doubt_u_um)
        self._layers = Layers(run, limits, self._way, self._surface, path.speed_um_s)
        self._layers.keep = self._keep_state
        self._result: ChannelResult | None = None
        self._stops, self._is_gap_learned = 0, False

    def machine(self) -> Decision:
        """Machine the channel, or what an earlier run left of it, and return how it ended."""
        if self._left is None:
            self._keep_state(MEASURING)
            return self._cut_down()
        return self._ended(self._resume(self._left), last=False) or self._cut_down()

    def finished(self) -> ChannelResult | None:
        """Return the result with its verdict; None if the time was up before anything was cut."""
        self._run.tally.open_site = self._run.tally.unmeasured_site = ""
        if self._result is None:
            return None
        result = judged_channel(self._target, self._result)
        self.keep(replace(result, finished=True))
        return result

    def keep(self, result: ChannelResult) -> None:
        """Put a result into the tally."""
        self._run.tally.channel = result

    def _cut_down(self) -> Decision:
        run, layers, target = self._run, self._layers, self._target
        corrections = run.profile.wear.max_cuts
        while True:
            depths_um = layer_depths_um(layers.depth_um, target.depth_um, self._path.layer_um)
            last = len(depths_um) == 1
            even_out = last or self._is_due(len(depths_um) - 1)
            from_um = layers.depth_um
            fault, message = layers.cut(depths_um[0], len(depths_um) - 1, even_out=even_out)
            if not (fault or even_out):
                continue
            if fault and layers.since_uj <= 0.0:
                return self._missed(fault, message)
            result = self._measure(PLACES_AT_THE_END if last and not fault else PLACES)
            sunk_um = result.depth_um - from_um
            if fault and not (layers.behind and sunk_um >= LEAST_SUNK_SHARE * (depths_um[0] - from_um)):
                return self._missed(fault, message)
            corrections -= last
            ended = self._ended(result, last=last and corrections <= 0)
            if ended is not None:
                return ended
            ended_early = f" The last layer ended early: {message}." if message else ""
            left_um = target.depth_um - result.depth_um
            again = max(1, len(layer_depths_um(result.depth_um, target.depth_um, self._path.layer_um)))
            run.decide(
                RunEvent.CUT_DECIDED,
                f"{left_um:.2f} µm are left, in {plural(again, 'layer')}.{ended_early}",
                {"left_um": left_um, "layers": again},
            )

    def _ended(self, result: ChannelResult, *, last: bool) -> Decision | None:
        """Return the end at the target, after the `last` stop or with a worn tool; None if more is to be cut."""
        run, target = self._run, self._target
        lost_um, limit_um = run.job.tool_wear_before_um + result.wear_um, run.profile.tool.max_wear_um
        if lost_um > limit_um:
            message = (
                f"The tool has lost {lost_um:.0f} µm, tool.max_wear_um is {limit_um:.0f} µm; the channel ends at "
                f"{target.reached(result.depth_um, result.feed_um)}."
            )
            run.warn(RunEvent.TARGET_MISSED, message, {"wear_um": lost_um})
            return missed(message, "Dress or change the tool, and machine the channel anew.")
        enough_um = max(target.tolerance_um / 2.0, NOISE_FLOOR_SIGMAS * TOUCH_U_UM)
        if last or target.depth_um - result.depth_um <= enough_um:
            return self._final(result)
        return None

    def _final(self, result: ChannelResult) -> Decision:
        """Return the end after the last layer: target reached, or missed by the depth or the evenness of the
        floor.
        """
        run, target = self._run, self._target
        off = f"{signed(result.depth_um - target.depth_um)} µm from the target"
        message = (
            f"Channel {result.depth_um:.2f} µm deep, {off}, {result.floor_sd_um:.2f} µm rms along the path, after "
            f"{result.layers} layers in {result.passes} passes."
        )
        verdict = judged_channel(target, result).verdict
        if verdict is Verdict.SHOWN:
            run.decide(RunEvent.TARGET_REACHED, message, {"depth_um": result.depth_um})
            return Decision(message)
        if verdict is Verdict.NOT_SHOWN:
            message = f"{not_shown('The mean depth of the floor', target, result)}."
            hint = REMEDIES[result.depth_basis]
            run.warn(RunEvent.VERDICT, message, {"hint": hint})
            return missed(message, hint, NOT_SHOWN_CODE)
        run.warn(RunEvent.TARGET_MISSED, message, {"depth_um": result.depth_um})
        why = (
            f"The floor is {result.depth_um:.2f} µm deep on average, {off}, and {result.floor_sd_um:.2f} µm rms "
            f"uneven; target.tolerance_um is {target.tolerance_um:.1f} µm."
        )
        hint = "Use thinner layers (path.layer_um) or a slower scan (path.speed_um_s), or allow more."
        return Decision(message, missed=why, hint=hint)

    def _missed(self, fault: str, message: str) -> Decision:
        """Return the end by a row of the faults, with what was reached."""
        depth_um = 0.0 if self._result is None else self._result.depth_um
        reached = f"a floor {depth_um:.2f} of {self._target.depth_um:g} µm deep"
        decision = missed_by_fault(fault, f" The channel ended early ({message}) at {reached}.")
        self._run.warn(RunEvent.TARGET_MISSED, decision.message, {"depth_um": depth_um})
        return decision

    def _is_due(self, layers_after: int) -> bool:
        """Return whether to measure after the next layer, with `layers_after` remaining.

        After the second layer for wear and gap; whenever the length of the tool is not known to half the tolerance;
        and before the last layer, which is to end at the target, if it is not known to a quarter.
        """
        if not self._is_gap_learned and self._layers.layers + 1 >= LAYERS_BEFORE_FIRST_STOP:
            return True
        unknown = self._layers.wear_u_um / self._target.tolerance_um
        return unknown > 0.5 or (layers_after == 1 and unknown > 0.25)

    def _measure(self, places: int) -> ChannelResult:
        layers = self._layers
        if layers.last is None:
            raise ValueError("nothing was cut")
        plan, done = layers.last
        found = measure_floor(self._run, self._surface, plan, done, layers.wear, layers.since_uj, places)
        uneven_um = abs(plan.held.depth_um - layers.depth_um) if done.fault else 0.0
        layers.learn(found)
        self._is_gap_learned |= done.held
        return self._keep_result(found, uneven_um)

    def _resume(self, state: JobState) -> ChannelResult:
        """Touch floor and pad as an earlier run left them; the journal's state remains until then.

        Raises PreconditionError E8060, E8061 if they are not as they were left.
        """
        run, layers, expected = self._run, self._layers, expected_of_left_channel(state)
        plan, done = self._restore(state)
        step_um = layers.aim_um - layers.depth_um
        drift_um = STANDARD_UNCERTAINTIES * pause_drift_u_um(run.job)
        # A mistake is to be found, not missed.
        unknown = ExtraUncertainty(
            pad_u_um=(expected.reach_um(expected.estimate.wear) + drift_um + BEYOND_UM) / BEYOND_SIGMAS,
            floor_u_um=(expected.depth_reach_um + BEYOND_UM) / BEYOND_SIGMAS,
            step_u_um=share_u(0.5 * step_um),
        )
        try:
            found = measure_floor(
                run, self._surface, plan, done, layers.wear, 0.0, PLACES_AT_THE_END, unknown
            )
        except MachineFault as fault:
            if fault.code == NO_CONTACT:
                fault.hint += " Workpiece, place or tool may differ from those in the journal."
            raise
        self._refuse_other(expected, found, step_um)
        layers.resume(found)
        return self._keep_result(found, step_um)

    def _restore(self, state: JobState) -> tuple[PassPlan, PassResult]:
        """Set the layers by estimate; return the last pass as far as it is known, with a tool that was not held."""
        layers, left, tally = self._layers, state.channel, self._run.tally
        self._stops, self._is_gap_learned = int(left["stops"]), bool(left["gap_learned"])
        layers.sums = CutTotals(state.cuts, state.counts, state.energy_j, state.machining_time_s)
        layers.layers, layers.gap_um = int(left["layers"]), left["gap_um"]
        layers.depth_um, layers.aim_um = left["depth_um"], left["aim_um"]
        layers.wear.per_uj, layers.wear.u_rel = left["wear_per_uj"], left["wear_u_rel"]
        layers.wear.restart(state.wear_um)
        tally.depth_um, tally.unmeasured_site = state.depth_um, self._run.profile.meta.name
        held = HeldTool(self._surface.z1.z_um, self._surface.plane, layers.aim_um, layers.gap_um)
        limits_um = np.array([held.z_um((float(x), float(y)), state.wear_um) for x, y in self._way.points])
        plan = PassPlan(self._way, 0.0, held, uj_per_um=0.0, since_uj=0.0, rest_s=0.0)
        return plan, PassResult(limits_um, np.zeros(len(self._way.points)))

    def _refuse_other(self, expected: ExpectedHole, found: FloorReading, step_um: float) -> None:
        """Record what was found if it can be the channel, whose floor has a step of `step_um` between its places."""
        run, surface = self._run, self._surface
        even = found.lengths(run, surface)
        widened = replace(even, depth=even.depth.widened(step_um), feed=even.feed.widened(step_um))
        untouched = is_untouched(even) and found.sd_um < FACE_SD_UM
        site = Place(run.profile.meta.name, self._path.x_um, self._path.y_um)
        refuse_other(run, site, expected, widened, untouched=untouched, begun=False)
        if untouched:
            # Hardly begun, or another workpiece, of whose surface only the floor is known.
            doubt_u_um = math.hypot(share_u(found.depth_um), even.depth.u)
            surface.doubt_u_um = math.hypot(surface.doubt_u_um, doubt_u_um)
            keeper = run.keeper
            keeper.surface_doubt_u_um = math.hypot(keeper.surface_doubt_u_um, doubt_u_um)
        report_resumed(run, expected.estimate, found.depth_um, even.wear_um)

    def _result_of(self, found: FloorReading, uneven_um: float) -> ChannelResult:
        """Return the result of a measurement cycle and all passes before it.

        After a pass that ended early the floor may be deeper by `uneven_um` where the tool was, which is at none of
        the touched places: the mean of the floor may be off by that.
        """
        job, layers = self._run.job, self._layers
        measured = found.lengths(self._run, self._surface, uneven_um)
        return ChannelResult(
            name=job.profile.meta.name,
            length_um=self._way.length_um,
            width_um=channel_width_um(job.profile.tool.diameter_um, job.profile.work.side_gap_um),
            layers=layers.layers,
            **measured.columns(),
            passes=layers.sums.number,
            **layers.sums.columns(),
            floor_sd_um=found.sd_um,
            z1_um=self._surface.z1.z_um,
            z3_um=found.pad.z_um - measured.drift_um,
            working_gap_um=layers.gap_um,
            measuring_stops=self._stops + 1,
            floor=found.places,
            depth_basis=job.touch_basis,
            wear_basis=job.touch_basis,
            drift_correction_um=measured.drift_um,
            drift_left_u_um=measured.drift_left_u_um,
            drift_by_rests=measured.drift_by_rests,
        )

    def _keep_result(self, found: FloorReading, uneven_um: float) -> ChannelResult:
        self._result = result = self._result_of(found, uneven_um)
        self._stops += 1
        self._layers.measured_u_um = result.wear_u_um
        self._run.tally.depth_um, self._run.tally.unmeasured_site = found.depth_um, ""
        self.keep(result)
        self._keep_state(MEASURING)
        self._run.decide(
            RunEvent.CHANNEL_MEASURED,
            f"Floor {length(result.depth_um, result.depth_u95_um)} deep, {found.sd_um:.2f} µm rms from "
            f"place to place, wear {length(result.wear_um, result.wear_u95_um)}; a held tool leaves a gap "
            f"of {result.working_gap_um:.2f} µm.",
            {
                "depth_um": result.depth_um,
                "depth_u95_um": result.depth_u95_um,
                "floor_sd_um": found.sd_um,
                "wear_um": result.wear_um,
                "wear_u95_um": result.wear_u95_um,
                "gap_um": result.working_gap_um,
            },
        )
        return result

    def _keep_state(self, phase: str = MACHINING) -> None:
        self._run.keeper.keep(phase, self, self._run.machine.time_s)

    def add_to(self, state: JobState, now_s: float) -> JobState:
        """Return the state of the job with that of the channel.

        The floor is between the last layer and the one under way; where it was left, and the wear of the tool, are
        known by the energy since the last stop.
        """
        run, layers = self._run, self._layers
        cut, pulse = run.tally.cut, run.profile.pulse
        since_uj = layers.since_uj + wearing_uj(energy_of(pulse, cut))
        low_um, high_um = layers.depth_um, max(layers.depth_um, layers.aim_um)
        between_um = share_u(0.5 * (high_um - low_um))
        first_gap_u = GAP_GROWTH * first_gap_u_um(pulse.open_voltage_v)
        gap_u_um = FLOOR_U_UM if self._is_gap_learned else max(FLOOR_U_UM, first_gap_u)
        drift_um = run.uncertainty.drift_u_um_per_s * max(0.0, now_s - layers.since_s)
        unconfirmed_um = BELIEF_U_REL * layers.wear.per_uj * since_uj
        wear_u_um = math.hypot(layers.wear.u_um(since_uj), unconfirmed_um, drift_um)
        cuts = layers.sums.number + (cut.time_s > 0.0)
        estimate = lengths(
            0.5 * (low_um + high_um),
            math.hypot(between_um, gap_u_um, wear_u_um),
            layers.wear.um(since_uj),
            wear_u_um,
            math.hypot(between_um, gap_u_um, drift_um),
        )
        state = replace(
            self._surface.z1.as_z1(state, run.tally.earlier_time_s),
            site=run.profile.meta.name,
            begun=cuts > 0 or state.phase == MACHINING,
            channel={
                "layers": layers.layers,
                "depth_um": low_um,
                "aim_um": high_um,
                "gap_um": layers.gap_um,
                "gap_learned": float(self._is_gap_learned),
                "wear_per_uj": layers.wear.per_uj,
                "wear_u_rel": layers.wear.u_rel,
                "stops": self._stops,
            },
        )
        return with_cuts(state, cut, layers.sums, cuts, estimate)

    def leave(self) -> None:
        """Report by estimate what was cut since the last stop, if the channel ends before the next one.

        It may be as deep as the layer under way in places. The wear is by the energy of whole passes, and per depth
        at least as much as before. What was not touched may be wrong by all of it, and by as much per depth as the
        measurement; a tool does not lose more than it cuts. A pass that was broken off is in no sum.
        """
        tally, layers, measured = self._run.tally, self._layers, self._result
        if measured is None or not tally.unmeasured_site:
            return
        # A short may have pulled the tool back; the floor stays where it is.
        tally.depth_um = depth_um = max(tally.depth_um, layers.depth_um, measured.depth_um)
        cut_um = max(depth_um, layers.aim_um) - measured.depth_um
        per_um = 1.0 / measured.depth_um if measured.depth_um > 0.0 else 0.0
        more_um = layers.wear.um(layers.since_uj) - measured.wear_um
        worn_um = max(more_um, measured.wear_um * per_um * cut_um, 0.0)
        missed_um = cut_um * min(measured.wear_u_um * per_um, 1.0) if per_um else cut_um
        depth_u_um = math.hypot(measured.depth_u_um, cut_um)
        wear_u_um = math.hypot(measured.wear_u_um + missed_um, worn_um)
        feed_u_um = math.hypot(measured.depth_u_um, cut_um, wear_u_um)
        estimate = lengths(depth_um, depth_u_um, measured.wear_um + worn_um, wear_u_um, feed_u_um)
        self.keep(
            replace(
                measured,
                layers=layers.layers,
                **estimate.columns(),
                passes=layers.sums.number,
                **layers.sums.columns(),
                floor_sd_um=math.nan,
                z3_um=math.nan,
                floor=(),
                depth_basis=Basis.ESTIMATED,
                wear_basis=Basis.ESTIMATED,
            )
        )


def machine_path(run: JobRun) -> Decision | None:
    """Machine the channel of the recipe; return the decision if it missed its target, else None.

    Raises PreconditionError E8060, E8061 if it is not the channel, or the tool, that an earlier run has left.
    """
    channel = ChannelProcedure(run, TimeLimits(run))
    decision = channel.machine()
    result = channel.finished()
    if result is not None:
        run.recorder.append(channel_row(run, result))
    return decision if decision.missed else None


def record_left_channel(run: JobRun) -> None:
    """Write the result of a channel that was measured, if its job ends early."""
    channel = run.tally.channel
    if channel is not None and not channel.finished:
        run.recorder.append(channel_row(run, channel))
