"""The figures of a run, site by site and altogether, as its results have them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import attrgetter

from edmctl.dataclasses import dataclass
from edmctl.labels import basis_of, weakest
from edmctl.record.reader import RunFile
from edmctl.record.run_index import sites_of
from edmctl.results.run_file import RecordedSite, Totals
from edmctl.results.telemetry import PulseShares
from edmctl.wording import plain_number

CLASSES = ("open", "normal", "arc", "short")


@dataclass(frozen=True, slots=True)
class RunNumbers:
    """What is known of a whole run: sums over its sites, means of depth and wear. Unknown values are NaN.

    The uncertainty of a mean is the mean uncertainty: errors of one run have causes in common, and do not cancel.
    """

    sites: tuple[RecordedSite, ...]

    def mean(self, name: str) -> float:
        """Return the mean of a field of the sites, such as `depth_um` or `truth.depth_um`."""
        return math.fsum(map(attrgetter(name), self.sites)) / len(self.sites) if self.sites else math.nan

    def basis(self, name: str) -> str:
        """Return the basis of the value `name` over all sites: the weakest of theirs (`basis_of`)."""
        return weakest(basis_of(name, site.depth_basis, site.wear_basis) for site in self.sites)

    def total(self, name: str) -> float:
        """Sum of a field of the sites."""
        return math.fsum(getattr(site, name) for site in self.sites) if self.sites else math.nan

    @property
    def totals(self) -> Totals:
        """Sums over the sites, and rates and ratios of them."""
        pulses, machining_s, length_um = (
            self.total(name) for name in ("pulses", "machining_time_s", "length_um")
        )
        removed = [site.mrr_mm3_min * site.machining_time_s for site in self.sites]
        lost = [site.wear_ratio_vol * volume for site, volume in zip(self.sites, removed, strict=True)]
        # The wear of a channel has nothing to do with its depth alone.
        is_linear = all(math.isfinite(site.wear_ratio_lin) for site in self.sites)
        counts = [
            math.fsum(getattr(site.ratios, name) * site.pulses for site in self.sites if site.pulses)
            for name in CLASSES
        ]
        return Totals(
            pulses=int(pulses) if math.isfinite(pulses) else 0,
            ratios=PulseShares(*(_share(number, pulses) for number in counts)),
            energy_j=self.total("energy_j"),
            mrr_mm3_min=_share(math.fsum(removed), machining_s),
            wear_ratio_lin=_share(self.total("wear_um"), length_um) if is_linear else math.nan,
            wear_ratio_vol=_share(math.fsum(lost), math.fsum(removed)),
        )


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else math.nan


def numbers_of(run: RunFile) -> RunNumbers:
    """Read the results of a run; without any, the numbers of no sites."""
    return RunNumbers(sites_of(run))


def target_depths_um(values: Mapping[str, object]) -> tuple[float, float] | None:
    """Depth and tolerance that a profile asks for; None where it asks for something else."""
    if values.get("target.kind") != "depth":
        return None
    return plain_number(values.get("target.depth_um")), plain_number(values.get("target.tolerance_um"))
