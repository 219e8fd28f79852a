"""One rule for the marks of estimated values, wherever they are shown."""

from __future__ import annotations

import pytest

from edmctl.labels import basis_of, heading, marked, meanings


@pytest.mark.parametrize(
    ("name", "depth", "wear", "basis"),
    [
        ("depth_um", "touched", "estimated", "touched"),
        ("wear_um", "touched", "estimated", "estimated"),
        ("feed_um", "touched", "estimated", "estimated"),
        ("wear_ratio_lin", "touched", "model", "model"),
        ("mrr_mm3_min", "estimated", "touched", "estimated"),
        ("depth_um", None, "touched", ""),
        ("feed_um", None, "touched", "touched"),
    ],
)
def test_what_follows_from_depth_and_wear_has_the_weaker_basis(
    name: str, depth: str | None, wear: str, basis: str
) -> None:
    assert basis_of(name, depth, wear) == basis


def test_a_value_is_marked_unless_it_is_unknown_or_its_heading_states_the_basis() -> None:
    assert heading((None, "touched")) == "measured"
    assert heading(("estimated", "touched")) == "result"
    assert marked("1.0", "estimated") == "~1.0"
    assert marked("–", "estimated") == "–"
    assert marked("1.0", "estimated", "estimated") == "1.0"
    assert marked("1.0", None) == "1.0"
    assert meanings(("estimated", "estimated"), "estimated") == []
