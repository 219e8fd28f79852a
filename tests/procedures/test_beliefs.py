"""Machines whose tool wears, or whose work erodes, otherwise than the recipe believes: intervals hold the truth."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace

import pytest

from edmctl.jobs.truth import TrueWear
from edmctl.procedures.job import NoStateStore
from edmctl.profile.places import Place
from edmctl.results.job import ObjectiveMissed
from edmctl.results.progress import Progress
from edmctl.simulator import VirtualBench
from tests.tiers import tiers

from .conftest import Shop, Told, eroding

ALONE = (Place("hole-1", 500.0, 0.0),)
ARRAY = tuple(Place(f"hole-{i + 1}", 500.0 + 400.0 * i, 0.0) for i in range(3))
OVERRIDES = ('target={kind="depth",depth_um=10.0,tolerance_um=2.0}',)
LEAST_HELD = 0.85
SEED = 11


@pytest.mark.parametrize("sites", tiers((ALONE,), slow=((ARRAY,),)))
@pytest.mark.parametrize(("wear", "removal"), tiers((2.0, 1.0), (1.0, 5.0), slow=((0.3, 1.0), (1.0, 0.3))))
def test_a_belief_that_is_wrong_costs_no_truth(sites: tuple[Place, ...], wear: float, removal: float) -> None:
    held = []
    s = Shop(OVERRIDES, SEED, changed=lambda config: eroding(config, wear, removal))
    s.job = replace(s.job, sites=sites)
    true_wear = TrueWear(s.bench, NoStateStore())
    with suppress(ObjectiveMissed):  # said to be off the target, or not shown
        s.run_job(journal=true_wear)
    assert set(s.tally.sites) == {site.name for site in sites}
    for site in s.tally.sites.values():
        (hole,) = (one for one in s.bench.truth() if abs(one.x_um - site.x_um) < 8.0)
        held.append(abs(site.depth_um - hole.depth_um) <= site.depth_u95_um)
        held.append(abs(site.wear_um - true_wear.of_site(site.name)) <= site.wear_u95_um)
    assert held.count(False) <= round((1.0 - LEAST_HELD) * len(held))


@dataclass(slots=True)
class Changing(Told):
    """Lets the tool wear otherwise from the hole of that number on."""

    bench: VirtualBench | None = None
    hole: str = ""
    change: float = 1.0

    def progress(self, p: Progress) -> None:
        assert self.bench is not None
        if p.site == self.hole and self.change != 1.0:
            self.bench.plant.unit.tool_factor *= self.change
            self.change = 1.0


@pytest.mark.parametrize("change", tiers(2.0, slow=(0.5,)))
@pytest.mark.parametrize("hole", tiers("hole-3", slow=("hole-5",), full=("hole-7",)))
def test_a_tool_that_wears_otherwise_from_some_hole_on_is_held(hole: str, change: float) -> None:
    s = Shop(('target={kind="depth",depth_um=20.0,tolerance_um=15.0}',), SEED)
    s.job = replace(s.job, sites=tuple(Place(f"hole-{i + 1}", 500.0 + 400.0 * i, 0.0) for i in range(7)))
    s.told = told = Changing(bench=s.bench, hole=hole, change=change)
    wear = TrueWear(s.bench, NoStateStore())
    with suppress(ObjectiveMissed):
        s.run_job(journal=wear)
    assert told.change == 1.0
    for site in s.tally.sites.values():
        (true,) = (one for one in s.bench.truth() if abs(one.x_um - site.x_um) < 8.0)
        assert abs(site.depth_um - true.depth_um) <= 3.0 * site.depth_u_um, site
        worn_um = wear.of_site(site.name)
        assert abs(site.wear_um - worn_um) <= 3.0 * site.wear_u_um, site
        assert abs(site.feed_um - true.depth_um - worn_um) <= 3.0 * site.feed_u_um, site


@dataclass(slots=True)
class Compared(Told):
    """Holds what is told during a cut against the plant."""

    bench: VirtualBench | None = None
    depths: list[bool] = field(default_factory=list)
    wears: list[bool] = field(default_factory=list)

    def progress(self, p: Progress) -> None:
        assert self.bench is not None
        holes = self.bench.truth()
        if holes and math.isfinite(p.depth_u95_um):
            self.depths.append(abs(p.depth_um - holes[-1].depth_um) <= p.depth_u95_um)
            self.wears.append(abs(p.wear_um - self.bench.tool_wear_um) <= p.wear_u95_um)


@pytest.mark.parametrize("wear", tiers(2.0, slow=(0.3, 0.5, 1.5)))
def test_what_is_told_during_a_cut_holds_before_any_touch_has_confirmed_the_belief(wear: float) -> None:
    s = Shop(
        ('target={kind="depth",depth_um=30.0,tolerance_um=2.0}', "wear.expected_ratio=0.45"),
        SEED,
        changed=lambda config: eroding(config, wear),
    )
    s.told = told = Compared(bench=s.bench)
    with suppress(ObjectiveMissed):
        s.run_job()
    assert len(told.depths) > 100
    assert told.depths.count(True) >= LEAST_HELD * len(told.depths)
    assert told.wears.count(True) >= LEAST_HELD * len(told.wears)
