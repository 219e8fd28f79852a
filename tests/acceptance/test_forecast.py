"""The forecast of a job against the job: time within 10 %, feed within 5 %.

One seed each, so that it runs with every change; the figures of all shipped profiles are `benchmarks/forecast.py`'s.
"""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

import pytest

from edmctl.forecasts.forecast import forecast
from edmctl.jobs.connect import bench_config
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.procedures.job import job_of
from edmctl.procedures.machining import run_job
from edmctl.profile.setup import Setup
from edmctl.record.rows import NullRecorder
from edmctl.results.forecast import Forecast
from edmctl.rules.load import load_profile
from edmctl.simulator import open_bench
from tests.acceptance.test_paper import Nobody
from tests.tiers import tiers

if TYPE_CHECKING:
    from edmctl.results.forecast import Forecast
    from edmctl.results.job import JobResult

TIME, FEED = 0.10, 0.05
STOCK = Setup()


def forecast_and_run(profile: str, *overrides: str) -> tuple[Forecast, JobResult]:
    loaded = load_profile(profile, (*overrides, 'log.pulses="off"'))
    session = Session(open_bench(bench_config(loaded, STOCK), 2).transport, Random(1), heartbeat_s=0.2)
    session.open()
    job = job_of(loaded.profile, STOCK, loaded.places)
    result = run_job(LinkMachine(session), job, recorder=NullRecorder(), observer=Nobody())
    return forecast(loaded.profile, STOCK, loaded.places), result


@pytest.mark.parametrize(
    ("profile", "overrides"),
    tiers(
        ("cu270", ("target.depth_um=60",)),
        ("array-3x3", ("sites=[{x_um=500},{x_um=900,depth_um=40}]",)),
        slow=(
            ("cu150", ()),
            ("cu150", ("wear.remeasure=never",)),
            ("foil-through", ()),
            ("array-3x3", ()),
        ),
    ),
)
def test_holes_take_the_time_and_the_feed_that_were_forecast(
    profile: str, overrides: tuple[str, ...]
) -> None:
    expected, result = forecast_and_run(profile, *overrides)
    deepest = max(result.sites, key=lambda site: site.depth_um)
    assert result.time_s == pytest.approx(expected.time_s, rel=TIME)
    assert deepest.feed_um == pytest.approx(expected.feed_um, rel=FEED)
    assert result.tool_wear_total_um == pytest.approx(expected.tool_wear_um, rel=0.1)
    assert len(result.sites) == expected.holes
    assert sum(site.cuts for site in result.sites) == expected.cuts
