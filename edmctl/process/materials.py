"""How materials erode, from the table beside this file: each figure with its source or marked assumed."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files

from edmctl.dataclasses import dataclass

ASSUMED_U_REL = 0.3  # relative standard uncertainty of a figure that no measurement stands behind [assumed]


@dataclass(frozen=True, slots=True)
class Material:
    """Erosion of a material over that of copper in the same discharge: of work, and of a tool; None where unknown.

    `u_rel` is the relative standard uncertainty of both.
    """

    symbol: str
    name: str
    removal: float | None
    wear: float | None
    u_rel: float
    source: str


@cache
def materials() -> dict[str, Material]:
    """Every material of the table by its symbol."""
    text = files("edmctl.process").joinpath("materials.toml").read_text(encoding="utf-8")
    return {
        symbol: Material(
            symbol,
            row["name"],
            row.get("removal"),
            row.get("wear"),
            row.get("u_rel", ASSUMED_U_REL),
            row["source"],
        )
        for symbol, row in tomllib.loads(text).items()
    }


def material(written: str) -> Material | None:
    """The material of a symbol or a name, in capitals or not; None where the table has none."""
    wanted = written.strip().casefold()
    return next((m for m in materials().values() if wanted in (m.symbol.casefold(), m.name.casefold())), None)
