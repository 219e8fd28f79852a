"""The table of materials."""

from __future__ import annotations

import pytest

from edmctl.process.materials import material, materials


def test_every_material_says_what_it_rests_on() -> None:
    for found in materials().values():
        assert found.source
        assert found.removal is not None or found.wear is not None
        assert found.u_rel >= 0.3 or "Muralidhara" in found.source


@pytest.mark.parametrize(
    "written", ["Cu", "cu", " copper ", "Ti-6Al-4V", "ti-6al-4v", "WC-Co", "brass", "graphite"]
)
def test_a_material_is_found_by_symbol_and_name(written: str) -> None:
    found = material(written)
    assert found is not None
    assert written.strip().casefold() in (found.symbol.casefold(), found.name.casefold())


def test_what_is_not_in_the_table_is_not_guessed() -> None:
    assert material("cheese") is None


def test_what_users_machine_is_there() -> None:
    tools = {symbol for symbol, found in materials().items() if found.wear is not None}
    work = {symbol for symbol, found in materials().items() if found.removal is not None}
    assert tools >= {"Cu", "W", "WC", "brass", "graphite"}
    assert work >= {"steel", "Cu", "Ti-6Al-4V", "WC-Co"}
