"""`jump-flush` on a connected machine: jumps beside the work, as low as at the end of a job."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from edmctl.errors import UsageError
from edmctl.jobs.job_preparation import logbook_of
from edmctl.jobs.ledger.last_home import with_home
from edmctl.procedures.job import job_of
from edmctl.procedures.jump_series import least_period_s, run_jumps
from edmctl.record.tool_account import books_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.jobs.plan import Plan
    from edmctl.jobs.procedure_command import Warn
    from edmctl.jobs.run_header import RunName
    from edmctl.jobs.session import MachineSession
    from edmctl.procedures.job import Job
    from edmctl.procedures.run import JobRun
    from edmctl.results.measurements import JumpSeries

JUMPS_ALONE = ('jump.mode="fixed"', "log.servo_hz=1000")
"""Jumps at a fixed period, whatever a job does about them, and every sample of them."""


def refuse_hurry(plan: Plan) -> None:
    """Raise UsageError E2060 where the jumps follow so fast that the tool is never seen at rest."""
    jump = plan.loaded.profile.jump
    least_s = least_period_s(jump.height_um, jump.speed_um_s, jump.dwell_s)
    if jump.period_s < least_s:
        raise UsageError(
            f"A jump every {jump.period_s:g} s leaves no time to see the tool come to rest.",
            hint=f"Take --period-s {least_s:.1f} or more.",
            code="E2060",
        )


def end_um(plan: Plan) -> float:
    """Displacement at the end of the job."""
    return plan.loaded.profile.approach.offset_um + plan.forecast.feed_um


@dataclass(slots=True)
class Jumps:
    """One series of jumps."""

    plan: Plan
    count: int
    series: JumpSeries | None = None
    name: str = "jump-flush"
    pulses: bool = False

    def job(self, session: MachineSession, name: RunName, warn: Warn) -> Job:
        """Return the profile's job; nothing of it is done but its jumps."""
        choice, logbook = session.choice, logbook_of(self.plan, name)
        job = job_of(self.plan.loaded.profile, self.plan.setup, (), choice.actuator if choice else None)
        if logbook is None:
            return job
        books = books_of(logbook.lines, session.bench.machine.identity.serial)
        return with_home(job, books, session.bench.now)

    def act(self, run: JobRun) -> None:
        """Jump."""
        self.series = run_jumps(run, end_um(self.plan), self.count)

    def close(self, time_s: float) -> None:
        """Nothing was touched: there is nothing to keep."""

    def result(self) -> Mapping[str, object] | None:
        """Every jump, and the summary."""
        return asdict(self.series) if self.series else None
