"""`edmctl run show` and `explain`: one run on a page, also while it goes on, and in plain sentences."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from edmctl.cli.options import PROGRESS, RunArgument, command
from edmctl.cli.outcome import Outcome, stream_style, watching
from edmctl.errors import RunFileError
from edmctl.jobs.runs.opening import command_to_go_on, find_run, unless_killed

FollowOption = Annotated[
    bool,
    typer.Option("--follow", "-f", help="Watch a run that goes on until it ends; Ctrl-C ends the watching."),
]


@command("run show", PROGRESS)
def show(outcome: Outcome, file: RunArgument, follow: FollowOption = False) -> None:
    """Show one run: what was wanted, and what became of it.

    With times and what the file holds.
    """
    path = find_run(file)
    killed: RunFileError | None = None
    if follow:
        from edmctl.jobs.runs.follow import follow_run

        try:
            with watching(outcome.output) as reporter:
                path = follow_run(path, reporter)
        except RunFileError as error:
            if error.code != "E9008":
                raise
            killed = error
    _tell(outcome, path)
    if killed is not None:
        raise killed


def _tell(outcome: Outcome, path: Path) -> None:
    """Leave the summary as the result. Raises RunFileError E9008 when the writer was killed."""
    from edmctl.console.run_view import render_run
    from edmctl.jobs.runs.summary import summary_of
    from edmctl.record.reader import reading

    with reading(path) as opened:
        outcome.run_file = path
        summary = summary_of(opened)
        outcome.simulated, outcome.seed = summary.simulated, summary.seed
        outcome.result = summary
        outcome.text = render_run(summary, stream_style(sys.stdout))
        unless_killed(opened, summary.way_on)


@command("run explain")
def explain(outcome: Outcome, file: RunArgument) -> None:
    """Describe a run in plain sentences.

    What it did, when, and why.
    """
    from edmctl.console.run_view import render_sentences
    from edmctl.jobs.runs.explanation import sentences_of
    from edmctl.record.reader import reading

    with reading(find_run(file)) as opened:
        outcome.run_file = opened.path
        outcome.simulated = opened.is_simulated
        sentences = sentences_of(opened)
        outcome.result = {"story": sentences}
        outcome.text = render_sentences(sentences, stream_style(sys.stdout))
        unless_killed(opened, command_to_go_on(opened.path))
