"""Chips on the work: where they shorten a touch, what moves them, and what they leave alone."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.work_under_tool import LIFT_UM


def bench(seed: int = 3001) -> VirtualBench:
    """A bench with the tool over the face of the work."""
    made = open_bench(BenchConfig(), seed)
    made.plant.stage_lands(0, 0.0)
    return made


def surface_um(made: VirtualBench) -> float:
    """How far the tool is from what lies under it."""
    return made.plant.state.surface_um


def test_a_chip_shortens_the_way_by_its_height_and_only_under_the_tool() -> None:
    made = bench()
    clean_um = surface_um(made)
    made.plant.chips.drop(8.0, loose=False)
    assert surface_um(made) == pytest.approx(clean_um - 8.0)
    made.plant.stage_lands(0, 300.0)
    assert surface_um(made) == pytest.approx(clean_um, abs=1.0)
    made.plant.stage_lands(0, 0.0)
    assert surface_um(made) == pytest.approx(clean_um - 8.0, abs=0.1)
    made.clear_injections()
    assert surface_um(made) == pytest.approx(clean_um, abs=0.1)


def _lift(made: VirtualBench) -> None:
    """Let the tool come down to the chip and up again."""
    near_um = surface_um(made) + made.plant.state.depth_um
    for height_um in (near_um - 1.0, near_um - LIFT_UM - 5.0):
        made.plant.state.true_z_um = height_um
        made.plant.chips.look()


def test_a_firm_chip_stays_and_a_loose_one_goes_at_half_of_the_lifts() -> None:
    firm = bench()
    firm.plant.chips.drop(8.0, loose=False)
    for _ in range(20):
        _lift(firm)
    assert firm.plant.chips.lying
    gone = []
    for seed in range(300):
        made = bench(seed)
        made.plant.chips.drop(8.0, loose=True)
        _lift(made)
        gone.append(not made.plant.chips.lying)
    assert np.mean(gone) == pytest.approx(0.5, abs=0.1)


def test_sparks_eat_a_chip_by_what_they_remove() -> None:
    made = bench()
    made.plant.chips.drop(8.0, loose=False)
    clean_um = surface_um(made) + 8.0
    made.plant.drive.pulses_on = 1
    made.plant.state.depth_um += 0.5 * 8.0**3 * made.plant.state.per_hole_area
    made.plant.chips.look()
    assert clean_um - surface_um(made) == pytest.approx(8.0 * 0.5 ** (1.0 / 3.0))
    made.plant.state.depth_um += 8.0**3 * made.plant.state.per_hole_area
    made.plant.chips.look()
    assert not made.plant.chips.lying
    assert surface_um(made) == pytest.approx(clean_um)


def test_a_chip_changes_no_random_stream() -> None:
    made, clean = bench(), bench()
    made.plant.chips.drop(8.0, loose=True)
    for _ in range(5):
        _lift(made)
    made.plant.chips.clear()
    for axis in (0, 1):
        made.plant.stage_lands(axis, 100.0)
        clean.plant.stage_lands(axis, 100.0)
    assert made.plant.position_um == pytest.approx(clean.plant.position_um)
    assert surface_um(made) == pytest.approx(surface_um(clean))


def test_chips_and_their_touch_are_read_and_refused_in_words() -> None:
    assert str(parse_injection("chip")) == "CHIP_8@touch+0"
    assert str(parse_injection("LOOSE_CHIP_2.5@touch3+0.5")) == "LOOSE_CHIP_2.5@touch3+0.5"
    assert str(parse_injection("ESTOP@arm2+1")) == "ESTOP@arm2+1"
    for text in ("CHIP_0", "CHIP_big", "LOOSE_CHIP_-3", "CHIP_nan"):
        with pytest.raises(ValueError, match="height of a chip"):
            parse_injection(text)
    for text in ("CHIP@touch0+1", "ESTOP@sparks2+1", "ESTOP@2+1"):
        with pytest.raises(ValueError, match="time"):
            parse_injection(text)


def test_the_nth_touch_is_counted() -> None:
    made = bench()
    made.inject(parse_injection("CHIP_5@touch2+0"))
    injection = parse_injection("CHIP_5@touch2+0")
    for expected in (0, 1):
        made.controller.injector.note(injection.trigger)
        made.controller.advance(1)
        assert len(made.plant.chips.lying) == expected
