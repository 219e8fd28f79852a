"""`edmctl jump-flush`: electrode jumps in free space, measured one by one."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import (
    AllowModelOption,
    CalibrationOption,
    DebugOption,
    DryRunOption,
    EventsOption,
    JsonOption,
    OutOption,
    PortOption,
    ProfileOption,
    QuietOption,
    RunIdOption,
    SeedOption,
    SetOption,
    SetupOption,
    WaitOption,
)
from edmctl.cli.outcome import Outcome, Output, run_command, stream_style
from edmctl.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.cli.alone import Warn
    from edmctl.cli.connected_run import Held
    from edmctl.cli.job import Plan
    from edmctl.cli.runfile import RunName
    from edmctl.console.style import Style
    from edmctl.procedures.job import Job
    from edmctl.procedures.jump_series import JumpSeries
    from edmctl.procedures.run import Run

MOST_JUMPS = 1000

CountOption = Annotated[
    int, typer.Option("--count", "-n", metavar="N", min=1, max=MOST_JUMPS, help="Jumps to make.")
]
HeightOption = Annotated[
    float | None, typer.Option("--height-um", metavar="UM", help="Instead of the profile's jump.height_um.")
]
SpeedOption = Annotated[
    float | None, typer.Option("--speed", metavar="UM_S", help="Instead of the profile's jump.speed_um_s.")
]
PeriodOption = Annotated[
    float | None, typer.Option("--period-s", metavar="S", help="Instead of the profile's jump.period_s.")
]


def jump_flush(
    profile: ProfileOption = None,
    count: CountOption = 10,
    height_um: HeightOption = None,
    speed: SpeedOption = None,
    period_s: PeriodOption = None,
    overrides: SetOption = None,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
    seed: SeedOption = None,
    calibration: CalibrationOption = None,
    allow_model: AllowModelOption = False,
    out: OutOption = Path("runs"),
    run_id: RunIdOption = None,
    dry_run: DryRunOption = False,
    as_json: JsonOption = False,
    events: EventsOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Make electrode jumps; report their height and the way back.

    The tool jumps beside the work, as low as at the end of the profile's job, and without sparks. The sensor is
    sampled a thousand times a second, and tells how well and how soon the tool is back.
    """

    def body(outcome: Outcome) -> None:
        from edmctl.cli.alone import Asked, perform
        from edmctl.cli.job import Order, check

        changes = [
            f"jump.{key}={value!r}"
            for key, value in (("height_um", height_um), ("speed_um_s", speed), ("period_s", period_s))
            if value is not None
        ]
        # Jumps at a fixed period, whatever a job does about them, and every sample of them.
        everything = (*(overrides or ()), *changes, 'jump.mode="fixed"', "log.servo_hz=1000")
        plan = check(Order(profile, everything, setup, port, calibration, allow_model, wait))
        outcome.simulated = plan.simulated
        outcome.warn(plan.loaded.warnings)
        _refuse_hurry(plan)
        if dry_run:
            _tell_plan(outcome, plan, count)
        else:
            perform(outcome, plan, _Jumps(plan, count), Asked(out, run_id, seed))

    return run_command(Output("jump-flush", as_json, events, quiet, debug), body)


def _refuse_hurry(plan: "Plan") -> None:
    """Raise UsageError E2060 where the jumps follow so fast that the tool is never seen at rest."""
    from edmctl.procedures.jump_series import least_period_s

    jump = plan.loaded.profile.jump
    least_s = least_period_s(jump.height_um, jump.speed_um_s, jump.dwell_s)
    if jump.period_s < least_s:
        raise UsageError(
            f"A jump every {jump.period_s:g} s leaves no time to see the tool come to rest.",
            hint=f"Take --period-s {least_s:.1f} or more.",
            code="E2060",
        )


def _depth_um(plan: "Plan") -> float:
    """Displacement at the end of the job."""
    return plan.loaded.profile.approach.offset_um + plan.forecast.feed_um


def _tell_plan(outcome: Outcome, plan: "Plan", count: int) -> None:
    from edmctl.console.jump_table import render_jump_plan
    from edmctl.procedures.jump_series import SETTLE_AT_DEPTH_S
    from edmctl.profile.measuring_time import conditioning_time_s, jumps_time_s

    profile = plan.loaded.profile
    jump = profile.jump
    before_s = conditioning_time_s(profile, plan.setup) + SETTLE_AT_DEPTH_S
    forecast = {
        "count": count,
        "height_um": jump.height_um,
        "speed_um_s": jump.speed_um_s,
        "dwell_s": jump.dwell_s,
        "period_s": jump.period_s,
        "from_um": _depth_um(plan),
        "time_s": before_s + jumps_time_s(profile, count, jump.period_s),
    }
    outcome.result = {"forecast": forecast}
    outcome.text = render_jump_plan(forecast, stream_style(sys.stdout))


@dataclass(slots=True)
class _Jumps:
    """One series of jumps."""

    plan: "Plan"
    count: int
    series: "JumpSeries | None" = None
    name: str = "jump-flush"
    pulses: bool = False

    def job(self, held: "Held", name: "RunName", warn: "Warn") -> "Job":
        """Return the profile's job; nothing of it is done but its jumps."""
        from edmctl.cli.home_known import with_home
        from edmctl.cli.prepared import logbook_of
        from edmctl.procedures.job import job_of
        from edmctl.record.bookkeeping import books_of

        choice, logbook = held.choice, logbook_of(self.plan, name)
        job = job_of(self.plan.loaded.profile, self.plan.setup, (), choice.actuator if choice else None)
        if logbook is None:
            return job
        books = books_of(logbook.lines, held.bench.machine.identity.serial)
        return with_home(job, books, held.bench.now)

    def act(self, run: "Run") -> None:
        """Jump."""
        from edmctl.procedures.jump_series import run_jumps

        self.series = run_jumps(run, _depth_um(self.plan), self.count)

    def close(self, time_s: float) -> None:
        """Nothing was touched: there is nothing to keep."""

    def result(self) -> "Mapping[str, object] | None":
        """Every jump, and the summary."""
        return asdict(self.series) if self.series else None

    def render(self, style: "Style") -> str:
        """The same as a table."""
        from edmctl.console.jump_table import render_jumps

        assert self.series is not None
        return render_jumps(self.series, style)
