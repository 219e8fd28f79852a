"""The figures of a run, site by site and altogether, as its results have them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.labels import basis_of, weakest
from edmctl.record.results import Labels, labels_of
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


TRUE_SURFACE = ("side_gap_um", "taper_um", "ra_um", "rz_um", "corner_um")
"""What the virtual machine says of a hole beside depth and wear, by the names of `SiteTruth`."""


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
    name = row["site"].decode(errors="ignore")
    through = bool(_later(row, "through"))
    depth_um, depth_u95_um = float(row["depth"]), float(row["depth_u95"])
    beyond_um, beyond_u95_um = math.nan, math.nan
    if through:
        # Files of older versions have the way of the tip below the surface as depth.
        beyond_um = _later(row, "beyond_exit", depth_um - thickness_um)
        beyond_u95_um = _later(row, "beyond_exit_u95", depth_u95_um)
        depth_um = depth_u95_um = math.nan
    place = places.get(name, {})
    told = place.get("truth")
    truth = told if isinstance(told, Mapping) else {}
    return SiteNumbers(
        name=name,
        x_um=float(row["x"]),
        y_um=float(row["y"]),
        z1_um=float(row["z1"]),
        z2_um=float(row["z2"]),
        z3_um=float(row["z3"]),
        face_um=_later(row, "face"),
        depth_um=depth_um,
        depth_u95_um=depth_u95_um,
        wear_um=float(row["wear"]),
        wear_u95_um=float(row["wear_u95"]),
        feed_um=float(row["feed"]),
        depth_model_um=math.nan if through else float(row["depth_model"]),
        depth_model_u95_um=_later(row, "depth_model_u95", math.nan),
        wear_model_um=float(row["wear_model"]),
        wear_model_u95_um=_later(row, "wear_model_u95", math.nan),
        machining_time_s=float(row["machining_time"]),
        cuts=int(row["cuts"]),
        pulses=int(row["pulses"]),
        ratios=tuple(float(row[f"r_{name}"]) for name in CLASSES),
        energy_j=float(row["energy"]),
        wear_ratio_lin=float(row["wear_ratio_lin"]),
        wear_ratio_vol=float(row["wear_ratio_vol"]),
        mrr_mm3_min=float(row["mrr"]),
        measuring_stops=int(_later(row, "stops")),
        estimated_um=_later(row, "estimated"),
        through=through,
        beyond_exit_um=beyond_um,
        beyond_exit_u95_um=beyond_u95_um,
        length_um=thickness_um if through else depth_um,
        depth_basis=labels.depth_basis,
        wear_basis=labels.wear_basis,
        verdict=labels.verdict,
        truth_depth_um=plain_number(truth.get("depth_um")),
        **{f"truth_{name}": plain_number(truth.get(name)) for name in TRUE_SURFACE},
        truth_wear_um=plain_number(truth.get("wear_um")),
        feed_u95_um=_later(row, "feed_u95", math.nan),
        drift_correction_um=_later(row, "drift_correction"),
        drift_left_u_um=_later(row, "drift_left_u", math.nan),
        drift_by_rests=bool(_later(row, "drift_by_rests")),
        working_gap_um=plain_number(place.get("working_gap_um")),
    )


def _later(row: np.void, name: str, missing: float = 0.0) -> float:
    """A field that files of older versions may not have."""
    return float(row[name]) if name in (row.dtype.names or ()) else missing


def target_depths_um(values: Mapping[str, object]) -> tuple[float, float] | None:
    """Depth and tolerance that a profile asks for; None where it asks for something else."""
    if values.get("target.kind") != "depth":
        return None
    return plain_number(values.get("target.depth_um")), plain_number(values.get("target.tolerance_um"))
