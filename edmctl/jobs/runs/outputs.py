"""The requests of `run export` and `run plot`, resolved before anything is read: names, formats, files."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.jobs.output_files import check_folder, check_free
from edmctl.report.kinds import KINDS, NAMES, REPORT, Kind, kind_called
from edmctl.wording import did_you_mean

STDOUT = Path("-")
REPLACE_TABLE_HINT = "Give another place with -o, or replace it with --overwrite."


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
                check_free(self.path_of(table), REPLACE_TABLE_HINT)


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


FORMATS = ("png", "svg", "pdf")
PAGE_SUFFIX = ".html"
REPLACE_FIGURE_HINT = "Choose another place with --out, or replace it with --overwrite."


@dataclass(frozen=True, slots=True)
class Target:
    """One file to write; `kind` is None for the page with all figures."""

    name: str
    kind: Kind | None
    path: Path


@dataclass(frozen=True, slots=True)
class PlotRequest:
    """`by_name`: the figures were named and must be drawn; otherwise those without data are skipped."""

    targets: tuple[Target, ...]
    by_name: bool

    def to_draw(self, overwrite: bool) -> PlotRequest:
        """Return the request without existing figures, unless each of them was named."""
        for target in self.targets:
            check_folder(target.path.parent)
        existing = [] if overwrite else [target for target in self.targets if target.path.exists()]
        if existing and (self.by_name or len(existing) == len(self.targets)):
            check_free(existing[0].path, REPLACE_FIGURE_HINT)
        return replace(self, targets=tuple(target for target in self.targets if target not in existing))


def plot_request(
    stem: str, beside: Path, kinds: Sequence[str], out: Path | None, form: str | None
) -> PlotRequest:
    """Resolve the files: `STEM-KIND.png` in the folder `beside`, in that of `out`, or the one file `out`."""
    names = list(dict.fromkeys(kinds)) or [kind.name for kind in KINDS]
    for name in names:
        if name not in NAMES:
            raise failures.figure_kind_unknown(
                name=name, meant=did_you_mean(name, NAMES), names=", ".join(NAMES)
            )
    if form is not None and form not in FORMATS:
        raise failures.figure_format_unknown(form=form, formats=", ".join(FORMATS))
    if names == [REPORT] and form is not None:
        raise failures.report_is_html()
    out = out or beside
    is_file = _is_file(out)
    if is_file and len(names) > 1:
        raise failures.several_figures_one_file(suffixes_count=len(names), out=out)
    if is_file:
        _check_ending(names[0], out, form)
    targets = []
    for name in names:
        suffix = PAGE_SUFFIX if name == REPORT else f".{form or FORMATS[0]}"
        path = out if is_file else out / f"{stem}-{name}{suffix}"
        targets.append(Target(name, None if name == REPORT else kind_called(name), path))
    return PlotRequest(tuple(targets), bool(kinds))


def _is_file(out: Path) -> bool:
    """Whether `out` is a file, by its ending; else it is a folder. Raises UsageError E2072."""
    if str(out) == "-":
        raise failures.figures_to_stdout()
    if not out.suffix or out.is_dir():
        return False
    known = sorted((PAGE_SUFFIX, *(f".{name}" for name in FORMATS)))
    if out.suffix.lower() not in known:
        raise failures.figure_ending_unknown(out=out.name, known=", ".join(known))
    return True


def _check_ending(name: str, out: Path, form: str | None) -> None:
    """Raise UsageError E2072 if the file has the ending of another format."""
    endings = [f".{form}"] if form else sorted(f".{name}" for name in FORMATS)
    if name == REPORT:
        endings = [PAGE_SUFFIX]
    if out.suffix.lower() not in endings:
        raise failures.figure_name_ending(
            what="The report" if name == REPORT else "A figure",
            out=out.name,
            wanted=" or ".join(endings),
            remedy="Choose another name for --out" + (", or leave --format out." if form else "."),
        )
