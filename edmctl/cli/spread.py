"""Many simulated runs of one set of values, summed up."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from edmctl.cli.job import Truth

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from edmctl.cli.job import Report


@dataclass(frozen=True, slots=True)
class Run:
    """One simulated run; what was not reached is NaN. `calibration` says in words what its actuator model was."""

    seed: int
    ok: bool
    exit_code: int
    error: str | None
    depth_um: float = math.nan
    depth_u95_um: float = math.nan
    wear_um: float = math.nan
    wear_u95_um: float = math.nan
    feed_um: float = math.nan
    truth: Truth = field(default_factory=Truth)
    machining_time_s: float = math.nan
    time_s: float = math.nan
    cuts: int = 0
    calibration: str = ""

    @property
    def depth_error_um(self) -> float:
        """Measured less true depth."""
        return self.depth_um - self.truth.depth_um

    @property
    def wear_error_um(self) -> float:
        """Measured less true wear."""
        return self.wear_um - self.truth.wear_um


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean, standard deviation (NaN for one value) and range."""

    mean: float
    sd: float
    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True)
class Case:
    """Runs that differ in their seed only. `truth` has the spreads of what the plant knows."""

    label: str
    overrides: tuple[str, ...]
    runs: tuple[Run, ...]
    failed: int
    spreads: Mapping[str, Spread]
    truth: Mapping[str, Spread]
    coverage: Mapping[str, float]


_QUANTITIES = (
    "depth_um",
    "wear_um",
    "depth_error_um",
    "wear_error_um",
    "machining_time_s",
    "time_s",
)
_TRUE_QUANTITIES = ("depth_um", "wear_um")


def run_of(seed: int, exit_code: int, report: Report) -> Run:
    """Reduce a report to one row; the only site is the first."""
    message = report.error.message if report.error else None
    model = report.model.text if report.model else ""
    if not report.job.sites or not report.truths:
        return Run(
            seed, report.error is None, exit_code, message, time_s=report.job.time_s, calibration=model
        )
    site, truth = report.job.sites[0], report.truths[0]
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
        truth=truth,
        machining_time_s=site.machining_time_s,
        time_s=report.job.time_s,
        cuts=site.cuts,
        calibration=model,
    )


def summarize(label: str, overrides: tuple[str, ...], runs: Sequence[Run]) -> Case:
    """Sum up the runs of one set of values; runs without a measured hole count as failed only."""
    measured = [run for run in runs if math.isfinite(run.depth_um)]
    return Case(
        label=label,
        overrides=overrides,
        runs=tuple(runs),
        failed=sum(not run.ok for run in runs),
        spreads=_spreads(measured, _QUANTITIES),
        truth=_spreads([run.truth for run in measured], _TRUE_QUANTITIES),
        coverage=_coverage(measured),
    )


def _spreads(rows: Sequence[Run] | Sequence[Truth], keys: Sequence[str]) -> dict[str, Spread]:
    return {key: _spread([getattr(row, key) for row in rows]) for key in keys} if rows else {}


def _spread(values: Sequence[float]) -> Spread:
    sd = statistics.stdev(values) if len(values) > 1 else math.nan
    return Spread(statistics.fmean(values), sd, min(values), max(values))


def _coverage(runs: Sequence[Run]) -> dict[str, float]:
    """Share of runs whose 95 % interval held the truth."""
    if not runs:
        return {}
    depth = sum(abs(run.depth_error_um) <= run.depth_u95_um for run in runs)
    wear = sum(abs(run.wear_error_um) <= run.wear_u95_um for run in runs)
    return {"depth": depth / len(runs), "wear": wear / len(runs)}
