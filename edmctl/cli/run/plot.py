"""`edmctl run plot`: figures, and a page with all of them, from a run file alone."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import RunArgument, command
from edmctl.cli.outcome import Outcome, mutter
from edmctl.jobs.runs.opening import find_run, plain_stem, reading_unless_killed
from edmctl.report.kinds import draw
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.jobs.runs.plot import PlotRequest, Target
    from edmctl.record.reader import RunFile

KindOption = Annotated[
    list[str] | None,
    typer.Option(
        "--kind",
        metavar="KIND",
        help="One of those below. Default: all that the run has data for. Repeatable.",
        autocompletion=completion.figures,
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="FILE|FOLDER",
        help="A file by its ending (one figure), or the folder. Default: beside the run file.",
    ),
]
FormatOption = Annotated[
    str | None,
    typer.Option("--format", metavar="FORMAT", help="Format of the figures: png (default), svg or pdf."),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace figures of the same name.")]


@command("run plot")
def plot(
    outcome: Outcome,
    file: RunArgument,
    kind: KindOption = None,
    out: OutOption = None,
    form: FormatOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Draw figures of a run, or one page with all of it.

    Figures are for print or for the screen; --kind report makes an HTML page with all of them.
    """
    from edmctl.jobs.runs.plot import plot_request
    from edmctl.report.kinds import need_matplotlib

    path = find_run(file)
    request = plot_request(plain_stem(path), path.parent, kind or [], out, form)
    need_matplotlib()
    with reading_unless_killed(path) as opened:
        outcome.run_file = path
        outcome.simulated = opened.is_simulated
        outcome.seed = opened.seed
        left = request.to_draw(overwrite)
        _draw(outcome, opened, left, overwrite)
    if len(left.targets) < len(request.targets):
        kept = len(request.targets) - len(left.targets)
        mutter(f"{plural(kept, 'figure')} of that name kept: --overwrite draws them anew\n")


def _draw(outcome: Outcome, opened: "RunFile", request: "PlotRequest", overwrite: bool) -> None:
    """Draw and write one file after the other, so that earlier ones remain if a later one fails."""
    from edmctl.jobs import output_files
    from edmctl.jobs.runs.plot import REPLACE_HINT
    from edmctl.report.style import NothingToDraw

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
        output_files.write(target.path, content, REPLACE_HINT, overwrite=overwrite)
        written.append({"kind": target.name, "file": str(target.path), "bytes": len(content)})
        outcome.text = "\n".join(f"{entry['kind']:<13} {entry['file']}" for entry in written)
    if nothing and (request.by_name or not written):
        raise failures.nothing_to_draw(
            problem=" ".join(f"Nothing to draw for {entry['kind']}: {entry['why']}" for entry in nothing),
            remedy="Without --kind, what there is something for is drawn."
            if written or request.by_name
            else "",
        )
    for entry in nothing:
        mutter(f"no {entry['kind']}: {entry['why']}\n")


def _content(opened: "RunFile", target: "Target") -> bytes:
    """Return the bytes of the file. Raises NothingToDraw."""
    if target.kind is None:
        return page_of(opened).encode()
    from edmctl.report.style import house_style, rendered

    with house_style():
        return rendered(draw(target.kind, opened), target.path.suffix.lower())


def page_of(opened: "RunFile") -> str:
    """The page with all figures and numbers of an open run file."""
    from edmctl.jobs.runs.explanation import sentences_of, trouble_of
    from edmctl.report.page import pictures_of, render_page

    sentences = sentences_of(opened)
    return render_page(opened, pictures_of(opened), sentences, trouble_of(sentences))
