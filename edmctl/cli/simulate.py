"""`edmctl simulate`: the same job on many virtual machines."""

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import (
    DebugOption,
    DryRunOption,
    EventsOption,
    JsonOption,
    ProfileOption,
    QuietOption,
    SeedOption,
    SetOption,
    SetupOption,
)
from edmctl.cli.outcome import Outcome, Output, run_command, stream_style, watching
from edmctl.cli.seeds import seed_to_use
from edmctl.console.text import plural
from edmctl.errors import ObjectiveNotReached

if TYPE_CHECKING:
    from edmctl.cli.job import Order, Plan
    from edmctl.cli.spread import Run

RunsOption = Annotated[
    int, typer.Option("--runs", "-n", metavar="N", min=1, help="Runs, with seeds one apart.")
]
SweepOption = Annotated[
    str | None,
    typer.Option("--sweep", metavar="KEY=START:STOP:COUNT", help="All runs for each of these values."),
]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write a run file of each run; none without.")
]


@dataclasses.dataclass(frozen=True, slots=True)
class _Case:
    """One set of values that was asked for, checked."""

    label: str
    order: "Order"
    plan: "Plan"


def simulate(
    profile: ProfileOption = None,
    overrides: SetOption = None,
    setup: SetupOption = None,
    runs: RunsOption = 10,
    sweep: SweepOption = None,
    seed: SeedOption = None,
    out: OutOption = None,
    dry_run: DryRunOption = False,
    as_json: JsonOption = False,
    events: EventsOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Run a job on many virtual machines.

    Reports how depth, wear, time and the errors of measuring spread over the seeds.
    """

    def body(outcome: Outcome) -> None:
        from edmctl.cli.job import Order

        order = Order(profile, tuple(overrides or ()), setup, port=None)
        outcome.simulated = True
        cases = _checked(outcome, _orders(order, sweep))
        if dry_run:
            _forecast(outcome, cases)
            return
        outcome.seed = seed_to_use(seed)
        _simulate(outcome, cases, outcome.seed, runs, out)

    return run_command(Output("simulate", as_json, events, quiet, debug), body)


def _orders(order: "Order", sweep: str | None) -> list["Order"]:
    from edmctl.cli.sweep import parse_sweep

    if sweep is None:
        return [order]
    steps = parse_sweep(sweep).overrides()
    return [dataclasses.replace(order, overrides=(*order.overrides, step)) for step in steps]


def _checked(outcome: Outcome, orders: list["Order"]) -> list["_Case"]:
    """Check every order before anything runs; raises ProfileError, UsageError, LinkLost."""
    from edmctl.cli.job import check

    plans = [check(order) for order in orders]
    outcome.warn(dict.fromkeys(warning for plan in plans for warning in plan.loaded.warnings))
    labels = [
        _label(plan.loaded.path.stem, order, len(orders)) for order, plan in zip(orders, plans, strict=True)
    ]
    return [_Case(*parts) for parts in zip(labels, orders, plans, strict=True)]


def _forecast(outcome: Outcome, cases: list["_Case"]) -> None:
    from edmctl.console.forecast_table import render_forecast

    outcome.result = {
        "cases": [
            {"label": case.label, "overrides": case.order.overrides, "forecast": case.plan.forecast}
            for case in cases
        ]
    }
    style = stream_style(sys.stdout)
    outcome.text = "\n\n".join(render_forecast(case.label, case.plan.forecast, style) for case in cases)


def _simulate(outcome: Outcome, asked: list["_Case"], seed: int, runs: int, out: Path | None) -> None:
    from edmctl.cli.batch import Task, perform_all
    from edmctl.cli.spread import summarize
    from edmctl.console.spread_table import render_cases

    tasks = [
        Task(case.order, seed + index, out, f"{case.label.replace('=', '-')}-seed{seed + index}")
        for case in asked
        for index in range(runs)
    ]
    with watching(outcome.output) as reporter:
        reporter.note(f"simulating {len(tasks)} runs, seeds {seed} to {seed + runs - 1}")
        done = perform_all(tasks, reporter)
    cases = [
        summarize(case.label, case.order.overrides, done[index * runs : (index + 1) * runs])
        for index, case in enumerate(asked)
    ]
    outcome.result = {"runs": runs, "cases": cases}
    outcome.text = render_cases(cases, stream_style(sys.stdout))
    _refuse_failures(done)


def _label(stem: str, order: "Order", orders: int) -> str:
    """The profile's name, or in a sweep the value that this case has."""
    return stem if orders == 1 else order.overrides[-1]


def _refuse_failures(runs: list["Run"]) -> None:
    failed = [run for run in runs if not run.ok]
    if failed:
        first = failed[0]
        raise ObjectiveNotReached(
            f"{len(failed)} of {plural(len(runs), 'run')} failed; the first, with seed {first.seed}: {first.error}",
            hint=f"Repeat it with `edmctl machine --seed {first.seed}` and the same profile.",
            code="E7900",
        )
