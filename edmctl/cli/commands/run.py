"""`edmctl run`: list, show, explain, compare, recover, export and draw run files."""

import sys
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import PROGRESS, RunArgument, argument, command, command_group, option
from edmctl.cli.outcome import Outcome, mutter, stdout_sink, watching
from edmctl.cli.render.result_table import render_run, render_sentences
from edmctl.cli.render.runs_tables import letter, render_comparison, render_runs
from edmctl.cli.render.terminal import render_columns
from edmctl.errors import RunFileError
from edmctl.jobs.runs.opening import (
    RUNS,
    command_to_go_on,
    find_run,
    plain_stem,
    reading_unless_killed,
    unless_killed,
)
from edmctl.report.kinds import draw, kinds_table
from edmctl.results.run_file import Exported, RunHead, Unreadable
from edmctl.wording import count, file_size, iso_of, plural, utc_of

if TYPE_CHECKING:
    from edmctl.jobs.output_files import Sink
    from edmctl.jobs.runs.outputs import ExportRequest, PlotRequest, Target
    from edmctl.record.reader import RunFile
    from edmctl.report.export import ExportTable, TableWriter

app = command_group("Show, compare, export, draw and recover run files.")

FollowOption = Annotated[
    bool, option("--follow -f", "Follow a run until it ends; Ctrl-C ends the following.")
]
FolderArgument = Annotated[Path, argument("[FOLDER]", f"Folder of the run files. Default: {RUNS}.")]
FilesArgument = Annotated[
    list[Path],
    argument(
        "RUN RUN...",
        "Run files, or ids of runs in runs/. All are compared with the first.",
        autocompletion=completion.runs,
    ),
]
ComparisonOutOption = Annotated[
    Path | None, option("--out -o FIGURE", "Draw them too, into a new file: .png, .svg or .pdf.")
]
DamagedArgument = Annotated[
    Path,
    argument(
        "RUN",
        "A run file without an end (.h5.partial), or a damaged one; or the id of a run in runs/.",
        autocompletion=completion.unfinished,
    ),
]
NewFileOption = Annotated[
    Path | None, option("--out -o FILE", "The new file. Default: RUN without .partial, beside it.")
]
TableOption = Annotated[
    list[str] | None,
    option(
        "--table -t TABLE",
        "servo, slow, pulses, blocks, segments, events, touches, results, black-box, waveforms or link. "
        "Default: all that have rows. Repeatable.",
    ),
]
TableFormatOption = Annotated[
    str | None, option("--format FORMAT", "csv, parquet, json or jsonl. Default: the ending of -o, else csv.")
]
TablesOutOption = Annotated[
    Path | None,
    option(
        "--out -o FILE|FOLDER|-",
        "A file by its ending (one table), the folder, or - for stdout. Default: stdout for one table, "
        "else files beside the run file.",
    ),
]
KindOption = Annotated[
    list[str] | None,
    option(
        "--kind KIND",
        "One of those below. Default: all that the run has data for. Repeatable.",
        autocompletion=completion.figures,
    ),
]
FiguresOutOption = Annotated[
    Path | None,
    option(
        "--out -o FILE|FOLDER",
        "A file by its ending (one figure), or the folder. Default: beside the run file.",
    ),
]
FigureFormatOption = Annotated[
    str | None, option("--format FORMAT", "Format of the figures: png (default), svg or pdf.")
]
OverwriteOption = Annotated[bool, option("--overwrite", "Replace files of the same name.")]
OTHER_LOG = {"pulses": "blocks", "blocks": "pulses"}
"""A run logs single pulses, or sums over blocks of them."""


@app.command("list")
@command("run list")
def list_runs(outcome: Outcome, folder: FolderArgument = RUNS) -> None:
    """List the runs of a folder: status, depth, wear and time of each, the newest last."""
    from edmctl.record.reader import heads_of, read_head

    runs: list[RunHead | Unreadable] = []
    if folder.is_dir():
        runs = sorted(heads_of(folder), key=_start)
    elif folder != RUNS:
        named = find_run(folder)
        if not named.exists():
            raise failures.folder_or_run_missing(folder=folder)
        runs = [read_head(named)]
    outcome.result = {"folder": str(folder), "runs": [_as_mapping(head) for head in runs]}
    if runs:
        outcome.show(lambda style: render_runs(runs, style))
    else:
        outcome.text = f"No run files in {folder}."


def _start(head: RunHead | Unreadable) -> tuple[str, str]:
    """Return the sort key: the start, or the last change of an unreadable file."""
    if isinstance(head, Unreadable):
        return iso_of(head.changed_s), head.path.name
    start = utc_of(head.start_time)
    return start.isoformat() if start else "", head.path.name


def _as_mapping(file: RunHead | Unreadable) -> dict[str, object]:
    if not isinstance(file, Unreadable):
        return {**asdict(file), "path": str(file.path), "error": None}
    return {
        "path": str(file.path),
        "size_bytes": file.size_bytes,
        "error": {"code": file.error.code, "message": file.error.message, "hint": file.error.hint},
    }


@app.command()
@command("run show", PROGRESS)
def show(outcome: Outcome, file: RunArgument, follow: FollowOption = False) -> None:
    """Show one run: target, results, times and contents of the file."""
    from edmctl.jobs.runs.summary import summary_of
    from edmctl.record.reader import reading

    path = find_run(file)
    if follow:
        from edmctl.jobs.runs.follow import follow_run

        try:
            with watching(outcome.output) as reporter:
                path = follow_run(path, reporter)
        except RunFileError as error:
            if error.code != "E9008":  # what a killed writer has left is shown
                raise
    with reading(path) as opened:
        outcome.run_file = path
        summary = summary_of(opened)
        outcome.simulated, outcome.seed = summary.simulated, summary.seed
        outcome.result = summary.as_mapping()
        outcome.show(lambda style: render_run(summary, style))
        unless_killed(opened, summary.way_on)


@app.command()
@command("run explain")
def explain(outcome: Outcome, file: RunArgument) -> None:
    """Describe a run in plain sentences: what it did, when, and why."""
    from edmctl.jobs.runs.summary import sentences_of
    from edmctl.record.reader import reading

    with reading(find_run(file)) as opened:
        outcome.run_file = opened.path
        outcome.simulated = opened.is_simulated
        sentences = sentences_of(opened)
        outcome.result = {"story": sentences}
        outcome.show(lambda style: render_sentences(sentences, style))
        unless_killed(opened, command_to_go_on(opened.path))


@app.command()
@command("run export")
def export(
    outcome: Outcome,
    file: RunArgument,
    table: TableOption = None,
    form: TableFormatOption = None,
    out: TablesOutOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write tables of a run as CSV, Parquet or JSON.

    The name of each column has its unit.
    """
    from edmctl.jobs.runs.outputs import Format, export_request
    from edmctl.report.export import TABLES, need_pyarrow

    path = find_run(file)
    request = export_request(
        plain_stem(path),
        path.parent,
        list(TABLES),
        table or [],
        form,
        out,
        as_json=outcome.output.json,
        overwrite=overwrite,
    )
    if request.form is Format.PARQUET:
        need_pyarrow()
        if request.to_stdout and sys.stdout.isatty():
            raise failures.parquet_on_terminal()
    with reading_unless_killed(path) as opened:
        outcome.run_file = path
        outcome.simulated = opened.is_simulated
        _export(outcome, opened, request)


def _export(outcome: Outcome, opened: "RunFile", request: "ExportRequest") -> None:
    """Write one table after the other, so that earlier ones remain if a later one fails."""
    from edmctl.jobs.output_files import make_folder, new_file
    from edmctl.machine.interface import EventCode
    from edmctl.record.rows import RunEvent
    from edmctl.report.export import TABLES, ExportTable

    names = {int(code): code.name for code in (*EventCode, *RunEvent)}
    tables = [ExportTable(opened, name, names) for name in request.tables or TABLES]
    if not request.tables:
        tables = [table for table in tables if table.rows]
    for table in tables:
        other = OTHER_LOG.get(table.name, "")
        if other and not table.rows and ExportTable(opened, other, names).rows:
            mutter(f"There are no {table.name} in this run: it logged {other} (-t {other}).\n")
    if request.to_stdout:
        with stdout_sink() as sink:
            _write(opened, request, tables[0], sink)
        return
    request.check_free([table.name for table in tables])
    if request.folder is not None:
        make_folder(request.folder)
    written: list[Exported] = []
    outcome.result = {"tables": written}
    rows: list[list[str]] = []
    header = ("table", "rows", "size", "file")
    outcome.show(lambda style: render_columns(header, rows, style, "<>><") if rows else "")
    for table in tables:
        path = request.path_of(table.name)
        with new_file(path, overwrite=request.overwrite) as sink:
            _write(opened, request, table, sink)
        columns = [column.name for column in table.columns]
        size_bytes = path.stat().st_size
        written.append(Exported(table.name, str(path), table.rows, size_bytes, columns))
        rows.append([table.name, count(table.rows), file_size(size_bytes), str(path)])


def _write(opened: "RunFile", request: "ExportRequest", table: "ExportTable", sink: "Sink") -> None:
    from edmctl.jobs.runs.outputs import Format
    from edmctl.report.export import CsvWriter, JsonWriter, ParquetWriter

    writer: TableWriter
    if request.form is Format.PARQUET:
        about = {name: opened.text(f"/entry/{name}") for name in ("run_id", "title", "start_time", "status")}
        writer = ParquetWriter(sink, table.columns, {**about, "table": table.name})
    elif request.form is Format.CSV:
        writer = CsvWriter(sink, table.columns)
    else:
        writer = JsonWriter(sink, table.columns, lines=request.form is Format.JSONL)
    for block in table.blocks():
        writer.write(block)
    writer.close()


@app.command()
@command("run recover")
def recover(outcome: Outcome, file: DamagedArgument, out: NewFileOption = None) -> None:
    """Make a complete file of an interrupted run. The old file is not changed."""
    from edmctl.jobs.runs.opening import recover_file
    from edmctl.record.reader import open_run
    from edmctl.record.recovery import is_complete

    path = find_run(file)
    made = None if is_complete(path) else recover_file(path, out)
    outcome.run_file = made.path if made else path
    with open_run(outcome.run_file) as opened:
        outcome.simulated = opened.is_simulated
        status = opened.text("/entry/status")
    if made is None:
        outcome.result = {"recovered": False, "from": str(path)}
        outcome.text = f"{path} is complete: there is nothing to recover."
        return
    rows = {"rows": made.rows, "lost_rows": made.lost_rows, "unread_rows": made.unread_rows}
    outcome.result = {"recovered": True, "from": str(path), "status": status, **rows}
    outcome.show(f"Recovered into {made.path}, status `{status}`.")
    outcome.show(f"Rows: {_counted(made.rows) or 'none'}.")
    if made.lost_rows:
        outcome.show(f"Rows that were begun or cannot be read: {_counted(made.lost_rows)}.")
    if made.unread_rows:
        outcome.show(f"Not readable, and NaN or 0 in the new file: {_counted(made.unread_rows)}.")
    outcome.show(f"{path} is not changed; delete it when the new file is what you need.")


def _counted(rows: Mapping[str, int]) -> str:
    return ", ".join(
        f"{count(number)} of {table.removeprefix('/entry/').replace('_', ' ')}"
        for table, number in rows.items()
        if number
    )


@app.command(epilog="\b\nKinds of figures:\n" + kinds_table())
@command("run plot")
def plot(
    outcome: Outcome,
    file: RunArgument,
    kind: KindOption = None,
    out: FiguresOutOption = None,
    form: FigureFormatOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Draw figures of a run, or one page with all of it.

    Figures are for print or for the screen; --kind report makes an HTML page with all of them.
    """
    from edmctl.jobs.runs.outputs import plot_request
    from edmctl.report.kinds import need_matplotlib

    path = find_run(file)
    request = plot_request(plain_stem(path), path.parent, kind or [], out, form)
    need_matplotlib()
    with reading_unless_killed(path) as opened:
        outcome.run_file = path
        outcome.simulated = opened.is_simulated
        outcome.seed = opened.seed
        to_draw = request.to_draw(overwrite)
        _draw(outcome, opened, to_draw, overwrite)
    if kept := len(request.targets) - len(to_draw.targets):
        mutter(f"{plural(kept, 'figure')} of that name kept: --overwrite draws them anew\n")


def _draw(outcome: Outcome, opened: "RunFile", request: "PlotRequest", overwrite: bool) -> None:
    """Draw and write one file after the other, so that earlier ones remain if a later one fails."""
    from edmctl.jobs import output_files
    from edmctl.jobs.runs.outputs import REPLACE_FIGURE_HINT
    from edmctl.report.panels import NothingToDraw

    written: list[dict[str, object]] = []
    nothing: list[dict[str, object]] = []
    outcome.result = {"figures": written, "nothing": nothing}
    for number, target in enumerate(request.targets, start=1):
        if sys.stderr.isatty():
            mutter(f"drawing {target.name} ({number} of {len(request.targets)})\n")
        try:
            content = _content(opened, target)
        except NothingToDraw as reason:
            nothing.append({"kind": target.name, "why": str(reason)})
            continue
        output_files.make_folder(target.path.parent)
        output_files.write(target.path, content, REPLACE_FIGURE_HINT, overwrite=overwrite)
        written.append({"kind": target.name, "file": str(target.path), "bytes": len(content)})
        outcome.show(f"{target.name:<13} {target.path}")
    if nothing and (request.by_name or not written):
        raise failures.nothing_to_draw(
            problem=" ".join(f"Nothing to draw for {entry['kind']}: {entry['why']}" for entry in nothing),
            remedy="Without --kind, what there is something for is drawn." if request.by_name else "",
        )
    for entry in nothing:
        mutter(f"no {entry['kind']}: {entry['why']}\n")


def _content(opened: "RunFile", target: "Target") -> bytes:
    """Return the bytes of the file. Raises NothingToDraw."""
    if target.kind is None:
        from edmctl.jobs.runs.summary import sentences_of, trouble_of
        from edmctl.report.page import pictures_of, render_page

        sentences = sentences_of(opened)
        return render_page(opened, pictures_of(opened), sentences, trouble_of(sentences)).encode()
    from edmctl.report.panels import house_style, rendered

    with house_style():
        return rendered(draw(target.kind, opened), target.path.suffix.lower())


@app.command()
@command("run compare")
def compare(outcome: Outcome, files: FilesArgument, out: ComparisonOutOption = None) -> None:
    """Compare settings and results of runs.

    Marks differences larger than the uncertainty.
    """
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
        result = {key: getattr(found, key) for key in ("runs", "differs", "quantities", "sites")}
        result["figure"] = None
        outcome.simulated = all(run.simulated for run in found.runs)
        outcome.result = result
        outcome.show(lambda style: render_comparison(found, style))
        if out is not None:
            from edmctl.report.figures.comparisons import draw_runs
            from edmctl.report.panels import house_style, rendered

            with house_style():
                figure = draw_runs(runs, [letter(number) for number in range(len(runs))])
                output_files.write(out, rendered(figure, out.suffix.lower()))
            result["figure"] = str(out)
            outcome.text = f"Figure {out}"
