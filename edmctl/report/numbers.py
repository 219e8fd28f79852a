"""The figures of a run, site by site and altogether, as its results have them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from edmctl.dataclasses import asdict, dataclass, fields
from edmctl.labels import basis_of, weakest
from edmctl.record.layout import RESULTS
from edmctl.record.results import Labels, labels_of
from edmctl.results.job import SiteTruth
from edmctl.results.run_file import SiteNumbers, Totals
from edmctl.results.telemetry import PulseShares
from edmctl.wording import plain_number

if TYPE_CHECKING:
    import numpy as np

    from edmctl.record.reader import RunFile

CLASSES = ("open", "normal", "arc", "short")


@dataclass(frozen=True, slots=True)
class RunNumbers:
    """What is known of a whole run: sums over its sites, means of depth and wear. Unknown values are NaN.

    The uncertainty of a mean is the mean uncertainty: errors of one run have causes in common, and do not cancel.
    """

    sites: tuple[SiteNumbers, ...]

    def mean(self, name: str) -> float:
        """Mean of a field of the sites."""
        return (
            math.fsum(getattr(site, name) for site in self.sites) / len(self.sites)
            if self.sites
            else math.nan
        )

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
            math.fsum(site.ratios[number] * site.pulses for site in self.sites if site.pulses)
            for number in range(len(CLASSES))
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
    places = dict(_places(run.summary() or {}))
    thickness_um = run.number("/entry/sample/thickness")
    rows = zip(run.table("/entry/results"), labels_of(run), strict=True)
    return RunNumbers(tuple(_site(row, labels, places, thickness_um) for row, labels in rows))


_FIELDS = {field.name for field in fields(SiteNumbers)}
_MISSING = {
    "face_um": 0.0,
    "measuring_stops": 0,
    "estimated_um": 0.0,
    "depth_model_u95_um": math.nan,
    "wear_model_u95_um": math.nan,
}
"""Values of files of older versions, which have no such columns."""


def _places(summary: Mapping[str, object]) -> Iterator[tuple[str, Mapping[str, object]]]:
    """Each hole or channel of the summary, under the name that a result's row has room for."""
    sites = summary.get("sites")
    channel = summary.get("channel")
    for place in (*(sites if isinstance(sites, list) else ()), channel):
        if isinstance(place, Mapping):
            yield str(place.get("name")), place


def _site(
    row: np.void, labels: Labels, places: Mapping[str, Mapping[str, object]], thickness_um: float
) -> SiteNumbers:
    name, columns = row["site"].decode(errors="ignore"), row.dtype.names or ()
    known = {column.field: row[column.name].item() for column in RESULTS.columns if column.name in columns}
    values = _MISSING | {field: value for field, value in known.items() if field in _FIELDS}
    through = bool(known.get("through"))
    if through:
        # Files of older versions have the way of the tip below the surface as depth.
        values.setdefault("beyond_exit_um", values["depth_um"] - thickness_um)
        values.setdefault("beyond_exit_u95_um", values["depth_u95_um"])
        values |= dict.fromkeys(("depth_um", "depth_u95_um", "depth_model_um"), math.nan)
    else:
        values |= dict.fromkeys(("beyond_exit_um", "beyond_exit_u95_um"), math.nan)
    place = places.get(name, {})
    told = place.get("truth")
    truth = told if isinstance(told, Mapping) else {}
    return SiteNumbers(
        **values
        | asdict(labels)
        | {f"truth_{key.name}": plain_number(truth.get(key.name)) for key in fields(SiteTruth)}
        | {
            "name": name,
            "ratios": tuple(float(row[f"r_{kind}"]) for kind in CLASSES),
            "through": through,
            "length_um": thickness_um if through else values["depth_um"],
            "drift_by_rests": bool(known.get("drift_by_rests")),
            "working_gap_um": plain_number(place.get("working_gap_um")),
        }
    )


def target_depths_um(values: Mapping[str, object]) -> tuple[float, float] | None:
    """Depth and tolerance that a profile asks for; None where it asks for something else."""
    if values.get("target.kind") != "depth":
        return None
    return plain_number(values.get("target.depth_um")), plain_number(values.get("target.tolerance_um"))
