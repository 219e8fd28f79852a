"""One cut: the controller runs the servo; the host watches, jumps, changes servo and pulses, and answers burns.

After an arc that burned in one place the controller has switched the pulses off and retracted. The first burn of a
cut costs the way back; after the second the gap is kept wider and the pulses pause longer; then the cut is given up.
"""

from __future__ import annotations

import math
from enum import StrEnum

from edmctl.actuator.inverse import jump_volts
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import MachineFault
from edmctl.machine.interface import CutRequest, EventCode, JumpRequest, MachineEvent
from edmctl.planning.removal import approach_speed_um_s, least_jump_um
from edmctl.procedures.hole.cut_planning import CutPlan
from edmctl.procedures.job import Counts
from edmctl.procedures.run import Args, JobRun
from edmctl.procedures.servo.limits import TimeLeft
from edmctl.procedures.servo.supervisor import StopReason, Supervisor
from edmctl.procedures.settings import pulse_settings
from edmctl.procedures.touch.approach import ABOVE_BOTTOM_UM, BEYOND_BOTTOM_UM, UNKNOWN_SDS, lower_to
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.results.telemetry import pulse_shares

STATUS_PERIOD_S = 5.0  # period of requests for the state of the dielectric; the controller itself guards it
SPARKLESS_UM = 1.0  # a cut that ends further beyond its last discharge did not cut that way; usual: 0.2 µm
JUMP_RESERVE_UM = 5.0  # displacement that a jump leaves, because the actuator cannot go below 0 V
LEAST_JUMP_UM = 10.0
FLUSHING_HEIGHTS = 2.0  # least height of a jump, relative to that which refills the gap beside the tool
LEAST_S = 0.05  # a resumed cut gets at least this time, so that the controller itself ends it
CLEARANCE_UM = 1.0  # a jump returns fast to this far above the last spark; 5 µm lose 0.3 s (decision 0021)
ARC_BURN, NO_SPARK = "E63002", "E63005"
REST_S = 0.2
REFERENCE_STEP = 0.05
DUTY_SHARE = 0.8
AGAIN_S = 10.0  # a third burn within this sparking time after the last one ends the cut,
MOST_BURNS = 6  # and so does this number of burns


class CutEnd(StrEnum):
    """How a cut ended."""

    REACHED = "feed reached"
    TIME_UP = "time limit"
    GIVEN_UP = "given up"


@dataclass(frozen=True, slots=True)
class CutResult:
    """Result of a cut. `counts` are its pulses by class: open, normal, arc, short; `energy_j` as in SiteResult.

    `is_at_limit`: the tool sparked at the feed limit in the end, so its gap to the bottom is a working gap.
    `fault` names the row of the faults that ended it, empty if none did; `message` has the figures of that.
    `breakthrough_um` is the displacement at which the sheet broke through, NaN if it did not.
    """

    end: CutEnd
    reason: str
    time_s: float
    end_displacement_um: float
    counts: Counts
    gap_ratio_mean: float
    energy_j: float
    is_at_limit: bool
    fault: str = ""
    message: str = ""
    breakthrough_um: float = math.nan

    @property
    def through(self) -> bool:
        return not math.isnan(self.breakthrough_um)


class Cut:
    """One planned cut, while there is time left."""

    def __init__(self, run: JobRun, plan: CutPlan, time_left: TimeLeft) -> None:
        self._run, self._plan, self._time_left = run, plan, time_left
        self._duty = run.profile.pulse.duty
        self._start_s = run.machine.time_s
        self._supervisor = Supervisor(run, plan, self._start_s)
        self._burns, self._last_burn_s = 0, -math.inf

    @property
    def _open_v(self) -> float:
        """Mean gap voltage of an all-open gap with the duty in use, V."""
        return self._supervisor.adaptive.duty * self._run.profile.pulse.open_voltage_v

    @property
    def _reference_v(self) -> float:
        """Mean gap voltage that the servo is to keep, V."""
        return self._supervisor.adaptive.reference * self._open_v

    def run(self) -> CutResult:
        """Machine to the plan's limit; the tool is then held with the pulses off."""
        run, plan, supervisor = self._run, self._plan, self._supervisor
        gap_um, wear_ratio = plan.start.gap_um, plan.estimate.wear_ratio
        args: Args = {
            "cut": plan.number,
            "feed_um": plan.feed_um,
            "z_limit_um": plan.z_limit_um,
            "gap_um": gap_um,
            "wear_ratio": wear_ratio,
        }
        if not math.isnan(plan.target_um):
            args = {**args, "target_um": plan.target_um}
        run.decide(
            RunEvent.CUT_PLANNED,
            f"Cut {plan.number}: feed {plan.feed_um:.1f} µm to {plan.z_limit_um:.1f} µm, expecting a gap of "
            f"{gap_um:.2f} µm and {wear_ratio:.3f} µm wear per µm depth.",
            args,
        )
        run.watch.follow(supervisor.on_telemetry)
        try:
            self._start()
            ended = self._watch()
            self._set_duty(run.profile.pulse.duty)
        finally:
            run.watch.follow(None)
        result = self._result(ended)
        shares = pulse_shares(*result.counts)
        run.decide(
            RunEvent.CUT_ENDED,
            f"Cut {plan.number} ended after {result.time_s:.1f} s at {result.end_displacement_um:.1f} µm "
            f"({result.reason}); {100 * shares.normal:.0f} % normal, {100 * shares.arc:.1f} % arcs, "
            f"{100 * shares.short:.1f} % shorts.",
            {
                "cut": plan.number,
                "time_s": result.time_s,
                "z_um": result.end_displacement_um,
                "pulses": sum(result.counts),
                "jumps": supervisor.jumps,
            },
            level=EventLevel.INFO if result.end is CutEnd.REACHED else EventLevel.WARNING,
        )
        return result

    def _start(self) -> None:
        """Start the servo, with the reference and the pulses in use."""
        machine, supervisor = self._run.machine, self._supervisor
        self._set_duty(supervisor.adaptive.duty)
        supervisor.reference_v, supervisor.duty_v = self._reference_v, self._open_v
        left_s = max(LEAST_S, self._start_s + self._time_left.seconds - machine.time_s)
        machine.start_cut(CutRequest(self._reference_v, self._plan.z_limit_um, left_s))

    def _report_changes(self) -> bool:
        """Record the changes of the adaptive control; return whether the cut has to be restarted for them."""
        run, changes = self._run, self._supervisor.adaptive.changes
        for change in changes:
            if change.code is RunEvent.JUMP_PERIOD:
                run.note(change.code, change.message, change.args, EventLevel.DEBUG)
            else:
                run.decide(change.code, change.message, change.args)
        is_restart = any(change.code is not RunEvent.JUMP_PERIOD for change in changes)
        changes.clear()
        return is_restart

    def _watch(self) -> MachineEvent:
        while True:
            try:
                return self._watch_sparks()
            except MachineFault as fault:
                if fault.code == NO_SPARK:
                    fault.hint += (
                        " Check with `edmctl approach --contact`: contact near "
                        f"{self._supervisor.displacement_um:.0f} µm means that the tool is there and no pulses "
                        "reach it; no contact, that it is lost or broken."
                    )
                    raise
                self.recover(fault)

    def recover(self, fault: MachineFault) -> None:
        """Continue the cut after a burn; raise any other fault, and one burn too many."""
        while True:
            if fault.code != ARC_BURN:
                raise fault
            spark_s = self._supervisor.sparking_s
            self._burns += 1
            is_soon = spark_s - self._last_burn_s < AGAIN_S
            if self._burns >= MOST_BURNS or (self._burns > 2 and is_soon):
                raise fault
            self._last_burn_s = spark_s
            try:
                return self._come_back(fault.fault)
            except MachineFault as again:
                fault = again

    def _come_back(self, code: int) -> None:
        """Clear a burn, and approach again."""
        run, supervisor, start = self._run, self._supervisor, self._plan.start
        # Where the tool sparked, and how far from there the bottom may be now: by the drift since the last sample.
        spark_um = supervisor.displacement_um
        since_s = run.machine.time_s - supervisor.seen_s
        unknown_um = UNKNOWN_SDS * start.drift_u_um_per_s * max(0.0, since_s)
        if math.isnan(spark_um):
            u_um = math.hypot(start.bottom_u_at(run.machine.time_s), start.gap_u_um)
            spark_um, unknown_um = start.bottom_um - start.gap_um, UNKNOWN_SDS * u_um
        run.warn(
            RunEvent.ARC_BURN_RECOVERY,
            f"Burn {self._burns} of this cut, at {spark_um:.1f} µm: the tool has retracted, rests and comes back.",
            {"burn": self._burns, "displacement_um": spark_um},
        )
        run.machine.clear_fault(code)
        run.machine.arm()
        if self._burns > 1:
            supervisor.adaptive.soften(REFERENCE_STEP, DUTY_SHARE, f"burn {self._burns} of this cut")
            self._report_changes()
        run.machine.rest(REST_S)
        self._set_duty(supervisor.adaptive.duty)
        lower_to(run, spark_um - ABOVE_BOTTOM_UM - unknown_um)
        way_um = spark_um - run.watch.displacement_um + BEYOND_BOTTOM_UM + unknown_um
        first_sparks_v = 0.5 * (self._open_v + self._reference_v)
        run.machine.approach(approach_speed_um_s(run.profile), way_um, first_sparks_v)
        self._start()

    def _watch_sparks(self) -> MachineEvent:
        run, supervisor = self._run, self._supervisor
        next_status_s = run.machine.time_s
        while True:
            ended = run.machine.watch_cut(supervisor.slice_s(run.machine.time_s))
            if ended is not None:
                return ended
            if run.machine.time_s >= next_status_s:
                supervisor.status = run.machine.status()
                next_status_s += STATUS_PERIOD_S
            if supervisor.stop_reason is not None:
                ended = run.machine.stop_cut()
                # Recorded after the pulses are off, because writing takes time.
                said = f": {supervisor.message}" if supervisor.message else ""
                args = {"displacement_um": supervisor.displacement_um}
                message = f"{supervisor.stop_reason}{said}"
                run.note(RunEvent.CUT_GIVEN_UP, message, args, EventLevel.WARNING)
                return ended
            if supervisor.is_complete:
                return run.machine.stop_cut()
            if self._report_changes():
                ended = run.machine.stop_cut()
                if ended.code is not EventCode.STOPPED:
                    return ended
                self._start()
            self._jump_if_due()

    def _jump_if_due(self) -> None:
        """Jump as high as the hole needs and the displacement allows, if a jump is due."""
        run, supervisor, adaptive = self._run, self._supervisor, self._supervisor.adaptive
        profile, displacement_um = run.profile, supervisor.displacement_um
        due = supervisor.jump_due(run.machine.time_s)
        if due is None:
            return
        code, reason = due
        height_um = 0.0
        if not math.isnan(displacement_um):
            height_um = profile.jump.height_um
            if profile.jump.mode == "adaptive" or code is not RunEvent.JUMPED:
                depth_um = self._plan.at(displacement_um).depth_um
                least_um = least_jump_um(depth_um, profile.tool.diameter_um, profile.work.side_gap_um)
                height_um = max(height_um, FLUSHING_HEIGHTS * least_um)
            height_um = min(height_um, displacement_um - JUMP_RESERVE_UM)
        if height_um >= LEAST_JUMP_UM:
            run.machine.jump(jump_request(run, height_um))
            supervisor.jumps, supervisor.last_jump_s = supervisor.jumps + 1, run.machine.time_s
            message = f"Jump of {height_um:.0f} µm: {reason}."
            if code is not RunEvent.JUMPED:
                run.decide(code, message, {"height_um": height_um})
            else:
                args: Args = {
                    "height_um": height_um,
                    "period_s": adaptive.period_s,
                    "arcs": round(adaptive.since_jump.arcs, 5),
                    "shorts": round(adaptive.since_jump.shorts, 5),
                    "asked": " and ".join(adaptive.asking),
                    **{f"asking_{name}": round(share, 5) for name, share in adaptive.asking.items()},
                }
                run.note(code, message, args, EventLevel.DEBUG)
        supervisor.jumped(code, run.machine.time_s)

    def _set_duty(self, duty: float) -> None:
        if duty == self._duty:
            return
        pulses = pulse_settings(self._run.profile)
        off_time_us = pulses.on_time_us * (1.0 / duty - 1.0)
        self._run.machine.set_pulses(replace(pulses, off_time_us=off_time_us))
        self._run.watch.set_duty_voltage(duty * pulses.open_voltage_v)
        self._duty = duty

    def _result(self, ended: MachineEvent) -> CutResult:
        supervisor, limit_um = self._supervisor, self._plan.z_limit_um
        ends = {EventCode.CUT_DONE: CutEnd.REACHED, EventCode.TIME_UP: CutEnd.TIME_UP}
        end = ends.get(ended.code, CutEnd.GIVEN_UP)
        at_limit, reason, fault, message = end is CutEnd.REACHED, end.value, "", ""
        if supervisor.stop_reason is not None:
            rows = {StopReason.STALLED: "STALL", StopReason.ENDED: "STROKE_END"}
            reason, message = supervisor.stop_reason.value, supervisor.message
            fault = rows.get(supervisor.stop_reason, "")
        elif supervisor.is_complete:
            end, reason = CutEnd.REACHED, "through"
        if end is CutEnd.TIME_UP:
            fault, message = "TIMEOUT", self._time_left.limit
        # At CUT_DONE the controller's low-passed sensor read the limit, unless the tool went without sparks.
        end_um = limit_um if at_limit else ended.displacement_um
        if not supervisor.is_through and end_um - supervisor.sparked_at_um > SPARKLESS_UM:
            end_um = supervisor.sparked_at_um
        return CutResult(
            end=end,
            reason=reason,
            time_s=ended.time_s - self._start_s,
            end_displacement_um=end_um,
            is_at_limit=at_limit and end_um == limit_um,
            counts=supervisor.counts,
            gap_ratio_mean=supervisor.gap_ratio_mean,
            energy_j=supervisor.energy_j,
            fault=fault,
            message=message,
            breakthrough_um=supervisor.breakthrough.at_um,
        )


def jump_request(run: JobRun, height_um: float, clearance_um: float = CLEARANCE_UM) -> JumpRequest:
    """Return a jump of `height_um` at the profile's speed that returns fast to `clearance_um`, 0 for all the way.

    The controller converts lengths to volts by `gain_um_per_v`, but after a turning point the actuator moves far
    less per volt: 60 µm become 41. So the voltages by the actuator model × mean gain are sent. The speed is scaled
    alike, so that the jump takes the time that the profile states.
    """
    jump, gain_um_per_v = run.profile.jump, run.setup.actuator.gain_um_per_v
    estimator = run.watch.estimator()
    if estimator is None:
        return JumpRequest(height_um, jump.speed_um_s, jump.dwell_s, clearance_um)
    volts = jump_volts(estimator, height_um, clearance_um, height_um / jump.speed_um_s, jump.dwell_s)
    sent_um = gain_um_per_v * volts.height_v
    return JumpRequest(
        height_um=sent_um,
        speed_um_s=jump.speed_um_s * max(1.0, sent_um / height_um),
        dwell_s=jump.dwell_s,
        clearance_um=gain_um_per_v * volts.clearance_v if clearance_um else 0.0,
    )
