"""The request of `run plot`: figures and files, resolved before anything is read or drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.jobs import output_files
from edmctl.report.kinds import KINDS, NAMES, REPORT, Kind, kind_called
from edmctl.wording import did_you_mean

FORMATS = ("png", "svg", "pdf")
PAGE_SUFFIX = ".html"


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
        """Return the request without the figures that are there already, where not every one of them was named.

        Raises RunFileError: E9011 every figure is there, or one that was named; E9012 a folder cannot be made.
        """
        for target in self.targets:
            output_files.check_folder(target.path.parent)
        there = [] if overwrite else [target for target in self.targets if target.path.exists()]
        if there and (self.by_name or len(there) == len(self.targets)):
            output_files.check_free(there[0].path, REPLACE_HINT)
        return replace(self, targets=tuple(target for target in self.targets if target not in there))


REPLACE_HINT = "Choose another place with --out, or replace it with --overwrite."


def plot_request(
    stem: str, beside: Path, kinds: Sequence[str], out: Path | None, form: str | None
) -> PlotRequest:
    """Resolve the files: `STEM-KIND.png` in the folder `beside`, in that of `out`, or the one file `out`.

    Raises UsageError: E2070 no such kind, E2071 one file for several figures, E2072 formats that contradict.
    """
    names = list(dict.fromkeys(kinds)) or [kind.name for kind in KINDS]
    for name in names:
        _check_kind(name)
    if form is not None and form not in FORMATS:
        raise failures.figure_format_unknown(form=form, formats=", ".join(FORMATS))
    if names == [REPORT] and form is not None:
        raise failures.report_is_html()
    suffixes = {name: PAGE_SUFFIX if name == REPORT else f".{form or FORMATS[0]}" for name in names}
    paths = dict(_paths(stem, out or beside, suffixes, form))
    return PlotRequest(
        tuple(Target(name, None if name == REPORT else kind_called(name), paths[name]) for name in names),
        bool(kinds),
    )


def _paths(stem: str, out: Path, suffixes: dict[str, str], form: str | None) -> Iterator[tuple[str, Path]]:
    """Give the path of each kind; `out` is a file if it has an ending, else a folder."""
    if str(out) == "-":
        raise failures.figures_to_stdout()
    known = {f".{name}" for name in FORMATS} | {PAGE_SUFFIX}
    if out.suffix and out.suffix.lower() not in known and not out.is_dir():
        raise failures.figure_ending_unknown(out=out.name, known=", ".join(sorted(known)))
    if not out.suffix or out.is_dir():
        yield from ((name, out / f"{stem}-{name}{suffix}") for name, suffix in suffixes.items())
        return
    if len(suffixes) > 1:
        raise failures.several_figures_one_file(suffixes_count=len(suffixes), out=out)
    (name,) = suffixes
    wanted = {PAGE_SUFFIX} if name == REPORT else known - {PAGE_SUFFIX} if form is None else {f".{form}"}
    if out.suffix.lower() not in wanted:
        what = "The report" if name == REPORT else "A figure"
        raise failures.figure_name_ending(
            what=what,
            out=out.name,
            wanted=" or ".join(sorted(wanted)),
            remedy="Choose another name for --out" + (", or leave --format out." if form else "."),
        )
    yield name, out


def _check_kind(name: str) -> None:
    if name in NAMES:
        return
    raise failures.figure_kind_unknown(name=name, meant=did_you_mean(name, NAMES), names=", ".join(NAMES))
