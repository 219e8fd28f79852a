"""Tables of the run file for people, made from the layout.

Renew the page with `python -m edmctl.record.documentation docs/run-file.md`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.record import layout

if TYPE_CHECKING:
    from edmctl.record.layout import Table

BEGIN = "<!-- layout: begin -->"
END = "<!-- layout: end -->"


def layout_markdown() -> str:
    """Return the whole layout as Markdown."""
    parts = ["### Groups\n", _table(("path", "NeXus class", "holds"), _group_rows())]
    parts += ["### Single values\n", _table(("path", "type", "unit", "meaning"), _scalar_rows())]
    for table in layout.TABLES:
        parts.append(f"### `{table.path}`\n\n{_sentence(table.note)} {_kind(table)}\n")
        rows: list[tuple[str, ...]] = [
            (f"`{c.name}`", c.dtype, c.units or "–", c.long_name) for c in table.columns
        ]
        parts.append(_table(("name", "type", "unit", "meaning"), rows))
    for grid in layout.GRIDS:
        axes = " and ".join(f"`{axis.name}`" for axis in grid.axes)
        kind = f"NXdata; viewers plot `{grid.signal.name}` as an image over {axes}."
        parts.append(f"### `{grid.path}`\n\n{_sentence(grid.note)} {kind}\n")
        sizes = zip((grid.signal, *grid.axes), ("rows × columns", "rows", "columns"), strict=True)
        parts.append(
            _table(
                ("name", "shape", "type", "unit", "meaning"),
                [(f"`{c.name}`", shape, c.dtype, c.units, c.long_name) for c, shape in sizes],
            )
        )
    return "\n".join(parts)


def replace_between_markers(page: str) -> str:
    """Return `page` with the text between the markers made anew."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n\n{layout_markdown()}\n{END}{after}"


def _kind(table: Table) -> str:
    """What a table is to HDF5, and what viewers make of it."""
    if table.is_compound:
        return "One compound dataset."
    kind = f"{table.nx_class}, one dataset per column"
    if not table.signal:
        return f"{kind}."
    plotted = " and ".join(f"`{name}`" for name in (table.signal, *table.auxiliary))
    return (
        f"{kind}; viewers plot {plotted} over {f'`{table.axis}`' if table.axis else 'the number of the row'}."
    )


def _sentence(note: str) -> str:
    return f"{note[0].upper()}{note[1:]}."


def _group_rows() -> list[tuple[str, ...]]:
    return [(f"`{group.path}`", group.nx_class, group.note) for group in layout.GROUPS]


def _scalar_rows() -> list[tuple[str, ...]]:
    return [(f"`{s.path}`", s.dtype, s.units or "–", s.long_name) for s in layout.SCALARS]


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    page_path = Path(sys.argv[1])
    page_path.write_text(replace_between_markers(page_path.read_text(encoding="utf-8")), encoding="utf-8")
