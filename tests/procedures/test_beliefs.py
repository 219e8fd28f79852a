"""Machines whose tool wears, or whose work erodes, otherwise than the recipe believes: intervals hold the truth."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from edmctl.cli.true_wear import TrueWear
from edmctl.procedures.job import Site
from edmctl.procedures.journal import NoJournal
from edmctl.procedures.results import ObjectiveMissed

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.simulator import BenchConfig

    from .conftest import Shop

ALONE = (Site("hole-1", 500.0, 0.0),)
ARRAY = tuple(Site(f"hole-{i + 1}", 500.0 + 400.0 * i, 0.0) for i in range(3))
OVERRIDES = ('target={kind="depth",depth_um=10.0,tolerance_um=2.0}',)
LEAST_HELD = 0.85
SEED = 11


@pytest.mark.parametrize("sites", [ALONE, ARRAY], ids=["one hole", "three holes"])
@pytest.mark.parametrize(
    ("theta", "removal"),
    [
        pytest.param(0.3, 1.0, id="a third of the wear"),
        pytest.param(2.0, 1.0, id="twice the wear"),
        pytest.param(1.0, 0.3, id="a third of the removal"),
        pytest.param(1.0, 5.0, id="five times the removal"),
    ],
)
def test_a_belief_that_is_wrong_costs_no_truth(
    shop: Callable[..., Shop], sites: tuple[Site, ...], theta: float, removal: float
) -> None:
    def changed(config: BenchConfig) -> BenchConfig:
        discharge = config.discharge
        discharge = replace(discharge, kappa_um3_per_uj=removal * discharge.kappa_um3_per_uj)
        return replace(config, discharge=discharge, theta=theta * config.theta)

    held = []
    s = shop(OVERRIDES, SEED, changed=changed)
    s.job = replace(s.job, sites=sites)
    wear = TrueWear(s.bench, NoJournal())
    with suppress(ObjectiveMissed):  # said to be off the target, or not shown
        s.run_job(journal=wear)
    assert set(s.ledger.sites) == {site.name for site in sites}
    for site in s.ledger.sites.values():
        (hole,) = (one for one in s.bench.truth() if abs(one.x_um - site.x_um) < 8.0)
        held.append(abs(site.depth_um - hole.depth_um) <= site.depth_u95_um)
        held.append(abs(site.wear_um - wear.of_site(site.name)) <= site.wear_u95_um)
    assert held.count(False) <= round((1.0 - LEAST_HELD) * len(held))
