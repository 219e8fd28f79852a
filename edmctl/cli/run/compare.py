"""`edmctl run compare`: runs side by side, with differences larger than their uncertainty marked."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import command
from edmctl.cli.outcome import Outcome
from edmctl.jobs.runs.opening import find_run, reading_unless_killed

if TYPE_CHECKING:
    from edmctl.record.reader import RunFile

FilesArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN RUN...",
        help="Run files, or ids of runs in runs/. All are compared with the first.",
        autocompletion=completion.runs,
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="FIGURE", help="Draw them too, into a new file: .png, .svg or .pdf."),
]


@command("run compare")
def compare(outcome: Outcome, files: FilesArgument, out: OutOption = None) -> None:
    """Compare settings and results of runs.

    Marks differences larger than the uncertainty.
    """
    from edmctl.cli.render.runs_tables import render_comparison
    from edmctl.jobs import output_files
    from edmctl.report.comparison import compare as compared

    if len(files) < 2:
        raise failures.one_run_to_compare()
    if out is not None:
        from edmctl.report.kinds import check_figure

        check_figure(out.name)
        output_files.check_free(out)
    with ExitStack() as stack:
        runs = [stack.enter_context(reading_unless_killed(find_run(file))) for file in files]
        found = compared(runs)
        result: dict[str, object] = {
            "runs": found.runs,
            "differs": found.differs,
            "quantities": found.quantities,
            "sites": found.sites,
            "figure": None,
        }
        outcome.simulated = all(run.simulated for run in found.runs)
        outcome.result = result
        outcome.show(lambda style: render_comparison(found, style))
        if out is not None:
            output_files.write(out, _drawn(runs, out))
            result["figure"] = str(out)
            outcome.text = f"Figure {out}"


def _drawn(runs: "list[RunFile]", out: Path) -> bytes:
    from edmctl.cli.render.runs_tables import letter
    from edmctl.report.figures.comparison import draw
    from edmctl.report.style import house_style, rendered

    with house_style():
        return rendered(draw(runs, [letter(number) for number in range(len(runs))]), out.suffix.lower())
