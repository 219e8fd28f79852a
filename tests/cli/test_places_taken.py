"""Where the next hole goes, and which places are refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.errors import PreconditionError
from edmctl.jobs.prepared_job import WALL_UM, next_free_x_um, refuse_taken
from edmctl.record.ledger import SiteMachined


def hole(x_um: float, y_um: float = 0.0, radius_um: float = 83.0) -> SiteMachined:
    return SiteMachined("Cu", "run.h5", "hole", x_um, y_um, radius_um, "done", 20.0, 8.0)


def test_the_first_place_is_a_step_from_the_pad() -> None:
    assert next_free_x_um(100.0, 0.0, 500.0, 143.0, ()) == 600.0


@given(
    st.lists(st.tuples(st.floats(-3e3, 3e3), st.floats(-300, 300), st.floats(10, 500)), max_size=12),
    st.sampled_from([0.0, 40.0, 500.0]),
    st.floats(20, 500),
)
def test_the_next_place_is_clear_of_every_hole(
    made: list[tuple[float, float, float]], step_um: float, radius_um: float
) -> None:
    holes = [hole(*one) for one in made]
    x_um = next_free_x_um(0.0, 0.0, step_um, radius_um, holes)
    assert x_um >= step_um
    for one in holes:
        assert math.hypot(one.x_um - x_um, one.y_um) >= one.radius_um + radius_um + WALL_UM
    refuse_taken([("new", x_um, 0.0)], radius_um, holes, Path("runs"))


@pytest.mark.parametrize("step_um", [0.0, 40.0, 500.0])
def test_the_next_place_is_found_beyond_a_hole_of_any_size(step_um: float) -> None:
    x_um = next_free_x_um(
        0.0, 0.0, step_um, 143.0, [hole(400.0), hole(500.0, 1e3, 1e11), hole(1e11, 0.0, 90.0)]
    )
    assert 0.0 <= x_um - (1e11 + 500.0) <= 1e3


def test_a_place_that_runs_into_a_hole_names_it_and_its_run() -> None:
    refuse_taken([("a", 0.0, 0.0)], 100.0, [hole(183.5)], Path("runs"))
    with pytest.raises(PreconditionError) as caught:
        refuse_taken([("a", 0.0, 0.0), ("b", 900.0, 0.0)], 100.0, [hole(1082.0)], Path("runs"))
    assert caught.value.code == "E8042"
    assert caught.value.message.startswith("b at (900, 0) µm")
    assert "runs/run.h5" in caught.value.message
