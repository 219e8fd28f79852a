"""The request of `run plot`: figures and files, resolved before anything is read or drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.jobs import output_files
from edmctl.report.kinds import KINDS, NAMES, REPORT, Kind, kind_called
from edmctl.wording import did_you_mean

FORMATS = ("png", "svg", "pdf")
PAGE_SUFFIX = ".html"
REPLACE_HINT = "Choose another place with --out, or replace it with --overwrite."


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
            output_files.check_folder(target.path.parent)
        existing = [] if overwrite else [target for target in self.targets if target.path.exists()]
        if existing and (self.by_name or len(existing) == len(self.targets)):
            output_files.check_free(existing[0].path, REPLACE_HINT)
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
