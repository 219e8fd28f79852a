"""Tables of docs/run-file.md, from the layout of the run file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.record import layout
from tools.generate.text import table

if TYPE_CHECKING:
    from edmctl.record.layout import Table


def layout_tables() -> str:
    """Return the whole layout."""
    groups = [(f"`{group.path}`", group.nx_class, group.note) for group in layout.GROUPS]
    scalars = [(f"`{s.path}`", s.dtype, s.units or "–", s.long_name) for s in layout.SCALARS]
    parts = [
        "\n### Groups\n",
        table(("path", "NeXus class", "holds"), groups),
        "### Single values\n",
        table(("path", "type", "unit", "meaning"), scalars),
    ]
    for part in layout.TABLES:
        rows = [(f"`{c.name}`", c.dtype, c.units or "–", c.long_name) for c in part.columns]
        parts.append(f"### `{part.path}`\n\n{_sentence(part.note)} {_kind(part)}\n")
        parts.append(table(("name", "type", "unit", "meaning"), rows))
    grid = layout.TRUTH
    axes = " and ".join(f"`{axis.name}`" for axis in grid.columns[1:])
    kind = f"NXdata; viewers plot `{grid.signal}` as an image over {axes}."
    sizes = zip(grid.columns, ("rows × columns", "rows", "columns"), strict=True)
    rows_of_grid = [(f"`{c.name}`", shape, c.dtype, c.units, c.long_name) for c, shape in sizes]
    parts.append(f"### `{grid.path}`\n\n{_sentence(grid.note)} {kind}\n")
    parts.append(table(("name", "shape", "type", "unit", "meaning"), rows_of_grid))
    return "\n".join(parts) + "\n"


def _kind(part: Table) -> str:
    """What a table is to HDF5, and what viewers make of it."""
    if part.is_compound:
        return "One compound dataset."
    kind = f"{part.nx_class}, one dataset per column"
    if not part.signal:
        return f"{kind}."
    plotted = " and ".join(f"`{name}`" for name in (part.signal, *part.auxiliary))
    return (
        f"{kind}; viewers plot {plotted} over {f'`{part.axis}`' if part.axis else 'the number of the row'}."
    )


def _sentence(note: str) -> str:
    return f"{note[0].upper()}{note[1:]}."
