"""`edmctl measure-wear`: what a tool has lost since its reference, and how deep its last hole is."""

import sys
from dataclasses import replace
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
    NewToolOption,
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
from edmctl.cli.outcome import Outcome, Output, note, run_command, stream_style
from edmctl.cli.shell import shell
from edmctl.errors import UsageError

if TYPE_CHECKING:
    from edmctl.console.style import Style
    from edmctl.jobs.plan import Plan
    from edmctl.jobs.wear.measure import WearRun

ReferenceOption = Annotated[
    bool, typer.Option("--reference", help="Touch the pad and keep it as Z1: do this before a job.")
]
SiteOption = Annotated[
    str | None,
    typer.Option(
        "--site", metavar="NAME|X,Y", help="The hole to touch; without, the last one that the tool made."
    ),
]


def measure_wear(
    reference: ReferenceOption = False,
    new_tool: NewToolOption = False,
    site: SiteOption = None,
    profile: ProfileOption = None,
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
    """Touch pad, hole and pad again: tool wear, depth and feed.

    They count from the reference, the first touch of a tool: that of its first job, or of --reference. It is kept in
    the job ledger beside the run files. Without a profile the tool last in use is meant.
    """

    def body(outcome: Outcome) -> None:
        from edmctl.cli.procedure_output import Asked, perform_told
        from edmctl.jobs.checking import check
        from edmctl.jobs.plan import JobRequest
        from edmctl.jobs.wear.measure import TOUCHES_LIKE, WearRun

        if new_tool and not reference:
            raise UsageError(
                "--new-tool goes with --reference: a tool that was changed has lost nothing yet.",
                hint="Say `edmctl measure-wear --reference --new-tool`.",
                code="E2062",
            )
        request = JobRequest(
            profile or TOUCHES_LIKE,
            tuple(overrides or ()),
            setup,
            port,
            calibration,
            allow_model,
            wait,
            new_tool,
        )
        plan = replace(check(request, shell()), names_tool=profile is not None)
        outcome.simulated = plan.simulated
        outcome.warn(plan.loaded.warnings)
        if dry_run:
            _forewarn(outcome, plan, WearRun(plan, site, is_reference=reference), out)
            _tell_plan(outcome, plan, reference=reference)
        else:
            run = WearRun(plan, site, is_reference=reference)
            perform_told(outcome, plan, run, Asked(out, run_id, seed), lambda style: _rendered(run, style))

    return run_command(Output("measure-wear", as_json, events, quiet, debug), body)


def _rendered(run: "WearRun", style: "Style") -> str:
    from edmctl.console.procedure_tables import render_reference, render_wear

    label = run.account.label
    if run.touched is not None:
        reading, model_um = run.touched.reading, run.touched.model_um
        return render_reference(label, reading.mean_um, reading.sd_um, reading.touches, model_um, style)
    assert run.found is not None
    name = run.bottom.name if run.bottom else label
    return render_wear(name, run.found, run.account.worn_um, run.total_um, run.truth, style)


def _forewarn(outcome: Outcome, plan: "Plan", run: "WearRun", folder: Path) -> None:
    """Say what ledger and bench make of the touches. Raises what would refuse them."""
    from edmctl.jobs.ledger.tool_identity import not_seen, tool_identity_in_file
    from edmctl.record.ledger import Logbook

    if not plan.where.lasting:
        return
    identity = tool_identity_in_file(plan.where)
    if identity is None:
        note(outcome.output, not_seen(plan.where))
    else:
        run.look(identity, Logbook.open(folder), outcome.warn)


def _tell_plan(outcome: Outcome, plan: "Plan", *, reference: bool) -> None:
    from edmctl.console.procedure_tables import render_wear_plan
    from edmctl.forecasts.measuring_time import move_time_s, park_to_pad_um, reading_time_s, touch_time_s
    from edmctl.jobs.wear.measure import measuring_profile

    profile, setup = measuring_profile(plan.loaded.profile), plan.setup
    time_s = touch_time_s(profile, setup)
    readings = ["Z1"] if reference else ["Z3", "Z2", "Z3"]
    if not reference:
        deep_um = profile.approach.offset_um + plan.forecast.feed_um
        moves_s = 2.0 * move_time_s(max(profile.measure.site_dx_um, park_to_pad_um(setup)), setup)
        time_s += (
            moves_s + reading_time_s(profile, deep_um) + reading_time_s(profile, profile.approach.offset_um)
        )
    forecast = {
        "readings": readings,
        "touches": profile.measure.touches,
        "speed_um_s": profile.measure.speed_um_s,
        "time_s": time_s,
    }
    outcome.result = {"forecast": forecast}
    outcome.text = render_wear_plan(
        readings, profile.measure.touches, profile.measure.speed_um_s, time_s, stream_style(sys.stdout)
    )
