"""Writes the tables of docs/profile.md from the models: `python docs/generate_profile.py [--check]`.

With --check nothing is written; the exit code is 1 where the page is out of date.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.console.toml_view import toml_scalar
from edmctl.profile.fields import permitted
from edmctl.profile.model import DepthTarget, FeedTarget, Profile, ThroughTarget
from edmctl.profile.setup import Setup
from edmctl.profile.sim import SimSettings
from edmctl.profile.sites import CircleSites, FileSites, GridSites, PathTable, PointSite

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pydantic import BaseModel
    from pydantic.fields import FieldInfo

PAGE = Path(__file__).parent / "profile.md"


def filled(page: str) -> str:
    """Return the page with every marked table made anew."""

    def fill(match: re.Match[str]) -> str:
        return f"{match['begin']}\n{TABLES[match['name']]()}\n{match['end']}"

    return re.sub(
        r"(?P<begin><!-- table: (?P<name>\w+) -->)\n.*?(?P<end><!-- end -->)", fill, page, flags=re.DOTALL
    )


def profile_tables() -> str:
    """Return a table for each table of a profile."""
    models: list[tuple[str, type[BaseModel]]] = []
    for name, info in Profile.model_fields.items():
        models += _KINDS.get(name) or [(f"`[{name}]`", _model(info))]
    return "\n\n".join(_table(title, model) for title, model in models)


def sim_table() -> str:
    """Return the table of `[sim]`."""
    return _table("`[sim]`", SimSettings)


def setup_tables() -> str:
    """Return a table for each table of a setup file."""
    tables = [(name, info) for name, info in Setup.model_fields.items() if name != "port"]
    return "\n\n".join(_table(f"`[{name}]`", _model(info)) for name, info in tables)


_KINDS: dict[str, list[tuple[str, type[BaseModel]]]] = {
    "target": [
        ("`[target]` for a depth", DepthTarget),
        ("`[target]` for a feed", FeedTarget),
        ("`[target]` for a way through", ThroughTarget),
    ],
    "sites": [
        ("`[[sites]]`: a point", PointSite),
        ("`[[sites]]`: a grid", GridSites),
        ("`[[sites]]`: a circle", CircleSites),
        ("`[[sites]]`: a file", FileSites),
    ],
    "path": [("`[path]`", PathTable)],
}
"""Tables that have one model for each of their kinds, or may be missing."""

TABLES = {"profile": profile_tables, "sim": sim_table, "setup": setup_tables}


def _model(info: FieldInfo) -> type[BaseModel]:
    model = info.annotation
    assert isinstance(model, type)
    return model


def _table(title: str, model: type[BaseModel]) -> str:
    purpose = (model.__doc__ or "").partition("\n")[0]
    lines = [f"### {title}", "", purpose, "", "| key | permitted | default | |", "|---|---|---|---|"]
    return "\n".join([*lines, *_rows(model)])


def _rows(model: type[BaseModel]) -> Iterator[str]:
    for name, info in model.model_fields.items():
        allowed = permitted(info).removesuffix(f" ({info.description})")
        cells = (f"`{info.alias or name}`", allowed, _default(info), info.description or "")
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    # A default outside its own limits stands for a value that is worked out.
    if info.default is None or _is_below_limit(info):
        return "–"
    return f"`{toml_scalar(info.default)}`"


def _is_below_limit(info: FieldInfo) -> bool:
    lowest = [limit for item in info.metadata if (limit := getattr(item, "gt", None)) is not None]
    return any(info.default <= limit for limit in lowest)


def main(arguments: list[str]) -> int:
    """Write or check; return the exit code."""
    page = PAGE.read_text(encoding="utf-8")
    wanted = filled(page)
    if wanted == page:
        return 0
    if arguments == ["--check"]:
        sys.stdout.write(f"{PAGE.name} is out of date; run python docs/{Path(__file__).name}\n")
        return 1
    PAGE.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
