"""What an export has written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.console.runs_table import size
from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.wording import count

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class Exported:
    """One table that became a file."""

    table: str
    path: str
    rows: int
    size_bytes: int
    columns: Sequence[str]


def render_export(written: Sequence[Exported], style: Style = PLAIN) -> str:
    """Render a line per file."""
    rows = [[one.table, count(one.rows), size(one.size_bytes), one.path] for one in written]
    return render_columns(["table", "rows", "size", "file"], rows, style, "<>><")
