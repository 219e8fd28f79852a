"""`edmctl jump-flush`: electrode jumps in free space, measured one by one."""

import sys
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
from edmctl.cli.shell import shell

if TYPE_CHECKING:
    from edmctl.console.style import Style
    from edmctl.jobs.plan import Plan

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
        from edmctl.cli.procedure_output import Asked, perform_told
        from edmctl.console.procedure_tables import render_jumps
        from edmctl.jobs.checking import check
        from edmctl.jobs.jump_flush import JUMPS_ALONE, Jumps, refuse_hurry
        from edmctl.jobs.plan import JobRequest

        changes = [
            f"jump.{key}={value!r}"
            for key, value in (("height_um", height_um), ("speed_um_s", speed), ("period_s", period_s))
            if value is not None
        ]
        everything = (*(overrides or ()), *changes, *JUMPS_ALONE)
        plan = check(JobRequest(profile, everything, setup, port, calibration, allow_model, wait), shell())
        outcome.simulated = plan.simulated
        outcome.warn(plan.loaded.warnings)
        refuse_hurry(plan)
        if dry_run:
            _tell_plan(outcome, plan, count)
        else:
            jumps = Jumps(plan, count)

            def render(style: "Style") -> str:
                assert jumps.series is not None
                return render_jumps(jumps.series, style)

            perform_told(outcome, plan, jumps, Asked(out, run_id, seed), render)

    return run_command(Output("jump-flush", as_json, events, quiet, debug), body)


def _tell_plan(outcome: Outcome, plan: "Plan", count: int) -> None:
    from edmctl.console.procedure_tables import render_jump_plan
    from edmctl.forecasts.measuring_time import conditioning_time_s, jumps_time_s
    from edmctl.jobs.jump_flush import end_um
    from edmctl.procedures.jump_series import SETTLE_AT_DEPTH_S

    profile = plan.loaded.profile
    jump = profile.jump
    before_s = conditioning_time_s(profile, plan.setup) + SETTLE_AT_DEPTH_S
    forecast = {
        "count": count,
        "height_um": jump.height_um,
        "speed_um_s": jump.speed_um_s,
        "dwell_s": jump.dwell_s,
        "period_s": jump.period_s,
        "from_um": end_um(plan),
        "time_s": before_s + jumps_time_s(profile, count, jump.period_s),
    }
    outcome.result = {"forecast": forecast}
    outcome.text = render_jump_plan(forecast, stream_style(sys.stdout))
