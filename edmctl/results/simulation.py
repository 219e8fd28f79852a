"""Simulated runs of one job, and their statistics."""

from __future__ import annotations

import math
from collections.abc import Mapping

from edmctl.dataclasses import dataclass, field
from edmctl.labels import Basis, Verdict
from edmctl.results.job import SiteTruth


@dataclass(frozen=True, slots=True)
class SimulatedSite:
    """One hole or channel of a simulated run, as it was found and as it truly is."""

    name: str
    depth_um: float
    depth_u95_um: float
    wear_um: float
    wear_u95_um: float
    measuring_stops: int
    depth_basis: Basis | None
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
class SimulatedRun:
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
    mrr_mm3_min: float = math.nan
    wear_ratio_lin: float = math.nan
    arc_share: float = math.nan
    cuts: int = 0
    calibration: str = ""
    sites: tuple[SimulatedSite, ...] = ()


@dataclass(frozen=True, slots=True)
class Statistics:
    """Mean, standard deviation (NaN for one value) and range."""

    mean: float
    sd: float
    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True)
class Case:
    """Runs that differ in their seed only. `truth` has the statistics of what the plant knows.

    `spreads` holds depths and wears that were touched, `by_model` those touched without a sensor, `estimated` those
    that were not touched.
    """

    label: str
    overrides: tuple[str, ...]
    runs: tuple[SimulatedRun, ...]
    failed: int
    spreads: Mapping[str, Statistics]
    by_model: Mapping[str, Statistics]
    estimated: Mapping[str, Statistics]
    truth: Mapping[str, Statistics]
    coverage: Mapping[str, float]
