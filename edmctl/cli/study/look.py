"""`edmctl study list`, `plan` and `status`: what there is, what would be run, and how far it is."""

import shlex
import sys

from edmctl.cli.options import NOTES, command
from edmctl.cli.outcome import Outcome, stream_style, watching
from edmctl.cli.signals import shell
from edmctl.cli.study.options import FolderArgument, StudyArgument, checks_told, opened, study_source
from edmctl.console.layout import render_columns
from edmctl.profile.folders import shipped_studies


@command("study list")
def list_studies(outcome: Outcome) -> None:
    """List the shipped studies."""
    from edmctl.profile.study_file import read_study

    found = [(name, read_study(path).file) for name, path in shipped_studies().items()]
    outcome.result = {
        "studies": [
            {
                "study": name,
                "name": file.study.name,
                "description": file.study.description,
                "design": file.design.kind,
            }
            for name, file in found
        ]
    }
    rows = [[name, file.design.kind, file.study.description or file.study.name] for name, file in found]
    outcome.text = render_columns(["study", "design", "what it asks"], rows, stream_style(sys.stdout), "<")


@command("study plan", NOTES)
def plan(outcome: Outcome, file: StudyArgument) -> None:
    """Check a study and show every run of it, what the runs will take, and what they can tell.

    Every run is checked as a job is; nothing moves and nothing is written.
    """
    from edmctl.console.study_tables import render_plan
    from edmctl.jobs.study.planning import plan_study

    source = study_source(outcome, file)
    with watching(outcome.output) as reporter:
        planned = plan_study(source, shell(), checks_told(reporter.note))
    outcome.warn(planned.warnings)
    outcome.result = planned.plan.as_mapping()
    way_on = f"Run it: `edmctl study run {shlex.quote(file)} --out DIR`"
    outcome.text = f"{render_plan(planned.plan, stream_style(sys.stdout))}\n\n{way_on}"


@command("study status")
def status(outcome: Outcome, folder: FolderArgument) -> None:
    """Show every run of a study with its responses, and what the study waits for."""
    from edmctl.console.study_tables import render_status
    from edmctl.jobs.study.folder import version_warning
    from edmctl.jobs.study.table import counts_of, in_words, missing_manual, table_of
    from edmctl.jobs.study.waiting import what_next

    study = opened(folder)
    outcome.warn(version_warning(study))
    state = study.read()
    outcome.result = {
        "study": study.plan.name,
        "runs": len(state.runs),
        "counts": counts_of(state),
        "missing": [{"run": number, "responses": list(names)} for number, names in missing_manual(state)],
        "torn_lines": state.rows.torn,
        "foreign_lines": state.rows.foreign,
        "table": table_of(state),
    }
    style = stream_style(sys.stdout)
    outcome.text = render_status(study.plan, state.runs, in_words(state), what_next(state), style)
