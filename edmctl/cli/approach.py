"""`edmctl approach`: find the spark gap, or the surface."""

import math
import sys
from dataclasses import asdict, dataclass, replace
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

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.cli.alone import Warn
    from edmctl.cli.connected_run import Held
    from edmctl.cli.job import Plan
    from edmctl.cli.prepared import Prepared
    from edmctl.cli.runfile import RunName
    from edmctl.console.style import Style
    from edmctl.procedures.approach import SurfaceFound
    from edmctl.procedures.job import Job, Site
    from edmctl.procedures.run import Run

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
        from edmctl.cli.alone import Asked, perform
        from edmctl.cli.job import Order, check

        plan = check(Order(profile, tuple(overrides or ()), setup, port, calibration, allow_model, wait))
        outcome.simulated = plan.simulated
        outcome.warn(plan.loaded.warnings)
        place = _place(site)
        if dry_run:
            _tell_plan(
                outcome, plan, _forewarned_place(outcome, plan, place, out, contact=contact), contact=contact
            )
        else:
            perform(outcome, plan, _Approach(plan, place, contact=contact), Asked(out, run_id, seed))

    return run_command(Output("approach", as_json, events, quiet, debug), body)


def _place(text: str | None) -> tuple[float, float] | None:
    from edmctl.cli.site_option import coordinates, no_place

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
    from edmctl.cli.prepared import prepared_job
    from edmctl.cli.tool_seen import not_seen, seen_in_file
    from edmctl.record.logbook import Logbook

    if not plan.where.lasting:
        return place
    seen = seen_in_file(plan.where)
    if seen is None:
        note(outcome.output, not_seen(plan.where))
        return place
    logbook = Logbook.open(folder)
    prepared = prepared_job(plan, seen, None, logbook)
    site = _checked_site(prepared, place, folder, plan.where.selector, contact=contact)
    return site.x_um, site.y_um


def _checked_site(
    prepared: "Prepared", place: tuple[float, float] | None, folder: Path, port: str, *, contact: bool
) -> "Site":
    """Return the place to approach.

    Raises PreconditionError: E8042 a hole is there, or the pad where sparks would be made, E8044 the tool does not
    reach the surface.
    """
    from edmctl.cli.places_taken import refuse_pad, refuse_taken
    from edmctl.cli.prepared import hole_radius_um
    from edmctl.cli.tool_left import refuse_too_short
    from edmctl.procedures.job import Site
    from edmctl.profile.forecast import STROKE_RESERVE_UM

    job = prepared.job
    first = job.sites[0]
    site = Site("the place", *place) if place else replace(first, name="the next place")
    own_way_um = job.profile.approach.offset_um + STROKE_RESERVE_UM
    if not math.isnan(prepared.account.pad_um):
        refuse_too_short(job.profile, job.setup, own_way_um, prepared.account, port)
    if not contact:
        refuse_pad((site.name, site.x_um, site.y_um), job)
    refuse_taken([(site.name, site.x_um, site.y_um)], hole_radius_um(job.profile), prepared.holes, folder)
    return site


def _tell_plan(outcome: Outcome, plan: "Plan", place: tuple[float, float] | None, *, contact: bool) -> None:
    from edmctl.console.surface_table import render_approach_plan
    from edmctl.profile.measuring_time import approach_time_s, beside_pad_um, touch_time_s

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


@dataclass(slots=True)
class _Approach:
    """One approach."""

    plan: "Plan"
    place: tuple[float, float] | None
    contact: bool
    found: "SurfaceFound | None" = None
    _site: "Site | None" = None
    name: str = "approach"

    @property
    def pulses(self) -> bool:
        """A touch makes none."""
        return not self.contact

    def job(self, held: "Held", name: "RunName", warn: "Warn") -> "Job":
        """Return the job of the machine's tool as it is by now, at the place of its first hole."""
        from edmctl.cli.prepared import logbook_of, prepared_job
        from edmctl.cli.tool_seen import seen_on

        actuator = held.choice.actuator if held.choice else None
        prepared = prepared_job(self.plan, seen_on(held), actuator, logbook_of(self.plan, name))
        self._site = _checked_site(
            prepared, self.place, name.path.parent, self.plan.where.selector, contact=self.contact
        )
        return prepared.job

    def act(self, run: "Run") -> None:
        """Find gap or surface."""
        from edmctl.procedures.approach import find_contact, find_gap

        assert self._site is not None
        self.found = find_contact(run, self._site) if self.contact else find_gap(run, self._site)

    def close(self, time_s: float) -> None:
        """Some sparks leave no hole: there is nothing to keep."""

    def result(self) -> "Mapping[str, object] | None":
        """Where it is."""
        return asdict(self.found) if self.found else None

    def render(self, style: "Style") -> str:
        """The same as a table."""
        from edmctl.console.surface_table import render_surface

        assert self.found is not None
        return render_surface(self.found, style)
