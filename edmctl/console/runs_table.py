"""A folder of runs as a table, the newest last: where the eye is when a command has ended."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Ink, Style
from edmctl.console.tables import render_columns, wrapped
from edmctl.labels import Basis, marked, meanings
from edmctl.wording import decimal, duration, ended_as, escaped, printable, with_u95

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FIRST_TO_GO = ("size", "seed", "sites", "work", "machining", "profile", "wear", "start (UTC)")
"""Columns that a narrow terminal does without, one after the other."""
LEAST_NAME = 11
"""Letters that are left of the name of a run where there is no room."""
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_NUMBERS = ("depth µm", "wear µm", "sites", "machining", "size", "seed")


class HeadView(Protocol):
    """One run of a folder."""

    @property
    def file_name(self) -> str: ...
    @property
    def size_bytes(self) -> int: ...
    @property
    def name(self) -> str: ...
    @property
    def start_time(self) -> str: ...
    @property
    def status(self) -> str: ...
    @property
    def exit_code(self) -> int | None: ...
    @property
    def error_code(self) -> str: ...
    @property
    def simulated(self) -> bool: ...
    @property
    def seed(self) -> int | None: ...
    @property
    def work(self) -> str: ...
    @property
    def tool(self) -> str: ...
    @property
    def sites(self) -> int: ...
    @property
    def through(self) -> int: ...
    @property
    def depth_um(self) -> float: ...
    @property
    def depth_u95_um(self) -> float: ...
    @property
    def est_depth_um(self) -> float: ...
    @property
    def wear_um(self) -> float: ...
    @property
    def wear_u95_um(self) -> float: ...
    @property
    def machining_time_s(self) -> float: ...
    @property
    def depth_basis(self) -> str: ...
    @property
    def wear_basis(self) -> str: ...


@dataclass(frozen=True, slots=True)
class BrokenFile:
    """A file that cannot be read: what it is in a word or two, and the whole message."""

    file_name: str
    size_bytes: int
    start_time: str
    word: str
    message: str


def render_runs(
    runs: Sequence[HeadView | BrokenFile], style: Style = PLAIN, columns: int | None = None
) -> str:
    """Render a line per run; below it what is wrong with those that cannot be read.

    columns : width of the terminal; columns are left out until the table fits. None: all are shown.
    """
    shown = _columns()
    hidden: list[str] = []
    table = _table(runs, shown, style)
    for name in FIRST_TO_GO:
        if columns is None or _width(table) <= columns:
            break
        shown = {header: cell for header, cell in shown.items() if not header.startswith(name)}
        hidden.append(name)
        table = _table(runs, shown, style)
    if columns is not None and _width(table) > columns:
        shown["status"] = _short_status
        table = _table(runs, shown, style)
    if columns is not None and (excess := _width(table) - columns) > 0:
        widest = max(len(_name(run)) for run in runs)
        table = _table(runs, shown, style, max(LEAST_NAME, widest - excess))
    notes = [
        "tip: of a hole through a sheet, how far the tip went below the face."
        if any(map(_through, runs))
        else "",
        *meanings({basis for run in runs for basis in _bases(run)}),
        "Depth and wear of several sites are their means." if any(_sites(run) > 1 for run in runs) else "",
        f"Not shown, for want of width: {', '.join(reversed(hidden))}." if hidden else "",
    ]
    wrong = [escaped(run.message) for run in runs if isinstance(run, BrokenFile)]
    told = [line for note in notes if note for line in (wrapped(note, columns) if columns else [note])]
    parts = [table, style.paint("\n".join(told), Ink.FAINT), "\n".join(wrong)]
    return "\n\n".join(filter(None, parts))


def _columns() -> dict[str, Callable[[HeadView], str]]:
    return {
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
        "size": lambda run: size(run.size_bytes),
    }


def _table(
    runs: Sequence[HeadView | BrokenFile],
    columns: dict[str, Callable[[HeadView], str]],
    style: Style,
    longest_name: int | None = None,
) -> str:
    """The table; names longer than `longest_name` lose their middle."""
    rows = [_row(run, columns) for run in runs]
    if longest_name is not None:
        rows = [[_without_middle(name, longest_name), *cells] for name, *cells in rows]
    align = "".join(">" if header in _NUMBERS else "<" for header in columns)
    return render_columns(list(columns), rows, style, align)


def _row(run: HeadView | BrokenFile, columns: dict[str, Callable[[HeadView], str]]) -> list[str]:
    if not isinstance(run, BrokenFile):
        return [cell(run) for cell in columns.values()]
    known = {
        "run": _name(run),
        "start (UTC)": start_utc(run.start_time),
        "status": run.word,
        "size": size(run.size_bytes),
    }
    return [known.get(header, "") for header in columns]


def _name(run: HeadView | BrokenFile) -> str:
    return escaped(run.file_name.removesuffix(".h5"))


def _without_middle(name: str, longest: int) -> str:
    if len(name) <= longest:
        return name
    head = (longest - 1) // 2
    return f"{name[:head]}…{name[head + 1 - longest :]}"


def _short_status(run: HeadView) -> str:
    return f"exit {run.exit_code}" if run.exit_code else _status(run)


def _status(run: HeadView) -> str:
    status = printable(ended_as(run.status, run.error_code))
    return f"{status} ({run.exit_code})" if run.exit_code else status


def _depth(run: HeadView) -> str:
    if not math.isfinite(run.depth_um) and math.isfinite(run.est_depth_um):
        return marked(decimal(run.est_depth_um, 1), Basis.ESTIMATED)
    depth_um = marked(with_u95(run.depth_um, run.depth_u95_um), run.depth_basis)
    return f"{'tip ' if run.through else ''}{depth_um}"


def _bases(run: HeadView | BrokenFile) -> tuple[str, ...]:
    if isinstance(run, BrokenFile):
        return ()
    left = Basis.ESTIMATED if math.isfinite(run.est_depth_um) and not math.isfinite(run.depth_um) else ""
    return (run.depth_basis, run.wear_basis, left)


def _through(run: HeadView | BrokenFile) -> int:
    return 0 if isinstance(run, BrokenFile) else run.through


def _sites(run: HeadView | BrokenFile) -> int:
    return 0 if isinstance(run, BrokenFile) else run.sites


def _width(table: str) -> int:
    return max(len(_COLOUR.sub("", line)) for line in table.splitlines())


def start_utc(iso: str) -> str:
    """Return an ISO time to the second, in UTC; as it is where it is none."""
    try:
        time = datetime.fromisoformat(iso)
    except ValueError:
        return printable(iso) or "–"
    return f"{time.astimezone(UTC) if time.tzinfo else time:%Y-%m-%d %H:%M:%S}"


def size(size_bytes: int) -> str:
    """Return the size of a file: `640 B`, `2.1 MB`."""
    value, unit = float(size_bytes), "B"
    for larger in ("kB", "MB", "GB", "TB"):
        if value < 999.5:
            break
        value, unit = value / 1000.0, larger
    return f"{value:.0f} {unit}" if unit == "B" or value >= 99.5 else f"{value:.1f} {unit}"
