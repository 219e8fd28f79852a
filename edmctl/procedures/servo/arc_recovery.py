"""What follows an arc that burned in one place: rest, come back; after the next one gentler; then give up.

The controller has switched the pulses off, retracted and latched its fault. The first burn of a cut costs no more
than the way back; after the second the gap is kept wider and the pulses pause longer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.errors import MachineFault
from edmctl.procedures.event_codes import RunEvent
from edmctl.procedures.touch.approach import ABOVE_BOTTOM_UM, BEYOND_BOTTOM_UM, UNKNOWN_SDS, lower_to
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut_planning import CutPlan
    from edmctl.procedures.hole.running_cut import CutControl
    from edmctl.procedures.run import JobRun
    from edmctl.procedures.servo.supervisor import Supervisor

ARC_BURN, NO_SPARK = "E63002", "E63005"
REST_S = 0.2
REFERENCE_STEP = 0.05
DUTY_SHARE = 0.8
AGAIN_S = 10.0
"""A third burn within so much sparking after the one before cannot be helped,"""
MOST_BURNS = 6
"""and neither can so many in one cut."""


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
        run.machine.approach(run.profile.approach.speed_um_s, way_um, first_sparks_v)
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
