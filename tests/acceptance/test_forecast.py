"""The forecast of a job against the job: time within 10 %, feed within 5 %.

One seed each, so that it runs with every change; all shipped profiles are in the slow tests.
"""

from __future__ import annotations

import pytest

import edmctl
from tests.tiers import tiers

TIME, FEED = 0.10, 0.05


@pytest.mark.parametrize(
    ("profile", "overrides"),
    tiers(
        ("cu270", ("target.depth_um=60",)),
        ("array-3x3", ("sites=[{x_um=500},{x_um=900,depth_um=40}]",)),
        slow=(("cu150", ()), ("cu150", ("wear.remeasure=never",)), ("foil-through", ()), ("array-3x3", ())),
    ),
)
def test_holes_take_the_time_and_the_feed_that_were_forecast(
    profile: str, overrides: tuple[str, ...]
) -> None:
    expected = edmctl.forecast(profile, overrides=overrides)
    of_table = "sim.spread=0.0"  # machines differ by 6 % in wear, which no forecast knows
    report = edmctl.connect(seed=2).machine(profile, overrides=(*overrides, of_table, 'log.pulses="off"'))
    result = report.job
    deepest = max(result.sites, key=lambda site: site.depth_um)
    assert result.time_s == pytest.approx(expected.time_s, rel=TIME)
    assert deepest.feed_um == pytest.approx(expected.feed_um, rel=FEED)
    assert result.tool_wear_total_um == pytest.approx(expected.tool_wear_um, rel=0.1)
    assert len(result.sites) == expected.holes
    # A machine that wears otherwise than the book may need another cut.
    assert sum(site.cuts for site in result.sites) - expected.cuts in (0, 1)
