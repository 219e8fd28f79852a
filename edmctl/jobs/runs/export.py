"""The request of `run export`: tables, format and files."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.jobs.output_files import check_free
from edmctl.wording import did_you_mean

STDOUT = Path("-")
REPLACE_HINT = "Give another place with -o, or replace it with --overwrite."


class Format(StrEnum):
    """How tables are written; also the ending of their files."""

    CSV = "csv"
    PARQUET = "parquet"
    JSON = "json"
    JSONL = "jsonl"


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """`tables` are empty for all tables. With neither `file` nor `folder` the one table is written to stdout."""

    tables: tuple[str, ...]
    form: Format
    stem: str
    file: Path | None = None
    folder: Path | None = None
    overwrite: bool = False

    @property
    def to_stdout(self) -> bool:
        return self.file is None and self.folder is None

    def path_of(self, table: str) -> Path:
        """Return the file that a table goes to."""
        return self.file or (self.folder or Path()) / f"{self.stem}-{table}.{self.form}"

    def check_free(self, tables: Sequence[str]) -> None:
        """Raise RunFileError E9011 when one of the files is there already and is not to be replaced."""
        if not (self.to_stdout or self.overwrite):
            for table in tables:
                check_free(self.path_of(table), REPLACE_HINT)


def export_request(
    stem: str,
    beside: Path,
    known: Sequence[str],
    tables: Sequence[str],
    form: str | None,
    out: Path | None,
    *,
    as_json: bool,
    overwrite: bool = False,
) -> ExportRequest:
    """Return the request of the options.

    stem : name of the run; beside : its folder; known : the names of all tables

    A name without an ending is a folder, and so is an existing folder. Raises UsageError: E2080 no such table,
    E2081 no such format, also by the ending of the file, E2082 several tables into one file or to stdout, E2083
    --json with a table on stdout, E2084 the ending of the file is another format's.
    """
    names = tuple(dict.fromkeys(name.lower().replace("_", "-") for name in tables))
    for name in names:
        if name not in known:
            raise failures.table_unknown(name=name, meant=did_you_mean(name, known), known=", ".join(known))
    ending = out.suffix.lower().removeprefix(".") if out is not None else ""
    is_file = out is not None and ending in tuple(Format) and not out.is_dir()
    try:
        chosen = Format((form or (ending if is_file else "") or Format.CSV).lower())
    except ValueError:
        raise failures.export_format_unknown(asked=form, format=", ".join(Format)) from None
    if out is not None and out != STDOUT and ending and not (is_file or out.is_dir()):
        raise failures.export_ending_unknown(out=out.name, ending=ending, format=", ".join(Format))
    if is_file and ending != chosen:
        raise failures.export_format_and_ending(chosen=chosen, ending=ending)
    to_stdout = out == STDOUT or (out is None and len(names) == 1)
    if (is_file or to_stdout) and len(names) != 1:
        where = "stdout takes" if to_stdout else f"{out} takes"
        raise failures.several_tables_one_file(where=where, wanted_count=len(names) or "all")
    if to_stdout and as_json:
        raise failures.stdout_taken_by_json()
    if to_stdout:
        return ExportRequest(names, chosen, stem)
    file, folder = (out, None) if is_file else (None, out or beside)
    return ExportRequest(names, chosen, stem, file, folder, overwrite)
