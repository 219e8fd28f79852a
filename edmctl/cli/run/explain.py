"""`edmctl run explain`: what a run did, and why, in plain sentences."""

import sys

from edmctl.cli.options import RunArgument, command
from edmctl.cli.outcome import Outcome, stream_style


@command("run explain")
def explain(outcome: Outcome, file: RunArgument) -> None:
    """Describe a run in plain sentences.

    What it did, when, and why.
    """
    from edmctl.console.run_view import render_sentences
    from edmctl.jobs.runs.explanation import sentences_of
    from edmctl.jobs.runs.opening import command_to_go_on, find_run, unless_killed
    from edmctl.record.reader import reading

    with reading(find_run(file)) as opened:
        outcome.run_file = opened.path
        outcome.simulated = opened.is_simulated
        sentences = sentences_of(opened)
        outcome.result = {"story": sentences}
        outcome.text = render_sentences(sentences, stream_style(sys.stdout))
        unless_killed(opened, command_to_go_on(opened.path))
