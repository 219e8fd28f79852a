"""Tables of docs/profile.md, from the models of profile and setup."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.profile.model import (
    CircleSites,
    DepthTarget,
    FeedTarget,
    FileSites,
    GridSites,
    PathTable,
    PointSite,
    Profile,
    Regime,
    SimSettings,
    ThroughTarget,
)
from edmctl.profile.setup import Setup
from edmctl.profile.tables import permitted
from edmctl.toml_text import toml_value
from tools.generate.text import table

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic.fields import FieldInfo

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
    "regimes": [("`[[regimes]]`", Regime)],
}
"""Tables that have one model for each of their kinds, or may be missing."""


def tables() -> dict[str, str]:
    """Return the tables of a profile, of `[sim]` and of a setup file."""
    profile: list[tuple[str, type[BaseModel]]] = []
    for name, info in Profile.model_fields.items():
        profile += _KINDS.get(name) or [(f"`[{name}]`", _model(info))]
    setup = [(f"`[{name}]`", _model(info)) for name, info in Setup.model_fields.items() if name != "port"]
    models: dict[str, list[tuple[str, type[BaseModel]]]] = {
        "profile": profile,
        "sim": [("`[sim]`", SimSettings)],
        "setup": setup,
    }
    return {name: "\n".join(section(*pair) for pair in pairs) for name, pairs in models.items()}


def _model(info: FieldInfo) -> type[BaseModel]:
    model = info.annotation
    assert isinstance(model, type)
    return model


def section(title: str, model: type[BaseModel]) -> str:
    """Return a table of the keys of a model under its title."""
    purpose = (model.__doc__ or "").partition("\n")[0]
    rows = [_row(name, info) for name, info in model.model_fields.items()]
    return f"### {title}\n\n{purpose}\n\n" + table(("key", "permitted", "default", ""), rows)


def _row(name: str, info: FieldInfo) -> list[str]:
    allowed = permitted(info).removesuffix(f" ({info.description})")
    cells = (f"`{info.alias or name}`", allowed, _default(info), info.description or "")
    return [cell.replace("|", "\\|") for cell in cells]


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    # A default outside its own limits stands for a value that is worked out.
    if info.default is None or _is_below_limit(info):
        return "–"
    return f"`{toml_value(info.default)}`"


def _is_below_limit(info: FieldInfo) -> bool:
    lowest = [limit for item in info.metadata if (limit := getattr(item, "gt", None)) is not None]
    return any(info.default <= limit for limit in lowest)
