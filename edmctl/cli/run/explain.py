"""`edmctl run explain`: what a run did, and why, in plain sentences."""

import sys

from edmctl.cli.options import DebugOption, FileArgument, JsonOption
from edmctl.cli.outcome import Outcome, Output, run_command, stream_style


def explain(file: FileArgument, as_json: JsonOption = False, debug: DebugOption = False) -> int:
    """Describe a run in plain sentences.

    What it did, when, and why.
    """

    def body(outcome: Outcome) -> None:
        from edmctl.console.run_view import render_sentences
        from edmctl.jobs.resume.way_on import command_to_go_on
        from edmctl.jobs.run_explanation import sentences_of
        from edmctl.jobs.run_opening import find_run, unless_killed
        from edmctl.record.reader import reading

        with reading(find_run(file)) as opened:
            outcome.run_file = opened.path
            outcome.simulated = opened.is_simulated
            sentences = sentences_of(opened)
            outcome.result = {"story": sentences}
            outcome.text = render_sentences(sentences, stream_style(sys.stdout))
            unless_killed(opened, command_to_go_on(opened.path))

    return run_command(Output("run explain", as_json, debug=debug), body)
