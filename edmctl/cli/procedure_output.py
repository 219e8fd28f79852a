"""What a command that does one procedure by itself says of it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.cli.outcome import stream_style, watching
from edmctl.cli.signals import ignore_signals
from edmctl.jobs.connect import seed_warning
from edmctl.jobs.procedure_command import name_of, perform
from edmctl.jobs.simulate.seeds import seed_to_use, simulated_by

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from edmctl.cli.outcome import Outcome
    from edmctl.console.style import Style
    from edmctl.jobs.plan import Plan
    from edmctl.jobs.procedure_command import Procedure


@dataclass(frozen=True, slots=True)
class Asked:
    """The options that say where a run goes, and which seed makes a new virtual bench."""

    out: Path
    run_id: str | None
    seed: int | None


def perform_told(
    outcome: Outcome, plan: Plan, procedure: Procedure, asked: Asked, render: Callable[[Style], str]
) -> None:
    """Do it, and leave the result in `outcome`; `render` puts it in words. Raises the error that ended it."""
    outcome.warn(seed_warning(plan.where, asked.seed))
    seed = seed_to_use(asked.seed)
    outcome.seed = plan.where.seed_of(seed)
    name = name_of(plan, procedure.name, asked.out, asked.run_id)
    with watching(outcome.output) as reporter:
        done = perform(plan, procedure, name, seed, reporter, outcome.warn)
        outcome.simulated = done.simulated
        ignore_signals()
        outcome.run_file = done.run_file
        if done.error and done.run_file:
            reporter.note(f"what was recorded until then is in {done.run_file}")
    outcome.result = done.result
    if done.reached:
        lines = [render(stream_style(sys.stdout))]
        if done.model:
            lines.append(f"Actuator model: {done.model.text}.")
        made_by = simulated_by(outcome.seed) if done.simulated else ""
        outcome.text = "\n".join([*lines, f"{made_by}Run file {done.run_file}"])
    if done.error:
        raise done.error
