"""Many simulated runs of one set of values, summed up."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from edmctl.csv_text import table_text
from edmctl.jobs.job import Report
from edmctl.labels import Basis, basis_of
from edmctl.results.declared import shared
from edmctl.results.job import ChannelResult, SiteResult, SiteTruth
from edmctl.results.simulation import Case, SimulatedRun, SimulatedSite, Statistics

_SITE_QUANTITIES = ("depth_um", "wear_um", "depth_error_um", "wear_error_um")
_RUN_QUANTITIES = ("machining_time_s", "time_s", "mrr_mm3_min", "wear_ratio_lin", "arc_share")
_TRUE_QUANTITIES = ("depth_um", "wear_um")


def run_of(seed: int, exit_code: int, report: Report) -> SimulatedRun:
    """Reduce a report to one row."""
    message = report.error.message if report.error else None
    model = report.model.text if report.model else ""
    made, channel = _made(report), report.job.channel
    if not made:
        return SimulatedRun(
            seed, report.error is None, exit_code, message, time_s=report.job.time_s, calibration=model
        )
    site, truth = made[0]
    values = shared(SimulatedRun, site) | shared(SimulatedRun, report.job)
    values |= {
        "ok": report.error is None,
        "exit_code": exit_code,
        "error": message,
        "truth": truth,
        "arc_share": site.ratios.arc,
        "cuts": channel.passes if channel else sum(one.cuts for one in report.job.sites),
        "calibration": model,
        "sites": tuple(SimulatedSite(**shared(SimulatedSite, one), truth=true) for one, true in made),
    }
    return SimulatedRun(seed, **values)


def _made(report: Report) -> list[tuple[SiteResult | ChannelResult, SiteTruth]]:
    """What was made, with what the plant knows of it."""
    channel, truth = report.job.channel, report.channel_truth
    if channel is not None:
        return [(channel, SiteTruth(truth.depth_um, truth.wear_um) if truth else SiteTruth())]
    return list(zip(report.job.sites, report.truths, strict=True)) if report.truths else []


def summarize(label: str, overrides: tuple[str, ...], runs: Sequence[SimulatedRun]) -> Case:
    """Sum up the runs of one set of values; those that made nothing count as failed only."""
    made = [run for run in runs if run.sites]
    sites = [site for run in made for site in run.sites]
    return Case(
        label=label,
        overrides=overrides,
        runs=tuple(runs),
        failed=sum(not run.ok for run in runs),
        spreads={**_of_basis(sites, Basis.TOUCHED), **_statistics_of(made, _RUN_QUANTITIES)},
        by_model=_of_basis(sites, Basis.MODEL),
        estimated=_of_basis(sites, Basis.ESTIMATED),
        truth=_statistics_of([site.truth for site in sites], _TRUE_QUANTITIES),
        coverage=_coverage(sites),
    )


def _of_basis(sites: Sequence[SimulatedSite], basis: Basis) -> dict[str, Statistics]:
    """Spreads of what rests on one basis: a depth that was estimated is its target, and scatters by nothing."""
    found: dict[str, Statistics] = {}
    for key in _SITE_QUANTITIES:
        of_basis = [site for site in sites if basis_of(key, site.depth_basis, site.wear_basis) == basis]
        found |= _statistics_of(of_basis, (key,))
    return found


def _statistics_of(
    rows: Sequence[SimulatedRun] | Sequence[SimulatedSite] | Sequence[SiteTruth], keys: Sequence[str]
) -> dict[str, Statistics]:
    found = {key: [v for row in rows if math.isfinite(v := getattr(row, key))] for key in keys}
    return {key: _statistics(values) for key, values in found.items() if values}


def _statistics(values: Sequence[float]) -> Statistics:
    sd = statistics.stdev(values) if len(values) > 1 else math.nan
    return Statistics(statistics.fmean(values), sd, min(values), max(values))


def _coverage(sites: Sequence[SimulatedSite]) -> dict[str, float]:
    """Share of holes and channels whose 95 % interval held the truth, where there is one."""
    held = {
        "depth": [abs(s.depth_error_um) <= s.depth_u95_um for s in sites if math.isfinite(s.depth_error_um)],
        "wear": [abs(s.wear_error_um) <= s.wear_u95_um for s in sites if math.isfinite(s.wear_error_um)],
    }
    return {name: statistics.fmean(found) for name, found in held.items() if found}


def csv_of(cases: Sequence[Case]) -> bytes:
    """Return one row a case: its label, numbers of runs, and of every quantity mean and standard deviation."""
    groups = {"": "spreads", "by_model.": "by_model", "estimated.": "estimated", "truth.": "truth"}
    rows = []
    for case in cases:
        row: dict[str, object] = {"case": case.label}
        for override in case.overrides:
            key, _, value = override.partition("=")
            row[key] = value
        row |= {"runs": len(case.runs), "failed": case.failed}
        for prefix, name in groups.items():
            for key, found in getattr(case, name).items():
                row[f"{prefix}{key}"] = found.mean
                row[f"{prefix}{key}_sd"] = found.sd
        row |= {f"{name}_coverage": share for name, share in case.coverage.items()}
        rows.append(row)
    return table_text(rows).encode()
