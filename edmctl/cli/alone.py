"""A command that does one procedure of the main job by itself: its way from a checked order to a result."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol

from edmctl.cli.bench import seed_warning
from edmctl.cli.outcome import stream_style, watching
from edmctl.cli.runfile import name_run
from edmctl.cli.seeds import seed_to_use, simulated_by
from edmctl.cli.signals import ignore_signals

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from edmctl.cli.connected_run import Held
    from edmctl.cli.job import Plan
    from edmctl.cli.outcome import Outcome
    from edmctl.cli.runfile import RunName
    from edmctl.console.style import Style
    from edmctl.errors import Diagnostic
    from edmctl.machine.controller import LinkMachine
    from edmctl.procedures.job import Job
    from edmctl.procedures.run import Run
    from edmctl.record.recorder import Recorder

    Warn = Callable[[Sequence[Diagnostic]], None]


class Procedure(Protocol):
    """What one command does on a machine that is connected. It keeps what it has reached."""

    @property
    def name(self) -> str:
        """First word of the run file's name."""
        ...

    @property
    def pulses(self) -> bool:
        """Whether it makes sparks."""
        ...

    def job(self, held: Held, name: RunName, warn: Warn) -> Job:
        """Return what the machine is made ready for; refuse what cannot be done on it."""
        ...

    def act(self, run: Run) -> None:
        """Do it on an armed and conditioned machine."""
        ...

    def close(self, time_s: float) -> None:
        """Keep what is to be known by later commands; the machine is retracted and idle, after `time_s`."""
        ...

    def result(self) -> Mapping[str, object] | None:
        """What was reached, for scripts; None where there is nothing."""
        ...

    def render(self, style: Style) -> str:
        """The same for people."""
        ...


@dataclass(frozen=True, slots=True)
class Asked:
    """The options that say where a run goes, and which seed makes a new virtual bench."""

    out: Path
    run_id: str | None
    seed: int | None


def name_of(plan: Plan, command: str, asked: Asked) -> RunName:
    """Name the run; a profile that nobody named is not in it."""
    loaded = plan.loaded if plan.names_tool else None
    return name_run(asked.out, asked.run_id, loaded, datetime.now(UTC), command)


def perform(outcome: Outcome, plan: Plan, procedure: Procedure, asked: Asked) -> None:
    """Do it, with a run file, and leave the result in `outcome`. Raises the error that ended it."""
    from edmctl.cli.connected_run import connected_run
    from edmctl.procedures.harness import running
    from edmctl.procedures.results import Ledger

    outcome.warn(seed_warning(plan.where, asked.seed))
    seed = seed_to_use(asked.seed)
    outcome.seed = plan.where.seed_of(seed)
    name = name_of(plan, procedure.name, asked)
    ledger = Ledger()

    def prepare(held: Held) -> Callable[[Recorder], None]:
        job = procedure.job(held, name, outcome.warn)
        return lambda recorder: act(held.bench.machine, job, recorder)

    def act(machine: LinkMachine, job: Job, recorder: Recorder) -> None:
        with running(
            machine, job, ledger, recorder=recorder, observer=reporter, pulses=procedure.pulses
        ) as run:
            procedure.act(run)
        procedure.close(ledger.time_s)

    def summary(held: Held) -> dict[str, object]:
        used = asdict(held.choice.used) if held.choice else None
        return {
            **(procedure.result() or {}),
            "calibration": used,
            "time_s": ledger.time_s,
            "link": ledger.link,
        }

    with watching(outcome.output) as reporter:
        held = connected_run(plan, seed, reporter, name, outcome.warn, prepare, summary)
        outcome.simulated = held.bench.machine.identity.simulated
        ignore_signals()
        outcome.run_file = held.run_file
        if held.error and outcome.run_file:
            reporter.note(f"what was recorded until then is in {outcome.run_file}")
    outcome.result = summary(held)
    if procedure.result() is not None:
        outcome.text = _closing_text(procedure, held, outcome)
    if held.error:
        raise held.error


def _closing_text(procedure: Procedure, held: Held, outcome: Outcome) -> str:
    lines = [procedure.render(stream_style(sys.stdout))]
    if held.choice:
        lines.append(f"Actuator model: {held.choice.used.text}.")
    made_by = simulated_by(outcome.seed) if outcome.simulated else ""
    return "\n".join([*lines, f"{made_by}Run file {outcome.run_file}"])
