"""A folder of runs as a table, the newest last: where the eye is when a command has ended."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from edmctl.console.layout import narrowed, not_shown, render_table, width_of, wrapped
from edmctl.console.style import PLAIN, Ink, Style
from edmctl.labels import Basis, marked, meanings
from edmctl.results.run_file import RunHead, Unreadable
from edmctl.wording import decimal, duration, ended_as, escaped, file_size, printable, start_utc, with_u95

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


FIRST_TO_GO = ("size", "seed", "sites", "work, tool", "machining", "profile", "wear µm", "start (UTC)")
"""Columns that a narrow terminal does without, one after the other."""
_UNREADABLE = {"E9005": "no run file", "E9006": "of a later version", "E9007": "damaged"}
_WORDS = ("start (UTC)", "status", "profile", "work, tool")


def render_runs(runs: Sequence[RunHead | Unreadable], style: Style = PLAIN) -> str:
    """Render a line per run; below it what is wrong with those that cannot be read.

    Columns are left out until the table fits a terminal.
    """
    columns = style.columns
    heads = [run for run in runs if not isinstance(run, Unreadable)]
    table = {name: [_cell(run, name, cell) for run in runs] for name, cell in _COLUMNS.items()}
    shown = narrowed(table, columns, FIRST_TO_GO)
    if columns is not None and width_of(shown) > columns:
        shown["status"] = [_cell(run, "status", _short_status) for run in runs]
    text = render_table(shown, style, left=_WORDS, cut_first="run")
    notes = [
        "tip: of a hole through a sheet, how far the tip went below the face."
        if any(run.through for run in heads)
        else "",
        *meanings({basis for run in heads for basis in _bases(run)}),
        "Depth and wear of several sites are their means." if any(run.sites > 1 for run in heads) else "",
        not_shown(table, shown),
    ]
    lines = [line for note in notes if note for line in (wrapped(note, columns) if columns else [note])]
    wrong = [escaped(run.error.message) for run in runs if isinstance(run, Unreadable)]
    parts = [text, style.paint("\n".join(lines), Ink.FAINT), "\n".join(wrong)]
    return "\n\n".join(filter(None, parts))


def _cell(run: RunHead | Unreadable, name: str, cell: Callable[[RunHead], str]) -> str:
    if not isinstance(run, Unreadable):
        return cell(run)
    known = {
        "run": _name(run),
        "start (UTC)": start_utc(datetime.fromtimestamp(run.changed_s, UTC).isoformat()),
        "status": _UNREADABLE.get(run.error.code, run.error.code),
        "size": file_size(run.size_bytes),
    }
    return known.get(name, "")


def _name(run: RunHead | Unreadable) -> str:
    return escaped(run.path.name.removesuffix(".h5"))


def _short_status(run: RunHead) -> str:
    return f"exit {run.exit_code}" if run.exit_code else _status(run)


def _status(run: RunHead) -> str:
    status = printable(ended_as(run.status, run.error_code))
    return f"{status} ({run.exit_code})" if run.exit_code else status


def _depth(run: RunHead) -> str:
    if not math.isfinite(run.depth_um) and math.isfinite(run.est_depth_um):
        return marked(decimal(run.est_depth_um, 1), Basis.ESTIMATED)
    depth_um = marked(with_u95(run.depth_um, run.depth_u95_um), run.depth_basis)
    return f"{'tip ' if run.through else ''}{depth_um}"


def _bases(run: RunHead) -> tuple[str, ...]:
    left = Basis.ESTIMATED if math.isfinite(run.est_depth_um) and not math.isfinite(run.depth_um) else ""
    return (run.depth_basis, run.wear_basis, left)


_COLUMNS: dict[str, Callable[[RunHead], str]] = {
    "run": _name,
    "start (UTC)": lambda run: start_utc(run.start_time),
    "status": _status,
    "profile": lambda run: printable(run.name),
    "work, tool": lambda run: printable(f"{run.work}, {run.tool}"),
    "depth µm": _depth,
    "wear µm": lambda run: marked(with_u95(run.wear_um, run.wear_u95_um), run.wear_basis),
    "sites": lambda run: str(run.sites or "–"),
    "machining": lambda run: duration(run.machining_time_s),
    "seed": lambda run: ("–" if run.seed is None else str(run.seed)) if run.simulated else "real",
    "size": lambda run: file_size(run.size_bytes),
}
