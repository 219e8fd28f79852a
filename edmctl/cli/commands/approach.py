"""`edmctl approach`: find the spark gap, or the surface."""

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

ContactOption = Annotated[
    bool, typer.Option("--contact", help="Touch the surface, without sparks, instead of finding the gap.")
]
PlaceOption = Annotated[
    str | None,
    typer.Option(
        "--site",
        metavar="X,Y",
        help="Stage coordinates in µm; without, where `machine` would put its first hole.",
    ),
]


def approach(
    profile: ProfileOption = None,
    contact: ContactOption = False,
    site: PlaceOption = None,
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
    """Feed the tool to the spark gap, say where it is, retract.

    The feed is the profile's approach speed. With --contact the tool touches the surface by continuity instead.
    """

    def body(outcome: Outcome) -> None:
        from edmctl.cli.procedure_output import Asked, perform_told
        from edmctl.console.procedure_tables import render_surface
        from edmctl.jobs.approach import Approach
        from edmctl.jobs.checking import check
        from edmctl.jobs.plan import JobRequest

        plan = check(
            JobRequest(profile, tuple(overrides or ()), setup, port, calibration, allow_model, wait), shell()
        )
        outcome.simulated = plan.simulated
        outcome.warn(plan.loaded.warnings)
        place = _place(site)
        if dry_run:
            _tell_plan(
                outcome, plan, _forewarned_place(outcome, plan, place, out, contact=contact), contact=contact
            )
        else:
            approach = Approach(plan, place, contact=contact)

            def render(style: "Style") -> str:
                assert approach.found is not None
                return render_surface(approach.found, style)

            perform_told(outcome, plan, approach, Asked(out, run_id, seed), render)

    return run_command(Output("approach", as_json, events, quiet, debug), body)


def _place(text: str | None) -> tuple[float, float] | None:
    from edmctl.jobs.site_option import coordinates, no_place

    if text is None:
        return None
    found = coordinates(text)
    if found is None:
        raise no_place(text)
    return found


def _forewarned_place(
    outcome: Outcome, plan: "Plan", place: tuple[float, float] | None, folder: Path, *, contact: bool
) -> tuple[float, float] | None:
    """Return where the tool would go, as far as ledger and bench tell. Raises what the approach would."""
    from edmctl.cli.outcome import note
    from edmctl.jobs.approach import checked_site
    from edmctl.jobs.job_preparation import prepared_job
    from edmctl.jobs.ledger.places_taken import refuse_pad
    from edmctl.jobs.ledger.tool_identity import not_seen, tool_identity_in_file
    from edmctl.procedures.job import job_of
    from edmctl.record.ledger import Logbook

    if place is not None and not contact:
        refuse_pad(("the place", *place), job_of(plan.loaded.profile, plan.setup))
    if not plan.where.lasting:
        return place
    identity = tool_identity_in_file(plan.where)
    if identity is None:
        note(outcome.output, not_seen(plan.where))
        return place
    logbook = Logbook.open(folder)
    prepared = prepared_job(plan, identity, None, logbook)
    site = checked_site(prepared, place, folder, plan.where.selector, contact=contact)
    return site.x_um, site.y_um


def _tell_plan(outcome: Outcome, plan: "Plan", place: tuple[float, float] | None, *, contact: bool) -> None:
    from edmctl.console.procedure_tables import render_approach_plan
    from edmctl.forecasts.measuring_time import approach_time_s, beside_pad_um, touch_time_s

    profile, setup = plan.loaded.profile, plan.setup
    x_um, y_um = place or beside_pad_um(profile, setup)
    time_s = touch_time_s(profile, setup) if contact else approach_time_s(profile, setup)
    speed_um_s = profile.measure.speed_um_s if contact else profile.approach.speed_um_s
    forecast = {
        "x_um": x_um,
        "y_um": y_um,
        "kind": "contact" if contact else "spark gap",
        "speed_um_s": speed_um_s,
        "expected_um": profile.approach.offset_um,
        "max_travel_um": profile.approach.max_travel_um,
        "time_s": time_s,
    }
    outcome.result = {"forecast": forecast}
    outcome.text = render_approach_plan(forecast, stream_style(sys.stdout))
