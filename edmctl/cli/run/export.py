"""`edmctl run export`: the tables of a run as CSV, Parquet or JSON, for whatever reads those."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl import failures
from edmctl.cli.options import RunArgument, command
from edmctl.cli.outcome import Outcome, mutter, unwritable
from edmctl.cli.render.terminal import render_columns
from edmctl.errors import EdmError
from edmctl.jobs.runs.opening import find_run, plain_stem, reading_unless_killed
from edmctl.results.run_file import Exported
from edmctl.wording import count, file_size

if TYPE_CHECKING:
    from edmctl.jobs.output_files import Sink
    from edmctl.jobs.runs.export import ExportRequest
    from edmctl.record.reader import RunFile
    from edmctl.report.export import ExportTable, TableWriter

TableOption = Annotated[
    list[str] | None,
    typer.Option(
        "--table",
        "-t",
        metavar="TABLE",
        help="servo, slow, pulses, blocks, segments, events, touches, results, black-box, waveforms or link. "
        "Default: all that have rows. Repeatable.",
    ),
]
FormatOption = Annotated[
    str | None,
    typer.Option(
        "--format", metavar="FORMAT", help="csv, parquet, json or jsonl. Default: the ending of -o, else csv."
    ),
]
ExportOutOption = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="FILE|FOLDER|-",
        help="A file by its ending (one table), the folder, or - for stdout. Default: stdout for one table, "
        "else files beside the run file.",
    ),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace files of the same name.")]
HEADER = ("table", "rows", "size", "file")
OTHER_LOG = {"pulses": "blocks", "blocks": "pulses"}
"""A run logs single pulses, or sums over blocks of them."""


@command("run export")
def export(
    outcome: Outcome,
    file: RunArgument,
    table: TableOption = None,
    form: FormatOption = None,
    out: ExportOutOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write tables of a run as CSV, Parquet or JSON.

    The name of each column has its unit.
    """
    from edmctl.jobs.runs.export import Format, export_request
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
        with stdout() as sink:
            _write(opened, request, tables[0], sink)
        return
    request.check_free([table.name for table in tables])
    if request.folder is not None:
        make_folder(request.folder)
    written: list[Exported] = []
    outcome.result = {"tables": written}
    rows: list[list[str]] = []
    outcome.show(lambda style: render_columns(HEADER, rows, style, "<>><") if rows else "")
    for table in tables:
        path = request.path_of(table.name)
        with new_file(path, overwrite=request.overwrite) as sink:
            _write(opened, request, table, sink)
        columns = [column.name for column in table.columns]
        size_bytes = path.stat().st_size
        written.append(Exported(table.name, str(path), table.rows, size_bytes, columns))
        rows.append([table.name, count(table.rows), file_size(size_bytes), str(path)])


def _write(opened: "RunFile", request: "ExportRequest", table: "ExportTable", sink: "Sink") -> None:
    from edmctl.jobs.runs.export import Format
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


class NobodyReads(EdmError):
    """The reader of stdout has gone: no failure of the command."""


@contextmanager
def stdout() -> Iterator["Sink"]:
    """Give a sink into stdout; that nobody reads any more ends the block in order. Raises RunFileError E9010."""
    from edmctl.jobs.output_files import Sink

    def error_of(refused: OSError) -> EdmError:
        return NobodyReads("") if isinstance(refused, BrokenPipeError) else unwritable(refused)

    sys.stdout.flush()
    try:
        sink = Sink(sys.stdout.buffer, error_of)
        yield sink
        sink.flush()
    except NobodyReads:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
