"""What the generators share: Python source as ruff lays it out, Markdown tables, the marked parts of pages."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

LINE_LENGTH = 110

_MARKED = re.compile(r"(<!-- begin (\w+) -->\n).*?(<!-- end \2 -->)", re.DOTALL)


def formatted(source: str) -> str:
    """Return Python source with the project's layout."""
    command = [
        sys.executable,
        "-m",
        "ruff",
        "format",
        "--no-cache",
        "--stdin-filename",
        "edmctl/made.py",
        "-",
    ]
    return subprocess.run(command, input=source, stdout=subprocess.PIPE, encoding="utf-8", check=True).stdout


def quoted(text: str) -> str:
    """Return a Python string literal in double quotes."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(str(cell) for cell in line) + " |\n" for line in lines)


def filled(page: str, parts: Mapping[str, str]) -> str:
    """Return a page with each part between `<!-- begin NAME -->` and `<!-- end NAME -->` made anew.

    KeyError on a marker that names no part.
    """
    return _MARKED.sub(lambda m: f"{m[1]}{parts[m[2]]}{m[3]}", page)
