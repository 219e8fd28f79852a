"""Defaults of the `[sim]` table."""

from __future__ import annotations

from dataclasses import asdict

from edmctl.process.erosion import GAP_LAW, LAW
from edmctl.profile.model import SimSettings


def test_the_defaults_of_sim_are_the_constants_of_the_laws() -> None:
    laws = {**asdict(LAW), **asdict(GAP_LAW)}
    assert {name: getattr(SimSettings(), name) for name in laws} == laws
