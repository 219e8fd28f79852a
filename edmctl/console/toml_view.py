"""Values as a TOML file that explains itself."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, TypeAlias

from edmctl.console.style import PLAIN, Ink, Style

if TYPE_CHECKING:
    from collections.abc import Mapping

Scalar: TypeAlias = bool | int | float | str

_COMMENT_COLUMN = 36


def render_toml(
    tables: Mapping[str, Mapping[str, Scalar]],
    comments: Mapping[str, str],
    style: Style = PLAIN,
) -> str:
    """Return `tables` as TOML; `comments` has a text for `table.key` where there is one to say."""
    blocks = []
    for table, values in tables.items():
        lines = [style.paint(f"[{table}]", Ink.STRONG)]
        for key, value in values.items():
            line = f"{key} = {toml_scalar(value)}"
            comment = comments.get(f"{table}.{key}", "")
            if comment:
                line = line.ljust(_COMMENT_COLUMN) + style.paint(f" # {comment}", Ink.FAINT)
            lines.append(line)
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks)


def toml_scalar(value: Scalar) -> str:
    """Return a scalar as TOML writes it; a JSON string is a TOML basic string."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)
