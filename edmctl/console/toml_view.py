"""Values as a TOML file that explains itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

from edmctl.console.style import PLAIN, Ink, Style
from edmctl.toml_text import Scalar, toml_scalar

if TYPE_CHECKING:
    from collections.abc import Sequence

Values: TypeAlias = "Mapping[str, Scalar]"

_COMMENT_COLUMN = 36


def render_toml(
    tables: Mapping[str, Values | Sequence[Values]],
    comments: Mapping[str, str],
    style: Style = PLAIN,
) -> str:
    """Return `tables` as TOML; `comments` has a text for `table.key` where there is one to say.

    A list of tables becomes an array of tables; an empty one is left out.
    """
    blocks = []
    for table, held in tables.items():
        if isinstance(held, Mapping):
            blocks.append(_block(f"[{table}]", table, held, comments, style))
        else:
            blocks += [_block(f"[[{table}]]", table, item, comments, style) for item in held]
    return "\n\n".join(blocks)


def _block(header: str, table: str, values: Values, comments: Mapping[str, str], style: Style) -> str:
    lines = [style.paint(header, Ink.STRONG)]
    for key, value in values.items():
        line = f"{key} = {toml_scalar(value)}"
        comment = comments.get(f"{table}.{key}", "")
        if comment:
            line = line.ljust(_COMMENT_COLUMN) + style.paint(f" # {comment}", Ink.FAINT)
        lines.append(line)
    return "\n".join(lines)
