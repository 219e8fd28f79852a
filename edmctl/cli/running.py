"""Commands that move a machine: what they say of a dry run, on the way and in the end."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from edmctl.cli.outcome import Outcome, note, watching
from edmctl.cli.render.layout import wrapped
from edmctl.cli.render.progress import Reporter
from edmctl.cli.render.style import Style
from edmctl.cli.signals import ignore_signals
from edmctl.jobs.sweep import seed_to_use, simulated_by

if TYPE_CHECKING:
    from edmctl.cli.options import JobOptions, RunOptions
    from edmctl.jobs.job import Report
    from edmctl.jobs.ledger.tool import ToolIdentity
    from edmctl.jobs.plan import Plan
    from edmctl.jobs.procedures import Procedure, ProcedureReport

_R = TypeVar("_R", bound="Report | ProcedureReport")
_P = TypeVar("_P", bound="Procedure")


def run_and_tell(
    outcome: Outcome,
    plan: Plan,
    asked_seed: int | None,
    run: Callable[[int, Reporter], _R],
    render: Callable[[_R, Style], str],
) -> None:
    """Run on the machine of `plan`, and leave the result in `outcome`; `render` puts it in words.

    Raises the error that ended it.
    """
    from edmctl.jobs.connect import seed_warning

    outcome.warn(seed_warning(plan.where, asked_seed))
    seed = seed_to_use(asked_seed)
    outcome.seed = plan.where.seed_of(seed)
    with watching(outcome.output) as reporter:
        report = run(seed, reporter)
        outcome.simulated = report.simulated
        ignore_signals()
        outcome.run_file = report.run_file
        if report.error and report.run_file:
            reporter.note(f"what was recorded until then is in {report.run_file}")
    outcome.result = report.as_mapping()
    if report.reached:
        outcome.show(lambda style: closing_text(render(report, style), style, report, outcome.seed))
    report.raise_for_error()


def closing_text(table: str, style: Style, report: Report | ProcedureReport, seed: int | None) -> str:
    """Return the table at the end of a run, and what it was made with."""
    lines = []
    if report.model:
        lines.append(f"Actuator model: {report.model.text}.")
        if report.model.alone:
            lines.append("No sensor is fitted: every touch was read by that model.")
    made_by = simulated_by(seed) if report.simulated else ""
    lines.append(f"{made_by}Run file {report.run_file}")
    return "\n".join([table, *(part for line in lines for part in wrapped(line, style.columns))])


def perform_and_tell(
    outcome: Outcome,
    procedure: _P,
    job: JobOptions,
    run: RunOptions,
    render: Callable[[_P, Style], str],
) -> None:
    """Do a procedure by itself, and leave the result in `outcome`. Raises the error that ended it."""
    from edmctl.jobs.procedures import name_of, perform

    name = name_of(procedure.plan, procedure.name, run.out, run.run_id)
    run_and_tell(
        outcome,
        procedure.plan,
        job.seed,
        lambda seed, reporter: perform(procedure, name, seed, reporter, outcome.warn),
        lambda _, style: render(procedure, style),
    )


def identity_before(outcome: Outcome, plan: Plan) -> ToolIdentity | None:
    """Return machine and tool as far as they are known without connecting; say so where they are not.

    A fresh virtual machine has no past that is to be looked at.
    """
    from edmctl.jobs.ledger.tool import not_seen, tool_identity_in_file

    if not plan.where.lasting:
        return None
    identity = tool_identity_in_file(plan.where)
    if identity is None:
        note(outcome.output, not_seen(plan.where))
    return identity
