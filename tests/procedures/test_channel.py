"""A whole channel on a machine whose gap and wear are not those of the recipe: what is learned, and how it ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import pytest

from edmctl.labels import Basis, Verdict
from edmctl.planning.channel import way_of_path
from edmctl.procedures.channel import layers as channel_layers
from edmctl.procedures.channel import procedure as channel
from edmctl.procedures.channel.layers import wear_of
from edmctl.procedures.channel.procedure import ChannelProcedure
from edmctl.procedures.channel.touching import ChannelSurface, FloorReading, PassPlan, PassResult
from edmctl.procedures.hole.decision import Decision, judged_channel
from edmctl.procedures.job import HoleTarget
from edmctl.procedures.servo.limits import TimeLeft, TimeLimits
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.process.channel import even_places
from edmctl.process.plane import Plane
from edmctl.process.touches import Reading
from edmctl.record.rows import RunEvent
from edmctl.results.job import ChannelResult, FloorPlace
from tests.procedures.channel_bench import Noted, ScanningMachine, scanning_run

TARGET_UM = 20.0
LEVEL = Plane((0.0, 0.0), np.zeros(2), np.zeros((2, 2)))
PAD_UM = 50.0


def reading(kind: str, z_um: float, time_s: float = 0.0) -> SurfaceReading:
    return SurfaceReading(kind, Reading(z_um, 0.1, 3), z_um, z_um / 3.0, time_s, 0.0)


@dataclass(slots=True)
class World:
    """What the touches find: a tool that wears and a gap that stays as they truly are."""

    machine: ScanningMachine
    per_uj: float
    gap_um: float = 4.6
    bump_um: float = 0.0
    worn_uj: float = 0.0
    touched: list[int] = field(default_factory=list)

    def measure_floor(
        self,
        _: object,
        face: ChannelSurface,
        plan: PassPlan,
        done: PassResult,
        __: object,
        since_uj: float,
        places: int,
    ) -> FloorReading:
        """Floor as the last pass left it below the held tool; the last place may be a bump."""
        self.worn_uj += since_uj
        self.touched.append(places)
        wear_um = self.per_uj * self.worn_uj
        found, floor = [], []
        for i, s_um in enumerate(even_places(plan.way, places)):
            used_uj = float(np.interp(s_um, plan.way.lengths_um, done.used_uj))
            limit_um = float(np.interp(s_um, plan.way.lengths_um, done.limits_um))
            then_um = wear_um - self.per_uj * (done.wearing_uj - used_uj)
            depth_um = limit_um + self.gap_um - PAD_UM - then_um - (self.bump_um if i == places - 1 else 0.0)
            depth_um -= self.machine.misses_um(self.machine.time_s)
            found.append(FloorPlace(s_um, *plan.way.at(s_um), depth_um))
            floor.append(reading("Z2", PAD_UM + wear_um + depth_um, self.machine.time_s))
        before = reading("Z3", PAD_UM + wear_um, self.machine.time_s)
        self.machine.time_s += 100.0
        after = reading("Z3", PAD_UM + wear_um, self.machine.time_s)
        return FloorReading(tuple(found), tuple(floor), before, after)


@dataclass(slots=True)
class Made:
    result: ChannelResult | None
    decision: Decision
    kept: list[ChannelResult]
    world: World
    noted: Noted

    @property
    def found(self) -> ChannelResult:
        assert self.result is not None
        return self.result


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Made]:
    """Return what machines a channel: `make(*overrides, left_s, wear_factor, **machine and world settings)`."""

    def made(
        *overrides: str,
        left_s: float = 1e5,
        wear_factor: float = 1.2,
        bump_um: float = 0.0,
        gap_um: float = 4.6,
        **settings: object,
    ) -> Made:
        machine = ScanningMachine(z_um=44.0, quiet_after=0, **settings)  # type: ignore[arg-type]
        run, noted = scanning_run(machine, *overrides)
        path = run.profile.path
        assert path is not None
        machine.place_um = way_of_path(path).at(0.0)
        world = World(machine, wear_factor * wear_of(run.profile).per_uj, gap_um, bump_um)
        monkeypatch.setattr(
            channel, "touch_untouched", lambda *_: ChannelSurface(reading("Z1", PAD_UM), LEVEL)
        )
        monkeypatch.setattr(channel, "measure_floor", world.measure_floor)
        monkeypatch.setattr(channel_layers, "move_to", lambda *_: None)
        monkeypatch.setattr(channel_layers, "approach_bottom", lambda *_: None)

        class Limits:
            def left(self) -> TimeLeft:
                return TimeLeft(left_s - machine.time_s, "limits.max_time_s has passed")

        kept: list[ChannelResult] = []
        procedure = ChannelProcedure(run, cast("TimeLimits", Limits()))
        monkeypatch.setattr(procedure, "keep", kept.append)
        decision = procedure.machine()
        return Made(kept[-1] if kept else None, decision, kept, world, noted)

    return made


def test_the_depth_is_met_although_gap_and_wear_are_others_than_the_recipe_says(
    make: Callable[..., Made],
) -> None:
    done = make(current_a=0.03)
    found, goal = done.found, HoleTarget("depth", TARGET_UM, math.nan, 2.0)
    assert done.decision.missed == ""
    assert found.depth_um == pytest.approx(TARGET_UM, abs=1.0)
    assert found.working_gap_um == pytest.approx(done.world.gap_um, abs=0.2)
    assert RunEvent.TARGET_REACHED in done.noted.codes
    # The first stop comes early, and the last one touches more places.
    assert done.kept[0].layers == 2
    assert done.kept[0].depth_um < 0.4 * TARGET_UM
    assert done.world.touched[0] < done.world.touched[-1]
    assert len(done.kept) == found.measuring_stops == done.noted.codes.count(RunEvent.CHANNEL_MEASURED)
    assert done.kept[-1] == found
    assert found.feed_um == pytest.approx(found.depth_um + found.wear_um)
    assert found.wear_um == pytest.approx(found.z3_um - found.z1_um)
    assert found.length_um == pytest.approx(2.0 * np.pi * 300.0, rel=1e-3)
    assert (found.width_um, found.depth_basis, found.wear_basis) == (166.0, Basis.TOUCHED, Basis.TOUCHED)
    assert found.depth_u95_um > 0.1
    assert found.passes >= found.layers
    assert found.ratios.open > 0.9
    assert found.energy_j == pytest.approx(22.0 * 0.03 * found.machining_time_s, rel=0.02)
    assert judged_channel(goal, found).verdict is Verdict.SHOWN
    assert judged_channel(goal, replace(found, depth_u95_um=2.1)).verdict is Verdict.NOT_SHOWN
    assert judged_channel(replace(goal, depth_um=TARGET_UM + 3.0), found).verdict is Verdict.MISSED


@pytest.mark.slow
def test_a_well_known_tool_is_measured_less_often(make: Callable[..., Made]) -> None:
    often = make("wear.ratio_u_rel=0.5", current_a=0.03)
    seldom = make("wear.ratio_u_rel=0.01", "work.removal_u_rel=0.01", current_a=0.003)
    assert seldom.found.measuring_stops < often.found.measuring_stops


def test_a_rest_after_the_last_layer_is_cut_once_more(make: Callable[..., Made]) -> None:
    done = make("target.depth_um=4.0", 'jump.mode="off"', "measure.expected_gap_um=5.5", current_a=0.0)
    assert done.kept[0].depth_um < 3.0
    assert done.found.depth_um == pytest.approx(4.0, abs=0.3)
    assert done.decision.missed == ""


@pytest.mark.parametrize(
    ("overrides", "bump_um", "missed"),
    [(("tool.max_wear_um=13.0",), 0.0, "tool.max_wear_um is 13 µm"), ((), 8.0, "uneven")],
)
def test_a_worn_out_tool_and_an_uneven_floor_miss_the_objective(
    make: Callable[..., Made], overrides: tuple[str, ...], bump_um: float, missed: str
) -> None:
    done = make(*overrides, current_a=0.03, bump_um=bump_um)
    assert missed in done.decision.missed
    assert done.decision.code == "E7010"
    assert RunEvent.TARGET_MISSED in done.noted.codes
    if overrides:
        assert done.found.wear_um > 13.0
        assert done.found.depth_um < TARGET_UM - 1.0


def test_when_the_time_is_up_what_was_cut_is_measured(make: Callable[..., Made]) -> None:
    done, nothing = make(left_s=60.0), make(left_s=0.0)
    assert "limits.max_time_s has passed" in done.decision.missed
    assert 0.0 < done.found.depth_um < TARGET_UM
    assert done.found.measuring_stops == 1
    assert nothing.result is None
    assert nothing.decision.missed


@pytest.mark.slow
def test_a_layer_that_takes_longer_than_expected_is_measured_and_the_channel_continues(
    make: Callable[..., Made],
) -> None:
    done = make(misses_um=lambda _: 1.0)
    assert done.decision.missed == ""
    assert done.found.depth_um == pytest.approx(TARGET_UM, abs=1.5)
    assert done.found.measuring_stops > 5
    # A tool that was not held shows no gap.
    expected_um = scanning_run(done.world.machine)[0].profile.measure.expected_gap_um
    assert done.found.working_gap_um == channel_layers.GAP_GROWTH * expected_um


def test_a_tool_that_is_never_held_ends_the_channel_with_what_was_reached(make: Callable[..., Made]) -> None:
    done = make(misses_um=lambda _: 3.0)
    assert "held on 0 % of the path" in done.decision.missed
    assert done.found.layers == 0
