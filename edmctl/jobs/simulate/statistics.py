"""Many simulated runs of one set of values, summed up."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from edmctl.labels import Basis, Verdict
from edmctl.results.job import SiteTruth

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from edmctl.jobs.job import Report
    from edmctl.results.channel import ChannelResult
    from edmctl.results.job import SiteResult


@dataclass(frozen=True, slots=True)
class RunSite:
    """One hole or channel of a simulated run, as it was found and as it truly is."""

    name: str
    depth_um: float
    depth_u95_um: float
    wear_um: float
    wear_u95_um: float
    measuring_stops: int
    depth_basis: Basis
    wear_basis: Basis
    verdict: Verdict | None
    truth: SiteTruth

    @property
    def depth_error_um(self) -> float:
        """Depth as found less true depth."""
        return self.depth_um - self.truth.depth_um

    @property
    def wear_error_um(self) -> float:
        """Wear as found less true wear."""
        return self.wear_um - self.truth.wear_um


@dataclass(frozen=True, slots=True)
class Run:
    """One simulated run; what was not reached is NaN. `calibration` says in words what its actuator model was.

    Depth, wear and feed are those of the first hole or of the channel; `sites` has all of them. `cuts` of a channel
    are its passes.
    """

    seed: int
    ok: bool
    exit_code: int
    error: str | None
    depth_um: float = math.nan
    depth_u95_um: float = math.nan
    wear_um: float = math.nan
    wear_u95_um: float = math.nan
    feed_um: float = math.nan
    depth_basis: Basis | None = None
    wear_basis: Basis | None = None
    verdict: Verdict | None = None
    truth: SiteTruth = field(default_factory=SiteTruth)
    machining_time_s: float = math.nan
    time_s: float = math.nan
    cuts: int = 0
    calibration: str = ""
    sites: tuple[RunSite, ...] = ()


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean, standard deviation (NaN for one value) and range."""

    mean: float
    sd: float
    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True)
class Case:
    """Runs that differ in their seed only. `truth` has the spreads of what the plant knows.

    `spreads` holds depths and wears that were touched, `by_model` those touched without a sensor, `estimated` those
    that were not touched.
    """

    label: str
    overrides: tuple[str, ...]
    runs: tuple[Run, ...]
    failed: int
    spreads: Mapping[str, Spread]
    by_model: Mapping[str, Spread]
    estimated: Mapping[str, Spread]
    truth: Mapping[str, Spread]
    coverage: Mapping[str, float]


_SITE_QUANTITIES = {
    "depth_um": "depth_basis",
    "wear_um": "wear_basis",
    "depth_error_um": "depth_basis",
    "wear_error_um": "wear_basis",
}
"""Quantities of a hole, and which basis is theirs."""
_RUN_QUANTITIES = ("machining_time_s", "time_s")
_TRUE_QUANTITIES = ("depth_um", "wear_um")


def run_of(seed: int, exit_code: int, report: Report) -> Run:
    """Reduce a report to one row."""
    message = report.error.message if report.error else None
    model = report.model.text if report.model else ""
    made, channel = _made(report), report.job.channel
    if not made:
        return Run(
            seed, report.error is None, exit_code, message, time_s=report.job.time_s, calibration=model
        )
    sites = tuple(
        RunSite(
            name=site.name,
            depth_um=site.depth_um,
            depth_u95_um=site.depth_u95_um,
            wear_um=site.wear_um,
            wear_u95_um=site.wear_u95_um,
            measuring_stops=site.measuring_stops,
            depth_basis=site.depth_basis,
            wear_basis=site.wear_basis,
            verdict=site.verdict,
            truth=truth,
        )
        for site, truth in made
    )
    site, truth = made[0]
    return Run(
        seed=seed,
        ok=report.error is None,
        exit_code=exit_code,
        error=message,
        depth_um=site.depth_um,
        depth_u95_um=site.depth_u95_um,
        wear_um=site.wear_um,
        wear_u95_um=site.wear_u95_um,
        feed_um=site.feed_um,
        depth_basis=site.depth_basis,
        wear_basis=site.wear_basis,
        verdict=site.verdict,
        truth=truth,
        machining_time_s=report.job.machining_time_s,
        time_s=report.job.time_s,
        cuts=channel.passes if channel else sum(one.cuts for one in report.job.sites),
        calibration=model,
        sites=sites,
    )


def _made(report: Report) -> list[tuple[SiteResult | ChannelResult, SiteTruth]]:
    """What was made, with what the plant knows of it."""
    channel, truth = report.job.channel, report.channel_truth
    if channel is not None:
        return [(channel, SiteTruth(truth.depth_um, truth.wear_um) if truth else SiteTruth())]
    return list(zip(report.job.sites, report.truths, strict=True)) if report.truths else []


def summarize(label: str, overrides: tuple[str, ...], runs: Sequence[Run]) -> Case:
    """Sum up the runs of one set of values; those that made nothing count as failed only."""
    made = [run for run in runs if run.sites]
    sites = [site for run in made for site in run.sites]
    return Case(
        label=label,
        overrides=overrides,
        runs=tuple(runs),
        failed=sum(not run.ok for run in runs),
        spreads={**_of_basis(sites, Basis.TOUCHED), **_spreads(made, _RUN_QUANTITIES)},
        by_model=_of_basis(sites, Basis.MODEL),
        estimated=_of_basis(sites, Basis.ESTIMATED),
        truth=_spreads([site.truth for site in sites], _TRUE_QUANTITIES),
        coverage=_coverage(sites),
    )


def _of_basis(sites: Sequence[RunSite], basis: Basis) -> dict[str, Spread]:
    """Spreads of what rests on one basis: a depth that was estimated is its target, and scatters by nothing."""
    found: dict[str, Spread] = {}
    for key, name in _SITE_QUANTITIES.items():
        found |= _spreads([site for site in sites if getattr(site, name) is basis], (key,))
    return found


def _spreads(
    rows: Sequence[Run] | Sequence[RunSite] | Sequence[SiteTruth], keys: Sequence[str]
) -> dict[str, Spread]:
    found = {key: [v for row in rows if math.isfinite(v := getattr(row, key))] for key in keys}
    return {key: _spread(values) for key, values in found.items() if values}


def _spread(values: Sequence[float]) -> Spread:
    sd = statistics.stdev(values) if len(values) > 1 else math.nan
    return Spread(statistics.fmean(values), sd, min(values), max(values))


def _coverage(sites: Sequence[RunSite]) -> dict[str, float]:
    """Share of holes and channels whose 95 % interval held the truth, where there is one."""
    held = {
        "depth": [abs(s.depth_error_um) <= s.depth_u95_um for s in sites if math.isfinite(s.depth_error_um)],
        "wear": [abs(s.wear_error_um) <= s.wear_u95_um for s in sites if math.isfinite(s.wear_error_um)],
    }
    return {name: statistics.fmean(found) for name, found in held.items() if found}
