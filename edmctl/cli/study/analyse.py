"""`edmctl study report` and `export`: what the runs say, and the table of them."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from edmctl.cli.options import command
from edmctl.cli.outcome import Outcome, stream_style
from edmctl.cli.signals import shell
from edmctl.cli.study.options import FolderArgument, opened
from edmctl.wording import plural

PageOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="PAGE", help="HTML page with all tables and figures. Default: none."),
]
TableOption = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="TABLE", help="File: .csv, .json, .jsonl or .parquet. Default: CSV to stdout."
    ),
]
FormatOption = Annotated[
    str | None,
    typer.Option("--format", metavar="FORMAT", help="csv, json, jsonl or parquet, whatever the ending."),
]
ProfilesOption = Annotated[
    Path | None,
    typer.Option(
        "--profiles", metavar="FOLDER", help="Write a profile for each point of the Pareto front instead."
    ),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace files of the same name.")]


@command("study report")
def report(
    outcome: Outcome, folder: FolderArgument, out: PageOption = None, overwrite: OverwriteOption = False
) -> None:
    """Say what matters, by analysis of variance, models and the Pareto front; --out writes a page of it."""
    from edmctl.console.study_tables import render_analysis
    from edmctl.jobs import output_files
    from edmctl.jobs.study.analysis import analysis_of, ranked_by
    from edmctl.jobs.study.confirming import confirmations_of
    from edmctl.jobs.study.reporting import mapping_of, page_of, recommendation_or_why

    study = opened(folder)
    state = study.read()
    found = analysis_of(state)
    best, why = recommendation_or_why(state, shell())
    notes = (*found.notes, *why)
    confirmations = confirmations_of(state)
    outcome.result = mapping_of(found, best, confirmations, notes)
    names = ranked_by(study.plan)
    style = stream_style(sys.stdout)
    outcome.text = render_analysis(
        found.responses, found.choices, names, best, confirmations, notes, style, found.truths
    )
    if out is not None:
        content = page_of(state, found, best, confirmations, notes).encode()
        output_files.make_folder(out.parent)
        hint = "Choose another name, or replace it with --overwrite."
        output_files.write(out, content, hint, overwrite=overwrite)
        outcome.text += f"\n\nPage {out}"


@command("study export")
def export(
    outcome: Outcome,
    folder: FolderArgument,
    out: TableOption = None,
    form: FormatOption = None,
    profiles: ProfilesOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write the table of runs: a row a run, a column a factor key and response. Or profiles of the best points."""
    from edmctl.jobs import output_files
    from edmctl.jobs.runs.export import REPLACE_HINT, export_request
    from edmctl.jobs.study.reporting import write_profiles
    from edmctl.jobs.study.table import columns_of, table_bytes, table_of

    study = opened(folder)
    state = study.read()
    if profiles is not None:
        written = write_profiles(state, profiles, overwrite=overwrite)
        outcome.result = {"profiles": [str(path) for path in written]}
        outcome.text = "\n".join(map(str, written))
        return
    request = export_request(
        "table", folder, ["runs"], ["runs"], form, out, as_json=outcome.output.json, overwrite=overwrite
    )
    content = table_bytes(table_of(state), str(request.form), columns_of(state))
    if request.to_stdout:
        from edmctl.cli.run.export import stdout

        with stdout() as sink:
            sink.write(content)
        return
    path = request.path_of("runs")
    output_files.write(path, content, REPLACE_HINT, overwrite=overwrite)
    outcome.result = {"file": str(path), "rows": len(state.runs), "bytes": len(content)}
    outcome.text = f"{path}: {plural(len(state.runs), 'row')}"
