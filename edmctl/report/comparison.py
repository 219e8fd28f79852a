"""Runs side by side: different settings, and whether their results differ beyond uncertainty."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence

from edmctl.dataclasses import dataclass
from edmctl.labels import basis_of
from edmctl.record.reader import RunFile, estimated_depth, sites_of
from edmctl.record.rows import profile_leaves
from edmctl.results.run_file import Amount, ComparedRun, Comparison, Quantity, Setting, Sites
from edmctl.results.telemetry import PULSE_CLASSES
from edmctl.wording import plain_number

_TEXTS = {
    "machine": "machine/serial",
    "firmware": "machine/firmware",
    "protocol": "machine/protocol",
    "actuator model": "machine/calibration",
    "edmctl": "software/version",
    "status": "status",
}
ROWS: Mapping[str, tuple[str, int, float]] = {
    "depth_um": ("{mean}depth, µm", 2, 1.0),
    "est_depth_um": ("depth when left (estimated), µm", 1, 1.0),
    "truth_depth_um": ("{mean}true depth (simulated), µm", 2, 1.0),
    "wear_um": ("{mean}tool wear, µm", 2, 1.0),
    "truth_wear_um": ("{mean}true wear (simulated), µm", 2, 1.0),
    "truth_side_gap_um": ("{mean}true side gap (simulated), µm", 2, 1.0),
    "truth_taper_um": ("{mean}true taper (simulated), µm", 2, 1.0),
    "truth_ra_um": ("{mean}true Ra (simulated), µm", 2, 1.0),
    "wear_ratio_lin": ("wear ratio, lengths", 3, 1.0),
    "wear_ratio_vol": ("wear ratio, volumes", 3, 1.0),
    "feed_um": ("{mean}feed, µm", 2, 1.0),
    "machining_time_s": ("{total}machining time, s", 1, 1.0),
    "time_s": ("whole run, s", 1, 1.0),
    "mrr_mm3_min": ("removal rate, 10⁻³ mm³/min", 3, 1e3),
    "energy_j": ("{total}discharge energy, J", 2, 1.0),
    "pulses": ("{total}pulses", 0, 1.0),
    **{f"ratio_{name}": (f"{name}, %", 2, 100.0) for name in PULSE_CLASSES},
}
"""Quantities by their keys: name, decimals, and how many of the shown unit are one of the key's."""


@dataclass(frozen=True, slots=True)
class _Value:
    """A quantity of one run; half its 95 % interval is NaN if unknown, its basis empty if it has none."""

    value: float
    u95: float = math.nan
    basis: str = ""


def compare(runs: Sequence[RunFile]) -> Comparison:
    """Compare open run files with the first of them."""
    sites = [sites_of(run) for run in runs]
    values = [_values_of(run, one) for run, one in zip(runs, sites, strict=True)]
    mean, total = ("mean ", "total ") if any(len(one) > 1 for one in sites) else ("", "")
    quantities = [
        _quantity(
            key, name.format(mean=mean, total=total), [of_run[key] for of_run in values], decimals, factor
        )
        for key, (name, decimals, factor) in ROWS.items()
    ]
    compared = []
    for run, one in zip(runs, sites, strict=True):
        run_id, title, start, status = (
            run.text(f"/entry/{name}") for name in ("run_id", "title", "start_time", "status")
        )
        about = (str(run.path), run_id, title, start, status, run.is_simulated, run.seed)
        compared.append(ComparedRun(*about, len(one)))
    known = tuple(q for q in quantities if any(math.isfinite(a.value) for a in q.amounts))
    return Comparison(tuple(compared), tuple(_differing(runs)), known, tuple(_places(sites)))


def _differing(runs: Sequence[RunFile]) -> Iterator[Setting]:
    """Yield the settings of profile, machine and setup that are not the same in all runs."""
    others, setups = list[dict[str, object]](), list[dict[str, object]]()
    for run in runs:
        versions = {name: run.text(f"/entry/{path}") for name, path in _TEXTS.items()}
        others.append({**versions, "seed": "" if run.seed is None else run.seed})
        setup = profile_leaves(tomllib.loads(run.text("/entry/machine/toml")))
        setups.append({f"setup {key}": value for key, value in setup.items()})
    profiles: list[dict[str, object]] = [{**run.profile_values()} for run in runs]
    for groups in (profiles, others, setups):
        for key in dict.fromkeys(key for one in groups for key in one if not key.endswith("_units")):
            units = next((str(one[f"{key}_units"]) for one in groups if f"{key}_units" in one), "")
            values = (one.get(key, "") for one in groups)
            texts = tuple(f"{value:g}" if isinstance(value, float) else str(value) for value in values)
            if len(set(texts)) > 1:
                yield Setting(key, units, texts)


def _values_of(run: RunFile, sites: Sites) -> dict[str, _Value]:
    """Return the quantities of a run by the keys of `ROWS`."""
    summary, totals, left = run.summary() or {}, sites.totals, estimated_depth(run)

    def mean(key: str) -> float:
        # A run without sites may have measured a hole all the same, as `measure-wear` does.
        return sites.mean(key) if sites else plain_number(summary.get(key))

    def basis(key: str) -> str:
        bases = (str(summary.get(f"{name}_basis") or "") for name in ("depth", "wear"))
        return sites.basis(key) or basis_of(key, *bases)

    ratio, rate, length_um = totals.wear_ratio_lin, totals.mrr_mm3_min, sites.mean("length_um")
    ratio_u95 = rate_u95 = math.nan
    if length_um > 0.0 and math.isfinite(ratio):
        # A depth has Z3 as the wear has, with opposite sign, so their errors add up. Thickness is exact.
        lengths_u95_um = math.fsum(0.0 if site.through else site.depth_u95_um for site in sites)
        ratio_u95 = (sites.mean("wear_u95_um") + abs(ratio) * lengths_u95_um / len(sites)) / length_um
    if length_um > 0.0 and not any(site.through for site in sites):
        # The area of a hole is known better than its length.
        rate_u95 = rate * sites.mean("depth_u95_um") / length_um
    measured = {
        f"{name}_um": _Value(mean(f"{name}_um"), mean(f"{name}_u95_um"), basis(name))
        for name in ("depth", "wear", "feed")
    }
    truths = ("depth_um", "wear_um", "side_gap_um", "taper_um", "ra_um")
    return {
        **measured,
        **{f"truth_{name}": _Value(mean(f"truth.{name}")) for name in truths},
        **{name: _Value(sites.total(name)) for name in ("machining_time_s", "energy_j", "pulses")},
        **{f"ratio_{name}": _Value(getattr(totals.ratios, name)) for name in PULSE_CLASSES},
        "est_depth_um": _Value(left.depth_um, left.depth_u95_um),
        "wear_ratio_lin": _Value(ratio, ratio_u95, basis("wear_ratio")),
        "wear_ratio_vol": _Value(totals.wear_ratio_vol, basis=basis("wear_ratio")),
        "time_s": _Value(plain_number(summary.get("time_s"))),
        "mrr_mm3_min": _Value(rate, rate_u95, basis("mrr")),
    }


def _places(sites: Sequence[Sites]) -> Iterator[Quantity]:
    """Yield depth and wear of the places that all runs have, if a run has several."""
    if all(len(one) < 2 for one in sites):
        return
    by_name = [{site.name: site for site in one} for one in sites]
    for name in (site.name for site in sites[0] if all(site.name in of_run for of_run in by_name)):
        holes = [of_run[name] for of_run in by_name]
        depths = [_Value(site.depth_um, site.depth_u95_um, site.depth_basis or "") for site in holes]
        if not all(site.through for site in holes):
            yield _quantity("depth_um", f"{name} depth, µm", depths)
        wears = [_Value(site.wear_um, site.wear_u95_um, site.wear_basis) for site in holes]
        yield _quantity("wear_um", f"{name} tool wear, µm", wears)


def _quantity(
    key: str, name: str, values: Sequence[_Value], decimals: int = 2, factor: float = 1.0
) -> Quantity:
    first, amounts = values[0], []
    for one in values:
        difference, u95 = one.value - first.value, math.hypot(one.u95, first.u95)
        amounts.append(Amount(one.value, one.u95, difference, u95, abs(difference) > u95, one.basis))
    return Quantity(key, name, decimals, factor, tuple(amounts))
