"""`edmctl study tell`, `import` and `judge`: what people know of runs, minutes or days later."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from edmctl.cli.options import command
from edmctl.cli.outcome import Outcome
from edmctl.errors import UsageError
from edmctl.study.commands.options import FolderArgument, RunNumberArgument, opened
from edmctl.study.results import Judgement
from edmctl.wording import plural

ValuesArgument = Annotated[
    list[str], typer.Argument(metavar="NAME=VALUE...", help="Manual responses of the run, e.g. ra_um=0.31.")
]
TableArgument = Annotated[
    Path, typer.Argument(metavar="TABLE.csv", help="A column run, and one for each manual response.")
]
JudgementArgument = Annotated[Judgement, typer.Argument(metavar="accept|reject|repeat", show_default=False)]
ReasonArgument = Annotated[str, typer.Argument(metavar="REASON", help="Kept with the run.")]


@command("study tell")
def tell(outcome: Outcome, folder: FolderArgument, run: RunNumberArgument, values: ValuesArgument) -> None:
    """Tell responses that were measured by hand, such as a roughness from a profilometer.

    Told again, the later value counts, and `NAME=none` withdraws it; all of them stay in the rows.
    """
    from edmctl.study.table import made_run, told_values

    study = opened(folder)
    state = study.read()
    found = made_run(state, run)
    told = told_values(state, values)
    with study.writer() as writer:
        writer.told(found, told)
    outcome.result = {"run": run, "told": told}
    words = (f"{name} {'is withdrawn' if v is None else f'= {v:g}'}" for name, v in told.items())
    outcome.text = f"Run {run}: {', '.join(words)}"


@command("study import")
def import_table(outcome: Outcome, folder: FolderArgument, table: TableArgument) -> None:
    """Tell the manual responses of many runs by a CSV table; all of it or, where a line is wrong, nothing.

    An empty cell tells nothing, and `none` withdraws what was told.
    """
    from edmctl.study.table import told_table

    study = opened(folder)
    state = study.read()
    told = told_table(state, table)
    with study.writer() as writer:
        for number, values in told.items():
            writer.told(state.run(number), values)
    outcome.result = {"runs": len(told), "told": {str(number): values for number, values in told.items()}}
    outcome.text = f"Told responses of {plural(len(told), 'run')}."
    withdrawn = [number for number, values in told.items() if None in values.values()]
    if withdrawn:
        outcome.text += f" Withdrawn: of {plural(len(withdrawn), 'run')}, {', '.join(map(str, withdrawn))}."


@command("study judge")
def judge(
    outcome: Outcome,
    folder: FolderArgument,
    run: RunNumberArgument,
    judgement: JudgementArgument,
    reason: ReasonArgument,
) -> None:
    """Judge a run: accept one that failed, reject one that shall not count, or have it repeated.

    Nothing is deleted: the row stays, with the judgement and its reason.
    """
    from edmctl.study.evaluate import lost_row
    from edmctl.study.on_machine import is_begun, next_order
    from edmctl.study.waiting import way_on

    study = opened(folder)
    if not reason.strip():
        raise UsageError("The reason is empty.", hint='Say why, e.g. "chip under the tool".', code="E2107")
    found = study.read().run(run)
    if found.row is None and judgement is Judgement.REPEAT and is_begun(study, found):
        with study.claimed("all"), study.writer() as writer:  # nobody is making it
            # The hole stays where it is, and the next attempt takes another place.
            lost = lost_row(found.planned, found.attempts + 1, f"E1300: given up: {reason}", 130)
            writer.run(replace(lost, order=next_order(study.read())))
        found = study.read().run(run)
    if found.row is None and judgement is not Judgement.REJECT:
        raise UsageError(
            f"Run {run} is not made yet.",
            hint=f"Make it with `{way_on(study.read())}`, then judge it; one that shall not be made is rejected.",
            code="E2107",
        )
    with study.writer() as writer:
        writer.judged(found, judgement, reason)
    outcome.result = {"run": run, "attempt": found.attempts, "judgement": str(judgement), "reason": reason}
    state = study.read()
    again = (
        "as another hole at the next free place"
        if state.rows.port
        else "and a virtual machine makes it the same"
    )
    after = {
        Judgement.ACCEPT: "its responses count",
        Judgement.REJECT: "it does not count; the row stays",
        Judgement.REPEAT: f"`{way_on(state)}` makes it again, {again}",
    }
    outcome.text = f"Run {run}: {judgement} ({reason}); {after[judgement]}."
