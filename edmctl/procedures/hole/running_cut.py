"""A cut under way: it jumps, and it is stopped and gone on with where servo or generator change, and after a burn.

What follows an arc that burned in one place: rest, come back; after the next one gentler; then give up. The
controller has switched the pulses off, retracted and latched its fault. The first burn of a cut costs no more than
the way back; after the second the gap is kept wider and the pulses pause longer.
"""

from __future__ import annotations

import math

from edmctl.actuator.inverse import jump_volts
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import MachineFault
from edmctl.machine.interface import CutRequest, EventCode, JumpRequest, MachineEvent
from edmctl.planning.removal import approach_speed_um_s, least_jump_um
from edmctl.procedures.hole.cut_planning import CutPlan
from edmctl.procedures.job import target_of
from edmctl.procedures.run import Args, JobRun
from edmctl.procedures.servo.supervisor import Supervisor
from edmctl.procedures.settings import pulse_settings
from edmctl.procedures.touch.approach import ABOVE_BOTTOM_UM, BEYOND_BOTTOM_UM, UNKNOWN_SDS, lower_to
from edmctl.record.rows import EventLevel, EventRow, RunEvent

JUMP_RESERVE_UM = 5.0
"""A jump leaves this much displacement, because the actuator cannot go below 0 V."""
LEAST_JUMP_UM = 10.0
FLUSHING_HEIGHTS = 2.0
"""A jump is at least so many times as high as it takes to refill the gap beside the tool once."""
LEAST_S = 0.05
"""A cut that goes on is given this much, so that the controller itself ends it."""
CLEARANCE_UM = 1.0
"""A jump comes back fast to this far above the last spark point, with a working gap of some µm still below it. From
5 µm the servo took 0.3 s to find its gap again; the actuator comes back within 0.4 µm (decision 0021)."""
ARC_BURN, NO_SPARK = "E63002", "E63005"
REST_S = 0.2
REFERENCE_STEP = 0.05
DUTY_SHARE = 0.8
AGAIN_S = 10.0
"""A third burn within so much sparking after the one before cannot be helped,"""
MOST_BURNS = 6
"""and neither can so many in one cut."""


class CutControl:
    """One planned cut that may last until `end_s`."""

    def __init__(self, run: JobRun, plan: CutPlan, supervisor: Supervisor, end_s: float) -> None:
        self._run = run
        self._plan = plan
        self._supervisor = supervisor
        self._end_s = end_s
        self._completion_um = target_of(run.profile).completion_um
        self._duty = run.profile.pulse.duty
        self.jumps = 0

    @property
    def open_v(self) -> float:
        """Mean gap voltage of an all-open gap with the duty in use, V."""
        return self._supervisor.adaptive.duty * self._run.profile.pulse.open_voltage_v

    @property
    def reference_v(self) -> float:
        """Mean gap voltage that the servo is to hold, V."""
        return self._supervisor.adaptive.reference * self.open_v

    @property
    def is_complete(self) -> bool:
        """Whether the sheet has broken through, and the tip has followed."""
        supervisor = self._supervisor
        return supervisor.displacement_um >= supervisor.breakthrough.at_um + self._completion_um

    def start(self) -> None:
        """Let the servo go, with the reference and the pulses in use."""
        run = self._run
        self.set_generator()
        self._supervisor.reference_v, self._supervisor.duty_v = self.reference_v, self.open_v
        left_s = max(LEAST_S, self._end_s - run.machine.time_s)
        run.machine.start_cut(CutRequest(self.reference_v, self._plan.z_limit_um, left_s))

    def set_generator(self) -> None:
        """Tell the generator the duty in use where it has another one."""
        if self._supervisor.adaptive.duty != self._duty:
            self._set_duty(self._supervisor.adaptive.duty)

    def report_changes(self) -> bool:
        """Write down what the law has changed; whether the cut has to be started anew for it."""
        run, changes = self._run, self._supervisor.adaptive.changes
        if not changes:
            return False
        anew = False
        for change in changes:
            if change.code is RunEvent.JUMP_PERIOD:
                level = EventLevel.DEBUG
                run.recorder.append(
                    EventRow(run.machine.time_s, change.code, level, change.message, change.args)
                )
            else:
                run.decide(change.code, change.message, change.args)
                anew = True
        changes.clear()
        return anew

    def retune(self) -> MachineEvent | None:
        """Carry out what the law has changed; the end of the cut where it ended meanwhile."""
        if not self.report_changes():
            return None
        ended = self._run.machine.stop_cut()
        if ended.code is not EventCode.STOPPED:
            return ended
        self.start()
        return None

    def jump_if_due(self) -> None:
        """Jump where there is a reason, as high as the hole needs and the displacement allows."""
        run, supervisor = self._run, self._supervisor
        due = supervisor.jump_due(run.machine.time_s)
        if due is None:
            return
        code, reason = due
        height_um = self._height_um(code)
        if height_um >= LEAST_JUMP_UM:
            run.machine.jump(jump_request(run, height_um))
            self.jumps += 1
            supervisor.jumps, supervisor.last_jump_s = self.jumps, run.machine.time_s
            self._report_jump(code, reason, height_um)
        supervisor.jumped(code, run.machine.time_s)

    def _report_jump(self, code: RunEvent, reason: str, height_um: float) -> None:
        run, adaptive = self._run, self._supervisor.adaptive
        message = f"Jump of {height_um:.0f} µm: {reason}."
        if code is not RunEvent.JUMPED:
            run.decide(code, message, {"height_um": height_um})
            return
        args: Args = {
            "height_um": height_um,
            "period_s": adaptive.period_s,
            "arcs": round(adaptive.arcs, 5),
            "shorts": round(adaptive.shorts, 5),
            "asked": " and ".join(adaptive.asking),
            **{f"asking_{name}": round(share, 5) for name, share in adaptive.asking.items()},
        }
        run.recorder.append(EventRow(run.machine.time_s, code, EventLevel.DEBUG, message, args))

    def finish(self) -> None:
        """Leave the generator as the recipe wants it, for what comes after the cut."""
        if self._duty != self._run.profile.pulse.duty:
            self._set_duty(self._run.profile.pulse.duty)

    def _set_duty(self, duty: float) -> None:
        """Pulses of the same length with other pauses between them."""
        pulses = pulse_settings(self._run.profile)
        off_time_us = pulses.on_time_us * (1.0 / duty - 1.0)
        self._run.machine.set_pulses(replace(pulses, off_time_us=off_time_us))
        self._run.watch.set_duty_voltage(duty * pulses.open_voltage_v)
        self._duty = duty

    def _height_um(self, code: RunEvent) -> float:
        profile, displacement_um = self._run.profile, self._supervisor.displacement_um
        if math.isnan(displacement_um):
            return 0.0
        height_um = profile.jump.height_um
        if profile.jump.mode == "adaptive" or code is not RunEvent.JUMPED:
            depth_um = self._plan.depth_at(displacement_um)
            least_um = least_jump_um(depth_um, profile.tool.diameter_um, profile.work.side_gap_um)
            height_um = max(height_um, FLUSHING_HEIGHTS * least_um)
        return min(height_um, displacement_um - JUMP_RESERVE_UM)


def jump_request(run: JobRun, height_um: float, clearance_um: float = CLEARANCE_UM) -> JumpRequest:
    """Ask for a jump of `height_um` at the profile's speed that comes back fast to `clearance_um`.

    JUMP carries lengths, and the controller turns them into volts by `gain_um_per_v`, without an actuator model.
    After a turning point the actuator moves far less per volt than that: 60 µm come out as 41. So the host asks its
    model for the voltages of the jump wanted, and sends voltage × mean gain; without a model the mean gain alone
    counts. The speed on the wire grows with the height on the wire, so that the jump takes the time that the profile
    says. One without a clearance comes back to the voltage where it began.
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


@dataclass(slots=True, eq=False)
class ArcRecovery:
    """The burns of one cut, and the answer to each."""

    run: JobRun
    plan: CutPlan
    supervisor: Supervisor
    control: CutControl
    _number: int = 0
    _last_s: float = -math.inf

    def answer(self, fault: MachineFault) -> None:
        """Go on with the cut after a burn; every other fault, and one burn too many, is raised again."""
        while True:
            if fault.code != ARC_BURN:
                raise fault
            spark_s = self.supervisor.sparking_s
            self._number += 1
            soon = spark_s - self._last_s < AGAIN_S
            if self._number >= MOST_BURNS or (self._number > 2 and soon):
                raise fault
            self._last_s = spark_s
            try:
                self._go_on(fault.fault)
            except MachineFault as again:
                fault = again
            else:
                return

    def _go_on(self, code: int) -> None:
        run, supervisor = self.run, self.supervisor
        spark_um, unknown_um = self._sparked_at(run.machine.time_s)
        run.decide(
            RunEvent.ARC_BURN_RECOVERY,
            f"Burn {self._number} of this cut, at {spark_um:.1f} µm: the tool has retracted, rests and comes back.",
            {"burn": self._number, "displacement_um": spark_um},
            level=EventLevel.WARNING,
        )
        run.machine.clear_fault(code)
        run.machine.arm()
        if self._number > 1:
            supervisor.adaptive.soften(REFERENCE_STEP, DUTY_SHARE, f"burn {self._number} of this cut")
            self.control.report_changes()
        run.machine.rest(REST_S)
        self.control.set_generator()
        lower_to(run, spark_um - ABOVE_BOTTOM_UM - unknown_um)
        way_um = spark_um - run.watch.displacement_um + BEYOND_BOTTOM_UM + unknown_um
        first_sparks_v = 0.5 * (self.control.open_v + self.control.reference_v)
        run.machine.approach(approach_speed_um_s(run.profile), way_um, first_sparks_v)
        self.control.start()

    def _sparked_at(self, now_s: float) -> tuple[float, float]:
        """Return where the tool sparked, and how far from there it may find the bottom now.

        Seen by samples of this cut that is the drift since the last of them; without any it is what was planned.
        """
        seen_um, plan = self.supervisor.displacement_um, self.plan
        if math.isnan(seen_um):
            u_um = math.hypot(plan.start.bottom_u_at(now_s), plan.start.gap_u_um)
            return plan.start.bottom_um - plan.start.gap_um, UNKNOWN_SDS * u_um
        since_s = max(0.0, now_s - self.supervisor.seen_s)
        return seen_um, UNKNOWN_SDS * plan.start.drift_u_um_per_s * since_s


def with_a_check(fault: MachineFault, displacement_um: float) -> MachineFault:
    """Return the fault of lost sparks with the way to tell a lost tool from missing pulses."""
    hint = (
        f"{fault.hint} `edmctl approach --contact` tells which it is: contact near {displacement_um:.0f} µm means "
        "that the tool is there and no pulses reach it; no contact, that it is lost or broken."
    )
    return MachineFault(fault.message, hint=hint, code=fault.code, fault=fault.fault)
