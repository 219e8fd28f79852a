"""`profile show` writes TOML that loads again."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

from edmctl.cli.render.profile_tables import render_toml

if TYPE_CHECKING:
    from edmctl.toml_text import Scalar

TABLES: dict[str, dict[str, Scalar]] = {
    "meta": {"schema": 1, "name": 'quote " back \\ tab \t µ'},
    "servo": {"reference": 0.8, "forward_um_s": 5.0, "tiny": 1e-9},
    "flush": {"required": True},
}


def test_what_is_shown_loads_again() -> None:
    assert tomllib.loads(render_toml(TABLES, TABLES, {})) == TABLES


def test_comments_stand_behind_their_key() -> None:
    text = render_toml(TABLES, TABLES, {"servo.reference": "mean gap voltage over its open value"})
    assert "reference = 0.8" in text
    assert "# mean gap voltage over its open value" in text
    assert tomllib.loads(text) == TABLES
