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
from edmctl.procedures.channel.touching import (
    FLOOR_U_UM,
    ChannelSurface,
    FloorReading,
    PassPlan,
    PassResult,
    measure_floor,
    touch_untouched,
)
from edmctl.procedures.hole import cut_planning as planning
from edmctl.procedures.hole import decision as decisions
from edmctl.procedures.hole import resuming
from edmctl.procedures.hole.decision import Decision
from edmctl.procedures.job import PERIOD_S, CutTotals, JobState, target_of
from edmctl.procedures.monitoring.drift import pause_drift_u_um
from edmctl.procedures.run import MACHINING, MEASURING, JobRun
from edmctl.procedures.servo.limits import TimeLimits
from edmctl.procedures.touch.reading import BEYOND_SIGMAS, NO_CONTACT
from edmctl.procedures.touch.surfaces import SurfacePlane
from edmctl.process.channel import HeldTool, channel_width_um, layer_depths_um, wearing_uj
from edmctl.process.erosion import first_gap_u_um, mrr_mm3_min
from edmctl.process.next_cut import NOISE_FLOOR_SIGMAS
from edmctl.process.touches import TOUCH_U_UM, share_u
from edmctl.profile.places import Place
from edmctl.quantity import Value
from edmctl.record.rows import RunEvent
from edmctl.results.declared import shared
from edmctl.results.job import ChannelResult, SiteResult
from edmctl.wording import length, plural, signed

FACE_SD_UM = 0.5  # a floor that differs by more from place to place is no untouched surface
LEAST_SUNK_SHARE = 0.25  # of a layer; a floor that has sunk less shows a tool that stopped advancing
_UNKNOWN = (
    *("depth_model_um", "wear_model_um", "zero_drift_um"),
    *("feed_model_error_max_um", "feed_model_error_rms_um"),
    *("feed_model_error_max_pct", "feed_model_error_rms_pct"),
    *("wear_ratio_lin", "wear_ratio_vol"),
)
"""Fields of a hole that are NaN for a channel."""


class ChannelProcedure:
    """Machines the channel of `profile.path`; the tally has the result of the last measurement cycle."""

    def __init__(self, run: JobRun, limits: TimeLimits) -> None:
        path, state = run.profile.path, run.job.resumed
        if path is None:
            raise ValueError("the profile has no channel")
        self._run, self._path, self._way = run, path, way_of_path(path)
        self._target = target_of(run.profile)
        run.tally.depth_um, run.tally.open_site = 0.0, run.profile.meta.name
        run.tally.depth_target_um = self._target.depth_um
        self._left = state if state is not None and state.begun else None
        if self._left is None:
            self._surface = touch_untouched(run, self._way)
        else:
            surface = SurfacePlane(run)
            resuming.restore_surface(run, surface, self._left)
            self._surface = ChannelSurface(
                resuming.z1_left_by(run, self._left), surface.plane, surface.doubt_u_um
            )
        self._layers = Layers(run, limits, self._way, self._surface, path.speed_um_s)
        self._layers.keep = self._keep_state
        self._result: ChannelResult | None = None
        self._stops, self._is_gap_learned = 0, False

    def machine(self) -> Decision:
        """Machine the channel, or what an earlier run left of it, and return how it ended."""
        if self._left is None:
            self._keep_state(MEASURING)
            return self._cut_down()
        return self._end_after(self._resume(self._left), last=False) or self._cut_down()

    def finished(self) -> ChannelResult | None:
        """Return the result with its verdict; None if the time was up before anything was cut."""
        self._run.tally.open_site = self._run.tally.unmeasured_site = ""
        if self._result is None:
            return None
        result = decisions.judged_channel(self._target, self._result)
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
            end = self._end_after(result, last=last and corrections <= 0)
            if end is not None:
                return end
            ended_early = f" The last layer ended early: {message}." if message else ""
            left_um = target.depth_um - result.depth_um
            again = max(1, len(layer_depths_um(result.depth_um, target.depth_um, self._path.layer_um)))
            text = f"{left_um:.2f} µm are left, in {plural(again, 'layer')}.{ended_early}"
            run.decide(RunEvent.CUT_DECIDED, text, {"left_um": left_um, "layers": again})

    def _end_after(self, result: ChannelResult, *, last: bool) -> Decision | None:
        """Return the end at the target, after the `last` stop or with a worn tool; None if more is to be cut."""
        run, target = self._run, self._target
        lost_um, limit_um = run.job.tool_wear_before_um + result.wear_um, run.profile.tool.max_wear_um
        if lost_um > limit_um:
            message = (
                f"The tool has lost {lost_um:.0f} µm, tool.max_wear_um is {limit_um:.0f} µm; the channel ends at "
                f"{target.reached(result.depth_um, result.feed_um)}."
            )
            run.warn(RunEvent.TARGET_MISSED, message, {"wear_um": lost_um})
            return decisions.missed(message, "Dress or change the tool, and machine the channel anew.")
        enough_um = max(target.tolerance_um / 2.0, NOISE_FLOOR_SIGMAS * TOUCH_U_UM)
        if not last and target.depth_um - result.depth_um > enough_um:
            return None
        off, uneven = signed(result.depth_um - target.depth_um), f"{result.floor_sd_um:.2f} µm rms"
        message = (
            f"Channel {result.depth_um:.2f} µm deep, {off} µm from the target, {uneven} along the path, after "
            f"{result.layers} layers in {result.passes} passes."
        )
        verdict = decisions.judged_channel(target, result).verdict
        if verdict is Verdict.SHOWN:
            run.decide(RunEvent.TARGET_REACHED, message, {"depth_um": result.depth_um})
            return Decision(message)
        if verdict is Verdict.NOT_SHOWN:
            message = f"{decisions.not_shown('The mean depth of the floor', target, result)}."
            hint = decisions.REMEDIES[result.depth_basis]
            run.warn(RunEvent.VERDICT, message, {"hint": hint})
            return decisions.missed(message, hint, NOT_SHOWN_CODE)
        run.warn(RunEvent.TARGET_MISSED, message, {"depth_um": result.depth_um})
        why = (
            f"The floor is {result.depth_um:.2f} µm deep on average, {off} µm from the target, and {uneven} "
            f"uneven; target.tolerance_um is {target.tolerance_um:.1f} µm."
        )
        hint = "Use thinner layers (path.layer_um) or a slower scan (path.speed_um_s), or allow more."
        return Decision(message, missed=why, hint=hint)

    def _missed(self, fault: str, message: str) -> Decision:
        """Return the end by a row of the faults, with what was reached."""
        depth_um = 0.0 if self._result is None else self._result.depth_um
        reached = f"a floor {depth_um:.2f} of {self._target.depth_um:g} µm deep"
        decision = decisions.missed_by_fault(fault, f" The channel ended early ({message}) at {reached}.")
        self._run.warn(RunEvent.TARGET_MISSED, decision.message, {"depth_um": depth_um})
        return decision

    def _is_due(self, layers_after: int) -> bool:
        """Return whether to measure after the next layer, by how well the length of the tool is known."""
        if not self._is_gap_learned and self._layers.layers + 1 >= LAYERS_BEFORE_FIRST_STOP:
            return True
        unknown = self._layers.wear_u_um / self._target.tolerance_um
        return unknown > 0.5 or (layers_after == 1 and unknown > 0.25)

    def _measure(self, places: int) -> ChannelResult:
        layers = self._layers
        if layers.last is None:
            raise ValueError("nothing was cut")
        plan, done = layers.last
        measured = measure_floor(self._run, self._surface, plan, done, layers.wear, layers.since_uj, places)
        uneven_um = abs(plan.held.depth_um - layers.depth_um) if done.fault else 0.0
        layers.learn(measured)
        self._is_gap_learned |= done.held
        return self._take(measured, uneven_um)

    def _resume(self, state: JobState) -> ChannelResult:
        """Touch floor and pad as an earlier run left them. Raises PreconditionError E8060, E8061."""
        run, layers, left = self._run, self._layers, state.channel
        # A held tool cuts no deeper than its layer in the end.
        unseen_um = left["aim_um"] - left["depth_um"]
        if state.machining_time_s >= PERIOD_S:
            unseen_um = planning.FASTER * PERIOD_S * (state.depth_um + state.wear_um) / state.machining_time_s
        expected = planning.ExpectedHole(planning.estimate_left(state), unseen_um)
        self._stops, self._is_gap_learned = int(left["stops"]), bool(left["gap_learned"])
        layers.sums = CutTotals(state.cuts, state.counts, state.energy_j, state.machining_time_s)
        layers.layers, layers.gap_um = int(left["layers"]), left["gap_um"]
        layers.depth_um, layers.aim_um = left["depth_um"], left["aim_um"]
        layers.wear.per_uj, layers.wear.u_rel = left["wear_per_uj"], left["wear_u_rel"]
        layers.wear.restart(state.wear_um)
        run.tally.depth_um, run.tally.unmeasured_site = state.depth_um, run.profile.meta.name
        # The last pass as far as it is known, with a tool that was not held.
        held = HeldTool(self._surface.z1.z_um, self._surface.plane, layers.aim_um, layers.gap_um)
        limits_um = np.array([held.z_um((float(x), float(y)), state.wear_um) for x, y in self._way.points])
        plan = PassPlan(self._way, 0.0, held, uj_per_um=0.0, since_uj=0.0, rest_s=0.0)
        done = PassResult(limits_um, np.zeros(len(self._way.points)))
        step_um = layers.aim_um - layers.depth_um
        drift_um = planning.STANDARD_UNCERTAINTIES * pause_drift_u_um(run.job)
        # A mistake is to be found, not missed.
        pad_um = expected.reach_um(expected.estimate.wear) + drift_um + resuming.BEYOND_UM
        floor_um = expected.depth_reach_um + resuming.BEYOND_UM
        extra = (pad_um / BEYOND_SIGMAS, floor_um / BEYOND_SIGMAS, share_u(0.5 * step_um))
        try:
            measured = measure_floor(
                run, self._surface, plan, done, layers.wear, 0.0, PLACES_AT_THE_END, extra
            )
        except MachineFault as fault:
            if fault.code == NO_CONTACT:
                fault.hint += " Workpiece, place or tool may differ from those in the journal."
            raise
        self._refuse_other(expected, measured, step_um)
        layers.resume(measured)
        return self._take(measured, step_um)

    def _refuse_other(self, expected: planning.ExpectedHole, measured: FloorReading, step_um: float) -> None:
        """Record what was measured if it can be the channel, with a step of `step_um` between its places."""
        run, surface = self._run, self._surface
        even = measured.lengths(run, surface)
        widened = replace(even, depth=even.depth.widened(step_um), feed=even.feed.widened(step_um))
        untouched = planning.is_untouched(even) and measured.sd_um < FACE_SD_UM
        site = Place(run.profile.meta.name, self._path.x_um, self._path.y_um)
        resuming.refuse_other(run, site, expected, widened, untouched=untouched, begun=False)
        if untouched:
            # Hardly begun, or another workpiece, of whose surface only the floor is known.
            doubt_u_um = math.hypot(share_u(measured.depth_um), even.depth.u)
            surface.doubt_u_um = math.hypot(surface.doubt_u_um, doubt_u_um)
            run.keeper.surface_doubt_u_um = math.hypot(run.keeper.surface_doubt_u_um, doubt_u_um)
        resuming.report_resumed(run, expected.estimate, measured.depth_um, even.wear_um)

    def _take(self, floor: FloorReading, uneven_um: float) -> ChannelResult:
        """Take the result of a measurement cycle and all passes before it.

        After a pass that ended early the floor may be deeper by `uneven_um` where the tool was, which is at none of
        the touched places: the mean of the floor may be off by that.
        """
        run, layers, profile = self._run, self._layers, self._run.job.profile
        measured, basis = floor.lengths(run, self._surface, uneven_um), run.job.touch_basis
        self._stops += 1
        self._result = result = ChannelResult(
            name=profile.meta.name,
            length_um=self._way.length_um,
            width_um=channel_width_um(profile.tool.diameter_um, profile.work.side_gap_um),
            layers=layers.layers,
            **measured.columns(),
            passes=layers.sums.number,
            **layers.sums.columns(),
            floor_sd_um=floor.sd_um,
            z1_um=self._surface.z1.z_um,
            z3_um=floor.pad.z_um - measured.drift_um,
            working_gap_um=layers.gap_um,
            measuring_stops=self._stops,
            floor=floor.places,
            depth_basis=basis,
            wear_basis=basis,
            drift_correction_um=measured.drift_um,
            drift_left_u_um=measured.drift_left_u_um,
            drift_by_rests=measured.drift_by_rests,
        )
        layers.measured_u_um = result.wear_u_um
        run.tally.depth_um, run.tally.unmeasured_site = floor.depth_um, ""
        self.keep(result)
        self._keep_state(MEASURING)
        depth, wear = measured.depth, measured.wear
        figures = {"depth_um": depth.value, "depth_u95_um": depth.u95, "floor_sd_um": floor.sd_um}
        run.decide(
            RunEvent.CHANNEL_MEASURED,
            f"Floor {length(depth.value, depth.u95)} deep, {floor.sd_um:.2f} µm rms from place to place, wear "
            f"{length(wear.value, wear.u95)}; a held tool leaves a gap of {layers.gap_um:.2f} µm.",
            {**figures, "wear_um": wear.value, "wear_u95_um": wear.u95, "gap_um": layers.gap_um},
        )
        return result

    def _keep_state(self, phase: str = MACHINING) -> None:
        self._run.keeper.keep(phase, self, self._run.machine.time_s)

    def add_to(self, state: JobState, now_s: float) -> JobState:
        """Return the state of the job with that of the channel: its floor is between the last layer and the next."""
        run, layers = self._run, self._layers
        cut, pulse = run.tally.cut, run.profile.pulse
        since_uj = layers.since_uj + wearing_uj(planning.energy_of(pulse, cut))
        low_um, high_um = layers.depth_um, max(layers.depth_um, layers.aim_um)
        between_um = share_u(0.5 * (high_um - low_um))
        first_gap_u = GAP_GROWTH * first_gap_u_um(pulse.open_voltage_v)
        gap_u_um = FLOOR_U_UM if self._is_gap_learned else max(FLOOR_U_UM, first_gap_u)
        drift_um = run.uncertainty.drift_u_um_per_s * max(0.0, now_s - layers.since_s)
        unconfirmed_um = planning.BELIEF_U_REL * layers.wear.per_uj * since_uj
        wear_u_um = math.hypot(layers.wear.u_um(since_uj), unconfirmed_um, drift_um)
        cuts = layers.sums.number + (cut.time_s > 0.0)
        depth = Value(0.5 * (low_um + high_um), math.hypot(between_um, gap_u_um, wear_u_um))
        wear = Value(layers.wear.um(since_uj), wear_u_um)
        estimate = planning.lengths(depth, wear, math.hypot(between_um, gap_u_um, drift_um))
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
        return planning.with_cuts(state, cut, layers.sums, cuts, estimate)

    def leave(self) -> None:
        """Report by estimate what was cut since the last stop, if the channel ends before the next one.

        It may be as deep as the layer under way in places. The wear is by the energy of whole passes, and per depth
        at least as much as before. What was not touched may be wrong by all of it.
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
        depth = Value(depth_um, math.hypot(measured.depth_u_um, cut_um))
        wear = Value(measured.wear_um + worn_um, math.hypot(measured.wear_u_um + missed_um, worn_um))
        estimate = planning.lengths(depth, wear, math.hypot(measured.depth_u_um, cut_um, wear.u))
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
    """Machine the channel of the recipe; return the decision if it missed its target, else None."""
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
